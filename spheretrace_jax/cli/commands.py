"""The commands `spheretrace render`, `fit`, `lights`, `check` and others; all in a table."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from tyro.conf import FlagCreatePairsOff, Positional, arg

from ..base.errors import InputError
from ..base.progress import working
from ..base.types import Colorspace
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
    check_folder,
    check_report,
    names_in,
)
from .cache import CacheCommand
from .demo import DemoCommand
from .fit_command import FitCommand
from .lights_command import LightsCommand
from .standard_streams import (
    STANDARD,
    file_to_write,
    read_scene,
    say,
)
from .view_command import ViewCommand


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
    colorspace: Annotated[Colorspace, arg(help="how to code the file's numbers")] = "auto"
    bits: Annotated[
        int | None, arg(metavar="B", help="8, 16 or 32 per number, as far as IMAGE can")
    ] = None
    format: Annotated[
        Literal["png", "exr", "hdr", "ppm", "tiff", "jpg"] | None,
        arg(metavar="{png,exr,hdr,ppm,tiff,jpg}", help="of the picture on standard output (png)"),
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
            with working(f"rendering {shown}"):
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
    report: Annotated[
        Path | None, arg(metavar="FILE.html", help="write the results to a page, too")
    ] = None

    def run(self) -> int:
        """Checks the scene, prints the results and writes the page."""
        from ..display.check_report import check_page
        from ..files.atomic import write_text
        from .check import check, print_sections

        size = self.width_height
        if self.report is not None and self.report.suffix != ".html":
            raise InputError(f"{self.report}: expected a name that ends in .html")
        check_report(self.report)
        scene = read_scene(self.scene, "float64")
        free = None if self.free is None else names_in(self.free)
        found = check(scene, free, self.second, **size, **self.settings)
        print_sections(found)
        if self.report is not None:
            write_text(self.report, check_page(f"Check of {self.scene}", found))
            print(f"wrote {self.report}")
        return 0 if all(section.ok for section in found) else 1


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
        from ..display.study_report import write_study
        from ..study.study import study

        check_folder(self.report)
        scene = read_scene(self.scene, "float64")
        bounces = {} if self.bounces is None else dict(bounces=self.bounces)
        measured = study(
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
        with working("counting operations"):
            costs = feature_costs(scene)
        print_needs(scene, costs)
        return 0


@dataclass(kw_only=True)
class ConvertCommand(Tracing):
    """Write a scene in another format: POV-Ray 3.7 (.pov), Mitsuba 3 (.xml), or scene text (.txt).

    Scenes are read from scene text, from NFF (.nff) and from POV-Ray's language, as far as this
    command writes it (.pov). What is not carried over is said line by line on standard error.
    """

    always_double: ClassVar[bool] = True

    scene: SceneFile
    output: Positional[
        Annotated[Path, arg(metavar="OUT", help="the file to write, - for POV-Ray's on stdout")]
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
    "lights": LightsCommand,
    "view": ViewCommand,
    "check": CheckCommand,
    "study": StudyCommand,
    "info": InfoCommand,
    "convert": ConvertCommand,
    "demo": DemoCommand,
    "cache": CacheCommand,
}
