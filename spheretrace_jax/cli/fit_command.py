"""The command `spheretrace fit`: finds the scene that looks like a picture."""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..base.errors import InputError, PictureWarning
from ..base.types import Colorspace
from ..fit.model.accessors import NAMES
from ..fit.model.target import PHOTO, Loss
from ..fit.result import TOLERANCE
from ..fit.solver.gauge import Gauge
from ..fit.solver.light_search import Start
from .arguments import (
    Compiling,
    Dtype,
    Sampling,
    SceneFile,
    channels_in,
    check_report,
    objects_in,
    pairs_in,
)
from .standard_streams import (
    STANDARD,
    check_one_reader,
    file_to_read,
    read_scene,
    say,
)

#: The word for a mask that is the target's alpha.
ALPHA = "alpha"


@dataclass(kw_only=True)
class FitCommand(Sampling, Compiling):
    """Find the scene that looks like a picture, starting from SCENE.

    SCENE holds the known parameters (geometry, camera) and the first guess of the free ones. Writes
    the best scene, also when it is interrupted, and says what TARGET does not determine. Exit
    status 1: the result is not to be used, as the fit did not converge, or its scene leaves more of
    TARGET unexplained than the tolerance.
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
        str | None,
        arg(
            metavar="NAMES",
            help=f"what to fit, with commas: {', '.join(NAMES)}; of some objects: color:1,3-5,kd; "
            "by default color, ka, kd, ks and where the lights are",
        ),
    ] = None
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
    colorspace: Annotated[Colorspace, arg(help="how TARGET's numbers are coded")] = "auto"
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
        str | None,
        arg(metavar="X|photo", help="the standard deviation of TARGET's numbers; photo: a + b I, "
            "their variance at level I, is estimated from TARGET"),
    ] = None  # fmt: skip
    loss: Annotated[Loss, arg(help="huber and cauchy bear outliers")] = "square"
    start: Annotated[
        Start,
        arg(help="what of SCENE to begin with: all, lights' places, or only what is not free"),
    ] = "scene"
    gauge: Annotated[
        Gauge,
        arg(help="of scenes that look the same: ka as in SCENE, color as bright as can be, or any"),
    ] = "ka"
    tolerance: Annotated[
        float, arg(metavar="X", help="the part of TARGET that may be left unexplained")
    ] = TOLERANCE
    max_steps: Annotated[int, arg(metavar="N", help="give up after so many steps in all")] = 300
    report: Annotated[
        Path | None,
        arg(metavar="DIR|FILE.html", help="a folder for a page, pictures and a table; or one page"),
    ] = None

    def run(self) -> int:
        """Fits the scene, and writes it and the report."""
        from .. import fit, read_image, save_scene
        from ..files.atomic import check_target
        from ..files.scene_writer import checked_text

        free, tie = (objects_in(f"--{n}", getattr(self, n) or "") for n in ("free", "tie"))
        free = None if self.free is None else free
        bounds = pairs_in("--bounds", self.bounds, "..")
        priors = pairs_in("--priors", self.priors, "+-")
        brightest = channels_in("--brightest", self.brightest)
        noise = self._noise()
        check_one_reader(self.scene, self.target)
        if self.output != STANDARD:
            check_target(self.output)
        check_report(self.report)
        scene = read_scene(self.scene, self.dtype)
        for option, given in (("--free", free or {}), ("--tie", tie)):
            _check_objects(option, given, scene)
        with file_to_read(self.target) as file:
            with warnings.catch_warnings():
                if self.mask == ALPHA:  # what is transparent does not count: it need not be said
                    warnings.filterwarnings("ignore", ".* are transparent", PictureWarning)
                target = read_image(file, self.colorspace, layer=self.layer)
            mask = self._mask(file)
        result = fit(
            scene, target, free=free, tie=tie, bounds=bounds, priors=priors,
            max_steps=self.max_steps, mask=mask, darkest=self.darkest,
            brightest=brightest, noise=noise, loss=self.loss, shrink=self.shrink,
            start=self.start, gauge=self.gauge, tolerance=self.tolerance, **self.settings,
        )  # fmt: skip
        if self.output == STANDARD:
            print(end=checked_text(result.scene, "standard output"))
        else:
            save_scene(self.output, result.scene)
        say(self.output, f"{self.output}: {result.trust}")
        if self.report is not None:
            for file in result.report(self.report):
                say(self.output, file)
        return 130 if result.interrupted else 0 if result.trust.ok else 1

    def _noise(self) -> float | str | None:
        """Returns the noise as `fit` takes it. **Raises:** `InputError` for other words."""
        if self.noise is None or self.noise == PHOTO:
            return self.noise
        try:
            return float(self.noise)
        except ValueError:
            raise InputError(f"--noise must be a number or {PHOTO}, got {self.noise}") from None

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
