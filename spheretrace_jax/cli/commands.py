"""The commands `spheretrace render | fit | check | study | info | convert`; all in a table."""

import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from tyro.conf import FlagCreatePairsOff, Positional, arg

from ..base.errors import InputError, PictureWarning
from ..fit.fit import DEFAULT_FREE
from ..fit.model.parameters import NAMES
from . import progress
from .arguments import (
    Command,
    Compiling,
    Dtype,
    HighlightModel,
    OptionalBounces,
    Sampling,
    SceneFile,
    Size,
    Sized,
    Tracing,
    channels_in,
    check_folder,
    names_in,
    objects_in,
    pairs_in,
)
from .cache import CacheCommand
from .demo import DemoCommand
from .standard_streams import (
    STANDARD,
    check_one_reader,
    file_to_read,
    file_to_write,
    read_scene,
    say,
)

#: The word for a mask that is the target's alpha.
ALPHA = "alpha"


@dataclass(kw_only=True)
class RenderCommand(Sampling, Sized, Compiling):
    """Draw a scene to a picture file.

    The ending of IMAGE chooses the format: exr, hdr and tiff of 32 bits hold linear numbers,
    unclamped; png, ppm, jpg and other tiff hold sRGB, clipped to 0..1. With --layers an exr file
    also holds coverage (A), depth (Z), normals (N.X, N.Y, N.Z) and numbers of objects (id).
    """

    scene: SceneFile
    output: Annotated[
        Path,
        arg(aliases=["-o"], metavar="IMAGE", help="the picture to write, - for standard output"),
    ]
    dtype: Dtype = "float32"
    colorspace: Annotated[
        Literal["auto", "linear", "srgb"], arg(help="how to code the file's numbers")
    ] = "auto"
    bits: Annotated[
        int | None, arg(metavar="B", help="8, 16 or 32 per number, as far as IMAGE can")
    ] = None
    format: Annotated[
        Literal["png", "exr", "hdr", "ppm", "tiff", "jpg"] | None,
        arg(help="of the picture on standard output, png by default"),
    ] = None
    layers: Annotated[
        bool, FlagCreatePairsOff, arg(help="write depth, normals, objects and coverage, too")
    ] = False

    def run(self) -> int:
        """Renders the scene and writes its picture."""
        from .. import render, render_layers, write_image
        from ..files.images import check_writable
        from ..files.layer_channels import check_layer_format
        from ..files.scene_writer import scene_text

        size = self.width_height
        shown = "{width} x {height}".format(**size)
        if self.format is not None and self.output != STANDARD:
            raise InputError(f"--format is of standard output (-), got the file {self.output}")
        with file_to_write(self.output, f".{self.format or 'png'}", binary=True) as file:
            check_writable(file, self.bits)
            if self.layers:
                check_layer_format(file)
            scene = read_scene(self.scene, self.dtype)
            start = time.perf_counter()
            with progress.busy(f"rendering {shown}"):
                picture = render(scene, **size, **self.settings).block_until_ready()
                layers = render_layers(scene, **size, samples=self.samples) if self.layers else None
            seconds = time.perf_counter() - start
            text = scene_text(scene, self.output.parent)
            write_image(
                file, picture, colorspace=self.colorspace, bits=self.bits, scene=text,
                layers=layers,
            )  # fmt: skip
        say(self.output, f"{self.output}: {shown}, {seconds:.2f} s with compilation")
        return 0


