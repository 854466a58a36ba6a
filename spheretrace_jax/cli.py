"""The command line: `spheretrace render | fit | info | convert | demo`.

Errors that a user can cause are one line and exit status 2; a fit that did not converge exits
with 1, an interrupted one with 130.
"""

import _thread
import os
import re
import sys
import threading
import time
import warnings
from contextlib import nullcontext
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import Positional, arg

from .errors import InputError, SceneWarning
from .fit.parameters import NAMES
from .fit.solve import DEFAULT_FREE

Dtype = Annotated[Literal["float32", "float64"], arg(help="the precision")]
Highlight = Annotated[Literal["phong", "blinn"], arg(help="(R.V)^n or (H.N)^n")]
Bounces = Annotated[int, arg(metavar="N", help="reflections and transmissions at most")]
Samples = Annotated[
    int, arg(metavar="K", help="each pixel is the mean of K x K parts, as the antialias flag says")
]
SceneFile = Positional[Annotated[Path, arg(metavar="SCENE", help="the scene file")]]


@dataclass
class Drawing:
    """What all commands that draw pictures, and so compile programs, have in common."""

    cache: Annotated[
        Path | None,
        arg(metavar="DIR", help="keep compiled programs in this folder, and take them from there"),
    ] = field(default=None, kw_only=True)


@dataclass
class Render(Drawing):
    """Draw a scene to a picture file.

    The ending of IMAGE chooses the format: exr and hdr hold linear numbers, unclamped; png, ppm,
    tiff and jpg hold sRGB, clipped to 0..1.
    """

    scene: SceneFile
    output: Annotated[Path, arg(aliases=["-o"], metavar="IMAGE", help="the picture to write")]
    size: Annotated[str, arg(metavar="WxH", help="width and height in pixels")] = "512x512"
    highlight: Highlight = "phong"
    bounces: Bounces = 5
    samples: Samples = 1
    dtype: Dtype = "float32"
    colorspace: Annotated[
        Literal["auto", "linear", "srgb"], arg(help="how to code the file's numbers")
    ] = "auto"
    bits: Annotated[
        int | None, arg(metavar="B", help="8, 16 or 32 per number, as far as IMAGE can")
    ] = None

    def run(self) -> int:
        from . import load_scene, render, write_image
        from .files.images import check_writable
        from .files.scene_text import scene_text

        width, height = _size(self.size)
        check_writable(self.output, self.bits)
        scene = load_scene(self.scene, self.dtype)
        start = time.perf_counter()
        with _busy(f"rendering {width} x {height}"):
            picture = render(
                scene, width=width, height=height, highlight=self.highlight, bounces=self.bounces,
                samples=self.samples,
            ).block_until_ready()  # fmt: skip
        seconds = time.perf_counter() - start
        text = scene_text(scene, self.output.parent)
        write_image(self.output, picture, colorspace=self.colorspace, bits=self.bits, scene=text)
        print(f"{self.output}: {width} x {height}, {seconds:.2f} s with compilation")
        return 0


