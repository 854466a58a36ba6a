"""What the commands `spheretrace render | fit | check | study | info | convert | demo` do."""

import os
import re
import time
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from ..base.errors import InputError
from ..fit.fit import DEFAULT_FREE
from ..fit.model.parameters import NAMES
from .progress import busy, fit_with_progress, report_with_progress, study_with_progress

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
        from .. import load_scene, write_image
        from ..files.images import check_writable
        from ..files.scene_text import scene_text
        from ..rendering.render import render

        width, height = _size(self.size)
        check_writable(self.output, self.bits)
        scene = load_scene(self.scene, self.dtype)
        start = time.perf_counter()
        with busy(f"rendering {width} x {height}"):
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
        from .. import load_scene, read_image, save_scene
        from ..files.atomic import check_place

        free = _names(self.free)
        check_place(self.output)
        check_folder(self.report)
        scene = load_scene(self.scene, self.dtype)
        target = read_image(self.target, self.colorspace)
        settings = dict(highlight=self.highlight, bounces=self.bounces, samples=self.samples)
        found = fit_with_progress(
            scene, target, free=free, max_steps=self.max_steps, mask=self._mask(),
            darkest=self.darkest, noise=self.noise, loss=self.loss, start=self.start,
            gauge=self.gauge, **settings,
        )  # fmt: skip
        save_scene(self.output, found.scene)
        print(f"{self.output}: {found.trust}")
        if self.report is not None:
            for file in report_with_progress(self.report, found, scene, target, free, settings):
                print(file)
        return 130 if found.interrupted else 0 if found.trust.ok else 1

    def _mask(self):
        from .. import read_image

        return None if self.mask is None else (read_image(self.mask) > 0).any(axis=-1)


@dataclass
class Check(Drawing):
    """See whether a scene's derivatives, its picture in float32 and its fits can be trusted.

    Compares forward mode, reverse mode and differences by every parameter; float32 with float64,
    and names the worst pixels and why; says what a fit to the scene's own picture would find.
    Exit status 1: something is not to be trusted.
    """

    scene: SceneFile
    size: Annotated[str, arg(metavar="WxH", help="width and height in pixels")] = "64x64"
    highlight: Highlight = "phong"
    bounces: Bounces = 5
    samples: Samples = 1
    free: Annotated[
        str | None, arg(metavar="NAMES", help="what a fit would find, as for the command fit")
    ] = None

    def run(self) -> int:
        from .. import load_scene
        from .check import check

        width, height = _size(self.size)
        scene = load_scene(self.scene, "float64")  # as main allows
        free = None if self.free is None else _names(self.free)
        sound = check(
            scene, free, width=width, height=height, highlight=self.highlight,
            bounces=self.bounces, samples=self.samples,
        )  # fmt: skip
        return 0 if sound else 1


@dataclass
class Study(Drawing):
    """Measure error against run time on a scene, and draw it.

    Pictures, derivatives, fits by every solver, and how time and memory grow: work-precision
    diagrams, each against a truth that is found in another way, with a page that reads them.
    """

    scene: SceneFile
    report: Annotated[
        Path, arg(metavar="DIR", help="the folder for the page, its figures and all points")
    ]
    quick: Annotated[bool, arg(help="about a minute, without bounces, in place of ten")] = False
    parts: Annotated[
        str, arg(metavar="NAMES", help="what to study, with commas")
    ] = "picture,derivative,fit,scale"  # fmt: skip
    highlight: Highlight = "phong"
    bounces: Annotated[
        int | None, arg(metavar="N", help="reflections and transmissions at most")
    ] = None
    seed: Annotated[int, arg(metavar="S", help="of the directions in which things move")] = 0

    def run(self) -> int:
        from .. import load_scene
        from .diagrams import write_study

        check_folder(self.report)
        scene = load_scene(self.scene, "float64")  # as main allows
        bounces = {} if self.bounces is None else dict(bounces=self.bounces)
        found = study_with_progress(
            scene, parts=_names(self.parts), quick=self.quick, highlight=self.highlight,
            seed=self.seed, **bounces,
        )  # fmt: skip
        print("written:", *write_study(self.report, found), sep="\n  ")
        return 0


