"""Settings of the pictures that checks draw, in float64."""

from typing import Any

import jax.numpy as jnp

from ...scene.scene import Scene
from ...scene.settings import RenderSettings, render_settings


def double_settings(
    scene: Scene, width: int, height: int, **drawn: Any
) -> tuple[Scene, RenderSettings]:
    """Converts a scene to float64, and checks and completes the settings of its picture.

    **Arguments:** `drawn`: highlight, bounces, samples and needs, as for `render`.

    **Returns:** the scene in float64, for `jax.enable_x64(True)`, and the settings.

    **Raises:** `InputError` as `render` does.
    """
    scene = scene.astype(jnp.float64)
    return scene, render_settings(scene, width, height, **drawn)
