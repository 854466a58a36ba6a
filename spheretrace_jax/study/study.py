"""`study`: error against run time of a scene's pictures, derivatives and fits, and scaling."""

import dataclasses
import os
import platform
from collections.abc import Callable, Sequence
from functools import partial
from importlib.metadata import version
from typing import Any

import jax

from ..base.errors import InputError
from ..base.progress import working
from ..scene.scene import Scene, check_scene
from .benchmarks.derivatives import derivatives
from .benchmarks.fits import fits
from .benchmarks.pictures import pictures
from .benchmarks.scale import scale
from .benchmarks.settings import QUICK, Settings
from .benchmarks.work_precision import Diagram

#: The parts of a study, in their order.
PARTS: dict[str, Callable] = {
    "picture": pictures,
    "derivative": derivatives,
    "fit": fits,
    "scale": scale,
}


@dataclasses.dataclass(frozen=True)
class Study:
    """The measured diagrams, with the machine and the settings."""

    diagrams: tuple[Diagram, ...]
    machine: dict[str, str]  #: versions, device, cores
    settings: Settings


def study(
    scene: Scene,
    *,
    parts: str | Sequence[str] = tuple(PARTS),
    quick: bool = False,
    **changes: Any,
) -> Study:
    """Measures error against run time on a scene: work-precision diagrams.

    The reference of each diagram comes from a method that is not in the diagram, and has an
    uncertainty. Each curve names its precision. Times do not include compilation.

    **Arguments:** `scene`: of concrete numbers. `parts`: among picture, derivative, fit and scale.
    `quick`: about a minute instead of ten, without bounces. `changes`: fields of `Settings`, as
    `bounces` or `size`.

    **Returns:** a `Study`, which `spheretrace_jax.display.study_report.write_study` draws.

    **Raises:** `InputError` for unknown parts.
    """
    scene = check_scene(scene)
    parts = [parts] if isinstance(parts, str) else parts
    unknown = [part for part in parts if part not in PARTS]
    if unknown or not parts:
        got = ", ".join(unknown) or "none"
        raise InputError(f"parts of a study must be among {', '.join(PARTS)}, got {got}")
    settings = dataclasses.replace(QUICK if quick else Settings(), **changes)
    diagrams: list[Diagram] = []
    with jax.enable_x64(True), working("studying", len(parts)) as step:
        for k, part in enumerate(parts):
            of_part = dataclasses.replace(settings, say=partial(step, done=k))
            diagrams += PARTS[part](scene, of_part)
    return Study(tuple(diagrams), machine(), settings)


def machine() -> dict[str, str]:
    """Describes the machine and the versions that the times depend on."""
    device = jax.devices()[0]
    packages = ("spheretrace_jax", "jax", "jaxlib", "equinox", "optimistix", "numpy")
    return {
        "device": f"{jax.device_count()} x {device.device_kind}",
        "cores": str(os.cpu_count()),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
    }
