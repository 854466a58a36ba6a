"""Settings of the pictures that checks draw, in float64."""

from collections.abc import Iterable
from typing import Any

import jax.numpy as jnp

from ...scene.needs import Needs, needs as needs_of
from ...scene.scene import Scene
from ...scene.settings import RenderSettings, render_settings


def double_settings(
    scene: Scene,
    width: int,
    height: int,
    *,
    needs: Needs | None,
    free: Iterable[str] = (),
    **drawn: Any,
) -> tuple[Scene, RenderSettings]:
    """Converts a scene to float64, and checks and completes the settings of its picture.

    **Arguments:** `needs`: None for those of the scene in float64, with `free` parameters.
    `drawn`: highlight, bounces and samples, as for `render`.

    **Returns:** the scene in float64, for `jax.enable_x64(True)`, and the settings.

    **Raises:** `InputError` as `render` does.
    """
    scene = scene.astype(jnp.float64)
    needs = needs_of(scene, free=free) if needs is None else needs
    return scene, render_settings(scene, width, height, needs=needs, **drawn)
