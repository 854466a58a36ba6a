"""The command `spheretrace demo`: a fit of the nine spheres from a wrong start."""

from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from ..base.errors import InputError
from ..base.progress import working
from .arguments import Compiling, Dtype, check_folder


@dataclass(kw_only=True)
class DemoCommand(Compiling):
    """Fit the nine-sphere scene to a picture that POV-Ray rendered, from a wrong start.

    All colours, ka, kd, ks and the light's position start wrong and are recovered.
    """

    output: Annotated[
        Path, arg(aliases=["-o"], metavar="DIR", help="the folder to write to")
    ] = Path("spheretrace_demo")  # fmt: skip
    dtype: Dtype = "float32"

    def run(self) -> int:
        """Fits, writes the scene, its picture and a report, and prints the errors."""
        from .. import fit, load_scene, read_image, render, save_scene, write_image
        from ..study.benchmarks.wrong_start import wrong_start

        check_folder(self.output)
        data = data_folder()
        # the target's pixels are the means of 2 x 2 single rays, and so are those of the fit
        truth = load_scene(data / "nine_spheres.txt", self.dtype).with_antialias(0)
        target = read_image(data / "nine_spheres.png")
        start = wrong_start(truth)
        result = fit(start, target, samples=2)
        self.output.mkdir(parents=True, exist_ok=True)
        smooth = result.scene.with_antialias(1)
        files = [self.output / "fitted.txt", self.output / "fitted.png"]
        save_scene(files[0], smooth)
        with working("rendering the fitted scene"):
            write_image(files[1], render(smooth))
        files += result.report(self.output)
        print(f"the fit {result.trust.verdict}")
        print("largest error against the file that POV-Ray rendered:")
        _print_errors(result.scene, start, truth)
        print("written:", *files, sep="\n  ")
        return 0 if result.trust.ok else 1


def _print_errors(scene, start, truth) -> None:
    """Prints the largest error of each determined product, and that of the start."""
    from ..fit.model.products import determined_products

    fitted, first = determined_products(scene), determined_products(start)
    for name, true in determined_products(truth).items():
        error, at_start = (abs(x[name] - true).max() for x in (fitted, first))
        print(f"  {name:15} {error:9.2e}   (start: {at_start:.2e})")


def data_folder() -> Path:
    """Finds the folder of the demo's scene and picture: of the package or of the source tree."""
    installed = Path(str(resources.files("spheretrace_jax"))) / "data"
    folder = installed if installed.is_dir() else Path(__file__).parents[2] / "data"
    if not (folder / "nine_spheres.png").is_file():
        raise InputError(
            "the demo's data are missing from this installation: reinstall the package"
        )
    return folder
