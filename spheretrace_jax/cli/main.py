"""The command line: `spheretrace COMMAND ...`, with the commands of `commands.py`.

Errors that a user can cause are one line and exit status 2; a fit that did not converge, or a scene
that does not check, exits with 1, an interrupted one with 130.
"""

import _thread
import os
import sys
import threading
import warnings
from contextlib import nullcontext
from pathlib import Path

import tyro

from ..base.errors import InputError, SceneWarning
from .commands import COMMANDS, DOUBLE, check_folder


def main() -> None:
    """The entry point of the `spheretrace` program."""
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
    _forget_unprinted()
    if status == 130:  # a compiler that was interrupted may crash as Python takes it down
        os._exit(status)
    sys.exit(status)


def _run() -> int:
    """Does what the words of the command line ask for."""
    import jax

    command = tyro.extras.subcommand_cli_from_dict(
        COMMANDS,
        prog="spheretrace",
        description="Draw worlds of spheres, and find the world that a picture shows.",
        config=(tyro.conf.OmitArgPrefixes,),
    )
    warnings.showwarning = _show_warning
    double = getattr(command, "dtype", "float32") == "float64" or isinstance(command, DOUBLE)
    _check_counts(command)
    if (cache := getattr(command, "cache", None)) is not None:
        _keep_compiled(cache)
    with jax.enable_x64(True) if double else nullcontext():
        return command.run()


def _interrupt_again(lost) -> None:
    """An interrupt while JAX collects garbage would only be printed, and the program go on."""
    if issubclass(lost.exc_type, KeyboardInterrupt):
        # a moment later, when this is over
        threading.Timer(0.01, _thread.interrupt_main).start()
    else:
        sys.__unraisablehook__(lost)


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.errno is not None:
        # files are named where they are written
        return f"{error.filename or 'standard output'}: {error.strerror}"
    return " ".join(str(error).split())


def _forget_unprinted() -> None:
    """Or Python itself would complain at its end of a full disk or a closed pipe."""
    try:
        print(end="", flush=True)
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _show_warning(message, category, filename, lineno, file=None, line=None) -> None:
    prefix = "" if issubclass(category, SceneWarning) else f"{category.__name__}: "
    print(f"spheretrace: warning: {prefix}{message}", file=sys.stderr)


def _check_counts(command) -> None:
    for name, least in (("bounces", 0), ("samples", 1), ("max_steps", 1)):
        value = getattr(command, name, None)
        if value is not None and value < least:
            raise InputError(f"--{name.replace('_', '-')} must be at least {least}, got {value}")


def _keep_compiled(folder: Path) -> None:
    """Has JAX keep in a folder what it compiles, in this process."""
    import jax

    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_compilation_cache_dir", str(folder.resolve()))
    # every program: by itself JAX keeps none that took less than a second, as most of ours do
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