@dataclass(kw_only=True)
class FitCommand(Sampling, Compiling):
    """Find the scene that looks like a picture, starting from SCENE.

    SCENE holds the known parameters (geometry, camera) and the first guess of the free ones. Writes
    the best scene, also when it is interrupted, and says what TARGET does not determine. Exit
    status 1: the fit did not converge, or its scene does not explain TARGET.
    """

    scene: SceneFile
    target: Positional[
        Annotated[Path, arg(metavar="TARGET", help="the picture to explain, - for stdin")]
    ]
    output: Annotated[
        Path,
        arg(aliases=["-o"], metavar="FITTED.txt", help="the scene file to write, - for stdout"),
    ]
    free: Annotated[
        str,
        arg(
            metavar="NAMES",
            help=f"what to fit, with commas: {', '.join(NAMES)}; of some objects: color:1,3-5,kd",
        ),
    ] = ",".join(DEFAULT_FREE)
    tie: Annotated[
        str | None,
        arg(metavar="NAMES", help="what objects share: kd for all, kd:1,3-5 for some"),
    ] = None
    bounds: Annotated[
        str | None,
        arg(metavar="NAME:X..Y", help="ranges of free parameters: radius:50..120,kd:..0.9"),
    ] = None
    priors: Annotated[
        str | None,
        arg(metavar="NAME:X+-S", help="means and standard deviations known before: kd:0.5+-0.1"),
    ] = None
    dtype: Dtype = "float32"
    colorspace: Annotated[
        Literal["auto", "linear", "srgb"], arg(help="how TARGET's numbers are coded")
    ] = "auto"
    layer: Annotated[
        str | None, arg(metavar="NAME", help="the layer, view or page of TARGET, if it has several")
    ] = None
    mask: Annotated[
        str | None,
        arg(metavar="IMAGE", help="a picture that is black where TARGET does not count and white "
            "elsewhere, or the word alpha, for TARGET's own (./alpha is a file)"),
    ] = None  # fmt: skip
    shrink: Annotated[
        int, arg(metavar="N", help="fit the means of N x N pixels, in less memory and time")
    ] = 1
    darkest: Annotated[
        float | None, arg(metavar="X", help="numbers of TARGET up to this do not count")
    ] = None
    brightest: Annotated[
        str | None,
        arg(metavar="X|R,G,B", help="numbers of TARGET from this on are saturated: do not count"),
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
    max_steps: Annotated[int, arg(metavar="N", help="give up after so many steps in all")] = 300
    report: Annotated[
        Path | None, arg(metavar="DIR", help="a folder for pictures, cost curve and a table")
    ] = None

    def run(self) -> int:
        """Fits the scene, and writes it and the report."""
        from .. import read_image, save_scene
        from ..files.atomic import check_target
        from ..files.scene_writer import checked_text
        from ..fit.model.target import mean_of_boxes

        free, tie = (objects_in(f"--{n}", getattr(self, n) or "") for n in ("free", "tie"))
        bounds = pairs_in("--bounds", self.bounds, "..")
        priors = pairs_in("--priors", self.priors, "+-")
        brightest = channels_in("--brightest", self.brightest)
        check_one_reader(self.scene, self.target)
        if self.output != STANDARD:
            check_target(self.output)
        check_folder(self.report)
        scene = read_scene(self.scene, self.dtype)
        for option, given in (("--free", free), ("--tie", tie)):
            _check_objects(option, given, scene)
        with file_to_read(self.target) as file:
            with warnings.catch_warnings():
                if self.mask == ALPHA:  # what is transparent does not count: it need not be said
                    warnings.filterwarnings("ignore", ".* are transparent", PictureWarning)
                target = read_image(file, self.colorspace, layer=self.layer)
            mask = self._mask(file)
        result = progress.fit_with_progress(
            scene, target, free=free, tie=tie, bounds=bounds, priors=priors,
            max_steps=self.max_steps, mask=mask, darkest=self.darkest,
            brightest=brightest, noise=self.noise, loss=self.loss, shrink=self.shrink,
            start=self.start, gauge=self.gauge, **self.settings,
        )  # fmt: skip
        if self.output == STANDARD:
            print(end=checked_text(result.scene, "standard output"))
        else:
            save_scene(self.output, result.scene)
        say(self.output, f"{self.output}: {result.trust}")
        if self.report is not None:
            shown = mean_of_boxes(target, self.shrink)
            for file in progress.report_with_progress(
                self.report, result, scene, shown, tuple(free), self.settings
            ):
                say(self.output, file)
        return 130 if result.interrupted else 0 if result.trust.ok else 1

    def _mask(self, target: Path):
        """Reads which pixels count, and says how many. **Arguments:** `target`: TARGET's file."""
        from .. import read_mask

        if self.mask is None:
            return None
        alpha = self.mask == ALPHA
        file = target if alpha else Path(self.mask)
        with warnings.catch_warnings():
            if alpha:  # said of the target
                warnings.simplefilter("ignore", PictureWarning)
            mask = read_mask(file, alpha=alpha, layer=self.layer if alpha else None)
        what = f"{self.target} (alpha)" if alpha else file
        say(self.output, f"{what}: {int(mask.sum())} of {mask.size} pixels count")
        return mask


def _check_objects(option: str, given: dict[str, bool | list[int]], scene) -> None:
    """Checks that a scene has the objects that are named. **Raises:** `InputError`."""
    from ..fit.model.constraints import objects_of, start_of

    for name, places in given.items():
        if name not in NAMES or isinstance(places, bool):
            continue
        shape = start_of(scene, name).shape
        count, kind = (len(shape) and shape[0]), objects_of(name)
        if max(places) >= count:
            has = f"has {kind}s 1 to {count}" if kind and count else f"has one {name}"
            raise InputError(f"{option} {name}: the scene {has}, got {max(places) + 1}")


@dataclass(kw_only=True)
class CheckCommand(Sampling, Sized, Compiling):
    """See whether a scene's derivatives, its picture in float32 and its fits can be trusted.

    Compares forward mode, reverse mode and differences by every parameter; float32 with float64,
    and names the worst pixels and why; says what a fit to the scene's own picture would find.
    Exit status 1: something is not to be trusted.
    """

    always_double: ClassVar[bool] = True

    scene: SceneFile
    size: Size = "64x64"
    free: Annotated[
        str | None, arg(metavar="NAMES", help="what a fit would find, as for the command fit")
    ] = None
    second: Annotated[
        bool, FlagCreatePairsOff, arg(help="compare second derivatives too, which compile for long")
    ] = False

    def run(self) -> int:
        """Checks the scene and prints the results."""
        from .check import check

        size = self.width_height
        scene = read_scene(self.scene, "float64")
        free = None if self.free is None else names_in(self.free)
        return 0 if check(scene, free, self.second, **size, **self.settings) else 1


@dataclass(kw_only=True)
class StudyCommand(Compiling):
    """Measure error against run time on a scene, and draw it.

    Pictures, derivatives, fits by every solver, and the growth of time and memory: work-precision
    diagrams, each against a reference of another method, with a page that explains them.
    """

    always_double: ClassVar[bool] = True

    scene: SceneFile
    report: Annotated[
        Path, arg(metavar="DIR", help="the folder for the page, its figures and all points")
    ]
    quick: Annotated[bool, arg(help="about a minute, without bounces, in place of ten")] = False
    parts: Annotated[
        str, arg(metavar="NAMES", help="what to study, with commas")
    ] = "picture,derivative,fit,scale"  # fmt: skip
    highlight: HighlightModel = "phong"
    bounces: OptionalBounces = None
    seed: Annotated[int, arg(metavar="S", help="of the directions in which things move")] = 0

    def run(self) -> int:
        """Measures, and writes the page and its figures."""
        from .diagrams import write_study

        check_folder(self.report)
        scene = read_scene(self.scene, "float64")
        bounces = {} if self.bounces is None else dict(bounces=self.bounces)
        measured = progress.study_with_progress(
            scene, parts=names_in(self.parts), quick=self.quick, highlight=self.highlight,
            seed=self.seed, **bounces,
        )  # fmt: skip
        print("written:", *write_study(self.report, measured), sep="\n  ")
        return 0


@dataclass(kw_only=True)
class InfoCommand(Command):
    """Show a scene as a table: what is in it, what its picture needs, what is left out and why."""

    scene: SceneFile

    def run(self) -> int:
        """Prints the scene and its needs."""
        from ..study.benchmarks.feature_cost import feature_costs
        from .info import print_needs, print_scene

        scene = read_scene(self.scene)
        print_scene(self.scene, scene)
        with progress.busy("counting operations"):
            costs = feature_costs(scene)
        print_needs(scene, costs)
        return 0


@dataclass(kw_only=True)
class ConvertCommand(Tracing):
    """Write a scene for POV-Ray 3.7, whose picture is then the same."""

    always_double: ClassVar[bool] = True

    scene: SceneFile
    output: Positional[
        Annotated[Path, arg(metavar="OUT.pov", help="the POV-Ray file to write, - for stdout")]
    ]

    def run(self) -> int:
        """Writes the scene in the format of the output's ending."""
        from ..files.formats import EXPORT_FORMATS

        with file_to_write(self.output, ".pov") as file:
            if file.suffix not in EXPORT_FORMATS:
                endings = " or ".join(EXPORT_FORMATS)
                raise InputError(f"{self.output}: expected a file that ends in {endings}")
            exported = EXPORT_FORMATS[file.suffix]
            scene = read_scene(self.scene, "float64")
            exported.write(file, scene, scene_path=self.scene, **self.settings)
        usage = exported.usage.format(file=self.output)
        say(self.output, f"{self.output}: render it with {usage}")
        return 0


#: The commands by name, in the order of the help.
COMMANDS: dict[str, type[Command]] = {
    "render": RenderCommand,
    "fit": FitCommand,
    "check": CheckCommand,
    "study": StudyCommand,
    "info": InfoCommand,
    "convert": ConvertCommand,
    "demo": DemoCommand,
    "cache": CacheCommand,
}
