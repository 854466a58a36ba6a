"""The command line: `spheretrace COMMAND ...`, with the commands of `commands.py`.

Errors that a user can cause print one line and exit with status 2. A fit that did not converge and
a scene that fails a check exit with 1, interrupted programs with 130.
"""

import _thread
import os
import sys
import threading
import warnings
from contextlib import nullcontext
from functools import partial

import tyro

from ..base.errors import InputError, PictureWarning, SceneWarning
from .arguments import Command, Compiling
from .cache import use_cache, use_default_cache
from .commands import COMMANDS


def main() -> None:
    """Runs the program `spheretrace`: its entry point."""
    import jax

    sys.unraisablehook = _interrupt_again
    try:
        status = _run()
        print(end="", flush=True)
    except (InputError, OSError) as error:
        print(f"spheretrace: {_one_line(error)}", file=sys.stderr)
        status = 2
    except (MemoryError, jax.errors.JaxRuntimeError) as error:
        if isinstance(error, jax.errors.JaxRuntimeError) and "RESOURCE_EXHAUSTED" not in str(error):
            raise
        print("spheretrace: there is not enough memory for this picture", file=sys.stderr)
        status = 2
    except KeyboardInterrupt:
        print("spheretrace: interrupted", file=sys.stderr)
        status = 130
    _discard_unprinted()
    if status == 130:  # an interrupted compiler may crash during Python's exit
        os._exit(status)
    sys.exit(status)


def _run() -> int:
    """Parses the command line and runs the command. **Returns:** the exit status."""
    import jax

    from .. import __version__

    if sys.argv[1:] == ["--version"]:
        print(f"spheretrace {__version__}")
        return 0
    command: Command = tyro.extras.subcommand_cli_from_dict(
        COMMANDS,
        prog="spheretrace",
        description="Draw worlds of spheres, and find the world that a picture shows. "
        "`spheretrace --version` prints the version.",
        config=(tyro.conf.OmitArgPrefixes,),
    )
    warnings.showwarning = partial(_show_warning, set())
    double = getattr(command, "dtype", "float32") == "float64" or command.always_double
    _check_counts(command)
    if isinstance(command, Compiling):
        if command.cache is not None:
            use_cache(command.cache)
        elif not command.no_cache:
            use_default_cache()
    with jax.enable_x64(True) if double else nullcontext():
        return command.run()


def _interrupt_again(lost) -> None:
    """Repeats an interrupt that arrives while JAX collects garbage.

    Python would only print such an interrupt, and the program would go on.
    """
    if issubclass(lost.exc_type, KeyboardInterrupt):
        # a moment later, after the collection
        threading.Timer(0.01, _thread.interrupt_main).start()
    else:
        sys.__unraisablehook__(lost)


def _one_line(error: Exception) -> str:
    """Returns the message of an error on one line."""
    if isinstance(error, OSError) and error.errno is not None:
        # writers name their files, so an error without a name is one of printing
        return f"{error.filename or 'standard output'}: {error.strerror}"
    return " ".join(str(error).split())


def _discard_unprinted() -> None:
    """Discards output that cannot be printed: Python would report a full disk or a closed pipe."""
    try:
        print(end="", flush=True)
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _show_warning(
    said: set[str], message, category, filename, lineno, file=None, line=None
) -> None:
    """Prints a warning on one line. **Arguments:** `said`: what need not be said twice."""
    if "persistent compilation cache" in str(message):  # JAX warns of each damaged program
        message = "compiled programs are damaged and not used: `spheretrace cache --clear`"
        category = SceneWarning
        if message in said:
            return
        said.add(message)
    prefix = (
        "" if issubclass(category, (SceneWarning, PictureWarning)) else f"{category.__name__}: "
    )
    print(f"spheretrace: warning: {prefix}{message}", file=sys.stderr)


def _check_counts(command: Command) -> None:
    """Checks the counts of a command. **Raises:** `InputError`."""
    for name, least in (("bounces", 0), ("samples", 1), ("max_steps", 1), ("shrink", 1)):
        value = getattr(command, name, None)
        if value is not None and value < least:
            raise InputError(f"--{name.replace('_', '-')} must be at least {least}, got {value}")