@dataclass
class FitCommand(Drawing):
    """Find the scene that looks like a picture, starting from SCENE.

    SCENE holds what is known (geometry, camera) and the first guess of what is free. Writes the
    best scene, also when it is interrupted, and says what TARGET does not determine. Exit status
    1: the fit did not converge, or what it found does not explain TARGET.
    """

    scene: SceneFile
    target: Positional[Annotated[Path, arg(metavar="TARGET", help="the picture to explain")]]
    output: Annotated[
        Path, arg(aliases=["-o"], metavar="FITTED.txt", help="the scene file to write")
    ]
    free: Annotated[
        str,
        arg(
            metavar="NAMES",
            help=f"what to fit, with commas: {', '.join(NAMES)}",
        ),
    ] = ",".join(DEFAULT_FREE)
    highlight: Highlight = "phong"
    bounces: Bounces = 5
    samples: Samples = 1
    dtype: Dtype = "float32"
    colorspace: Annotated[
        Literal["auto", "linear", "srgb"], arg(help="how TARGET's numbers are coded")
    ] = "auto"
    mask: Annotated[
        Path | None,
        arg(metavar="IMAGE", help="a picture that is black where TARGET does not count"),
    ] = None
    darkest: Annotated[
        float | None, arg(metavar="X", help="numbers of TARGET up to this do not count")
    ] = None
    noise: Annotated[
        float | None, arg(metavar="X", help="the standard deviation of TARGET's numbers")
    ] = None
    loss: Annotated[
        Literal["square", "huber", "cauchy"], arg(help="huber and cauchy bear outliers")
    ] = "square"
    start: Annotated[
        Literal["scene", "lights", "auto"],
        arg(help="what of SCENE to begin with: all, lights' places, or only what is not free"),
    ] = "scene"
    gauge: Annotated[
        Literal["ka", "color", "none"],
        arg(help="of scenes that look the same: ka as in SCENE, color as bright as can be, or any"),
    ] = "ka"
    max_steps: Annotated[int, arg(metavar="N", help="give up after so many steps")] = 100
    report: Annotated[
        Path | None, arg(metavar="DIR", help="a folder for pictures, cost curve and a table")
    ] = None

    def run(self) -> int:
        from . import load_scene, read_image, save_scene
        from .files.atomic import check_place

        free = tuple(name.strip() for name in self.free.split(",") if name.strip())
        check_place(self.output)
        _check_folder(self.report)
        scene = load_scene(self.scene, self.dtype)
        target = read_image(self.target, self.colorspace)
        settings = dict(highlight=self.highlight, bounces=self.bounces, samples=self.samples)
        found = _fit_with_progress(
            scene, target, free=free, max_steps=self.max_steps, mask=self._mask(),
            darkest=self.darkest, noise=self.noise, loss=self.loss, start=self.start,
            gauge=self.gauge, **settings,
        )  # fmt: skip
        save_scene(self.output, found.scene)
        print(f"{self.output}: {found.trust}")
        if self.report is not None:
            for file in _report(self.report, found, scene, target, free, settings):
                print(file)
        return 130 if found.interrupted else 0 if found.trust.ok else 1

    def _mask(self):
        from . import read_image

        return None if self.mask is None else (read_image(self.mask) > 0).any(axis=-1)


@dataclass
class Info:
    """Show a scene as a table: what is in it, what its picture needs, what is left out and why."""

    scene: SceneFile

    def run(self) -> int:
        from . import load_scene
        from .cost import saved
        from .info import print_needs, print_scene

        scene = load_scene(self.scene)
        print_scene(self.scene, scene)
        with _busy("counting operations"):
            costs = saved(scene)
        print_needs(scene, costs)
        return 0


@dataclass
class Convert:
    """Write a scene for POV-Ray 3.7, whose picture is then the same."""

    scene: SceneFile
    output: Positional[Annotated[Path, arg(metavar="OUT.pov", help="the POV-Ray file to write")]]
    highlight: Highlight = "phong"
    bounces: Bounces = 5

    def run(self) -> int:
        from . import load_scene, write_povray

        if self.output.suffix != ".pov":
            raise InputError(f"{self.output}: expected a file that ends in .pov")
        scene = load_scene(self.scene, "float64")  # as main allows
        write_povray(
            self.output, scene, highlight=self.highlight, bounces=self.bounces,
            scene_path=self.scene,
        )  # fmt: skip
        print(
            f"{self.output}: render it with povray +W512 +H512 -A +FN16 File_Gamma=1 {self.output}"
        )
        return 0