@dataclass
class Info:
    """Show a scene as a table: what is in it, what its picture needs, what is left out and why."""

    scene: SceneFile

    def run(self) -> int:
        from .. import load_scene
        from ..study.benchmarks.feature_cost import feature_costs
        from .info import print_needs, print_scene

        scene = load_scene(self.scene)
        print_scene(self.scene, scene)
        with busy("counting operations"):
            costs = feature_costs(scene)
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
        from .. import load_scene, write_povray

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
        from .. import load_scene, read_image, save_scene, write_image
        from ..fit.model.products import determined_products
        from ..rendering.render import render
        from ..study.wrong_start import wrong_start

        check_folder(self.output)
        data = data_folder()
        # the target's pixels are the mean of 2 x 2 single rays, and so are those of the fit
        truth = load_scene(data / "nine_spheres.txt", self.dtype).with_antialias(0)
        settings = dict(samples=2)
        target = read_image(data / "nine_spheres.png")
        start = wrong_start(truth)
        found = fit_with_progress(start, target, **settings)
        self.output.mkdir(parents=True, exist_ok=True)
        smooth = found.scene.with_antialias(1)
        save_scene(self.output / "fitted.txt", smooth)
        with busy("rendering the fitted scene"):
            write_image(self.output / "fitted.png", render(smooth))
        files = [self.output / "fitted.txt", self.output / "fitted.png"]
        files += report_with_progress(self.output, found, start, target, DEFAULT_FREE, settings)
        print(f"the fit {found.trust.verdict}")
        print("largest error against the file that POV-Ray rendered:")
        pairs = zip(
            determined_products(found.scene).items(),
            determined_products(start).values(),
            strict=True,
        )
        for (name, value), first in pairs:
            true = determined_products(truth)[name]
            error, at_start = (abs(x - true).max() for x in (value, first))
            print(f"  {name:15} {error:9.2e}   (start: {at_start:.2e})")
        print("written:", *files, sep="\n  ")
        return 0 if found.trust.ok else 1


def _size(text: str) -> tuple[int, int]:
    from ..files.images import MOST_PIXELS

    match = re.fullmatch(r"([1-9]\d{0,8})x([1-9]\d{0,8})", text, re.ASCII)
    if not match:
        raise InputError(f"--size must be WIDTHxHEIGHT in pixels, such as 512x512, got {text!r}")
    width, height = int(match[1]), int(match[2])
    if width * height > MOST_PIXELS:
        raise InputError(f"--size must be at most {MOST_PIXELS} pixels in all, got {text}")
    return width, height


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def check_folder(folder: Path | None) -> None:
    """Says early that a folder can neither be written to nor made."""
    if folder is None:
        return
    there = next(f for f in (folder, *folder.parents) if f.exists())
    if not there.is_dir():
        what = "this" if there == folder else there
        raise InputError(f"{folder}: expected a folder to write to, {what} is a file")
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(f"{folder}: the folder {there} cannot be written to")


def data_folder() -> Path:
    """Where the demo's scene and picture are: in the installed package, or in the source tree."""
    installed = Path(str(resources.files("spheretrace_jax"))) / "data"
    folder = installed if installed.is_dir() else Path(__file__).parents[2] / "data"
    if not (folder / "nine_spheres.png").is_file():
        raise InputError(
            "the demo's data are missing from this installation: reinstall the package"
        )
    return folder


#: By name, in the order of the help.
COMMANDS = {
    "render": Render,
    "fit": FitCommand,
    "check": Check,
    "study": Study,
    "info": Info,
    "convert": Convert,
    "demo": Demo,
}

#: Those that work in float64 whatever the precision of the picture.
DOUBLE = (Check, Study, Convert)
