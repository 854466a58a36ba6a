"""`study`: error against run time of a scene's pictures, derivatives and fits; how time grows."""

import dataclasses
import os
import platform
from collections.abc import Callable, Sequence
from importlib.metadata import version
from typing import Any

import jax

from ..base.errors import InputError
from ..scene.scene import Scene
from .benchmarks.derivatives import derivatives
from .benchmarks.fits import fits
from .benchmarks.pictures import pictures
from .benchmarks.scale import scale
from .benchmarks.settings import QUICK, Settings
from .benchmarks.work_precision import Diagram

#: What can be studied, in this order.
PARTS: dict[str, Callable] = {
    "picture": pictures,
    "derivative": derivatives,
    "fit": fits,
    "scale": scale,
}


@dataclasses.dataclass(frozen=True)
class Study:
    """What was measured, and on what machine."""

    diagrams: tuple[Diagram, ...]
    machine: dict[str, str]  #: versions, device, cores
    settings: Settings


def study(
    scene: Scene,
    *,
    parts: Sequence[str] = tuple(PARTS),
    quick: bool = False,
    say: Callable[[str, str], Any] = lambda part, text: None,
    **changes: Any,
) -> Study:
    """Measures error against run time on a scene: work-precision diagrams.

    The truth of each diagram comes from a method that is not in it, and says how far it may be off
    itself. All in the precisions named; compilation is apart.

    **Arguments:** `scene`: of concrete numbers. `parts`: among picture, derivative, fit and scale.
    `quick`: about a minute instead of ten, without bounces. `say`: told which part and what of it
    is done next. `changes`: fields of `Settings`, such as `bounces` or `size`.

    **Returns:** a `Study`, which `spheretrace_jax.diagrams.write_study` makes figures of.

    **Raises:** `InputError` for parts that there are not.
    """
    unknown = [part for part in parts if part not in PARTS]
    if unknown or not parts:
        got = ", ".join(unknown) or "none"
        raise InputError(f"parts of a study must be among {', '.join(PARTS)}, got {got}")
    settings = dataclasses.replace(QUICK if quick else Settings(), **changes)
    found: list[Diagram] = []
    with jax.enable_x64(True):
        for part in parts:
            told = dataclasses.replace(settings, say=lambda text, part=part: say(part, text))
            found += PARTS[part](scene, told)
    return Study(tuple(found), machine(), settings)


def machine() -> dict[str, str]:
    """What the times depend on."""
    device = jax.devices()[0]
    packages = ("spheretrace_jax", "jax", "jaxlib", "equinox", "optimistix", "numpy")
    return {
        "device": f"{jax.device_count()} x {device.device_kind}",
        "cores": str(os.cpu_count()),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
    }