@dataclass
class Demo(Drawing):
    """Fit the nine-sphere scene to a picture that POV-Ray rendered, from a wrong start.

    All colours, ka, kd, ks and the light's position start wrong and are recovered.
    """

    output: Annotated[
        Path, arg(aliases=["-o"], metavar="DIR", help="the folder to write to")
    ] = Path("spheretrace_demo")  # fmt: skip
    dtype: Dtype = "float32"

    def run(self) -> int:
        from . import load_scene, read_image, render, save_scene, write_image
        from .demo import wrong_start
        from .report import determined

        _check_folder(self.output)
        data = _data_folder()
        # the target's pixels are the mean of 2 x 2 single rays, and so are those of the fit
        truth = load_scene(data / "nine_spheres.txt", self.dtype).with_antialias(0)
        settings = dict(samples=2)
        target = read_image(data / "nine_spheres.png")
        start = wrong_start(truth)
        found = _fit_with_progress(start, target, **settings)
        self.output.mkdir(parents=True, exist_ok=True)
        smooth = found.scene.with_antialias(1)
        save_scene(self.output / "fitted.txt", smooth)
        with _busy("rendering the fitted scene"):
            write_image(self.output / "fitted.png", render(smooth))
        files = [self.output / "fitted.txt", self.output / "fitted.png"]
        files += _report(self.output, found, start, target, DEFAULT_FREE, settings)
        print(f"the fit {found.trust.verdict}")
        print("largest error against the file that POV-Ray rendered:")
        pairs = zip(determined(found.scene).items(), determined(start).values(), strict=True)
        for (name, value), first in pairs:
            true = determined(truth)[name]
            error, at_start = (abs(x - true).max() for x in (value, first))
            print(f"  {name:15} {error:9.2e}   (start: {at_start:.2e})")
        print("written:", *files, sep="\n  ")
        return 0 if found.trust.ok else 1


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

    commands = {"render": Render, "fit": FitCommand, "info": Info, "convert": Convert, "demo": Demo}
    command = tyro.extras.subcommand_cli_from_dict(
        commands,
        prog="spheretrace",
        description="Draw worlds of spheres, and find the world that a picture shows.",
        config=(tyro.conf.OmitArgPrefixes,),
    )
    warnings.showwarning = _show_warning
    double = getattr(command, "dtype", "float32") == "float64" or isinstance(command, Convert)
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


def _size(text: str) -> tuple[int, int]:
    from .files.images import MOST_PIXELS

    match = re.fullmatch(r"([1-9]\d{0,8})x([1-9]\d{0,8})", text, re.ASCII)
    if not match:
        raise InputError(f"--size must be WIDTHxHEIGHT in pixels, such as 512x512, got {text!r}")
    width, height = int(match[1]), int(match[2])
    if width * height > MOST_PIXELS:
        raise InputError(f"--size must be at most {MOST_PIXELS} pixels in all, got {text}")
    return width, height


def _check_counts(command) -> None:
    for name, least in (("bounces", 0), ("samples", 1), ("max_steps", 1)):
        value = getattr(command, name, None)
        if value is not None and value < least:
            raise InputError(f"--{name.replace('_', '-')} must be at least {least}, got {value}")


def _check_folder(folder: Path | None) -> None:
    """Says early that a folder can neither be written to nor made."""
    if folder is None:
        return
    there = next(f for f in (folder, *folder.parents) if f.exists())
    if not there.is_dir():
        what = "this" if there == folder else there
        raise InputError(f"{folder}: expected a folder to write to, {what} is a file")
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(f"{folder}: the folder {there} cannot be written to")


def _keep_compiled(folder: Path) -> None:
    """Has JAX keep in a folder what it compiles, in this process."""
    import jax

    _check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_compilation_cache_dir", str(folder.resolve()))
    # every program: by itself JAX keeps none that took less than a second, as most of ours do
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def _data_folder() -> Path:
    """Where the demo's scene and picture are: in the installed package, or in the source tree."""
    installed = Path(str(resources.files("spheretrace_jax"))) / "data"
    folder = installed if installed.is_dir() else Path(__file__).parent.parent / "data"
    if not (folder / "nine_spheres.png").is_file():
        raise InputError(
            "the demo's data are missing from this installation: reinstall the package"
        )
    return folder


def _busy(text: str):
    """A spinner while something takes longer than a blink."""
    from rich.console import Console

    return Console(stderr=True).status(text)


def _fit_with_progress(scene, target, **settings):
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from . import fit

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    console = Console(stderr=True)
    hidden = not console.is_terminal  # where it would leave an empty line
    with Progress(*columns, console=console, transient=True, disable=hidden) as bar:
        task = bar.add_task("compiling", total=None)

        def show(state) -> None:
            bar.update(
                task,
                completed=state.step,
                total=state.max_steps,
                description=f"cost {state.cost:.3e}, damping {state.damping:.0e}",
            )

        return fit(scene, target, callback=show, **settings)


def _report(folder: Path, found, start, target, free, settings) -> list[Path]:
    import numpy as np

    from . import render
    from .report import write_report

    height, width = target.shape[:2]
    with _busy("writing the report"):
        before, after = (
            np.asarray(render(scene, width=width, height=height, **settings))
            for scene in (start, found.scene)
        )
        return write_report(folder, found, start, target, before, after, free)


if __name__ == "__main__":
    main()
