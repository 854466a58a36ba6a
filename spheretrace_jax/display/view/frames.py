"""Frames of the window: the picture, its derivative by one number, or the residual of a target."""

from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Shaped, UInt8

from ...rendering.render import render
from ...scene.needs import Needs
from ...scene.parameters import FITTED, with_optional
from ...scene.scene import Scene
from ..figures import displayed

Kind = Literal["picture", "derivative", "residual"]
"""What a frame shows."""

# Colours of a heat map at -1, 0 and 1, in sRGB: blue, black, red; black keeps small numbers apart
# from the page.
_BELOW, _ABOVE = np.array([0.25, 0.6, 1.0]), np.array([1.0, 0.45, 0.2])


class Shown(NamedTuple):
    """What a frame is of."""

    kind: Kind
    size: tuple[int, int]  #: width and height
    bounces: int
    needs: Needs
    parameter: str = ""  #: of a derivative: the number's name, object and coordinate
    row: int = 0
    column: int = 0


class Frame(NamedTuple):
    """Pixels to show."""

    pixels: UInt8[np.ndarray, "height width 4"]  #: RGBA of a display
    scale: float  #: the number that the brightest colour of a heat map stands for; 0: no heat map


def draw_frame(scene: Scene, shown: Shown, target: np.ndarray | None) -> Frame:
    """Draws a frame, on the host. **Arguments:** `target`: a linear picture of the frame's size."""
    width, height = shown.size
    settings: dict[str, Any] = {"width": width, "height": height, "bounces": shown.bounces}
    if shown.kind == "derivative":
        scene = with_optional(scene, (shown.parameter,))
        # which number moves is an array: one program for all numbers of a name
        program = shown._replace(row=0, column=0)
        slope = _slope(scene, _direction(scene, shown), program)
        return heat_map(np.asarray(slope))
    picture = np.asarray(render(scene, needs=shown.needs, **settings))
    if shown.kind == "residual" and target is not None:
        return heat_map(picture - target)
    return Frame(_opaque(displayed(picture)), 0.0)


def _direction(scene: Scene, shown: Shown) -> Float[Array, "..."]:
    """Returns 1 for the number that is moved, 0 for all others of its array."""
    array = FITTED[shown.parameter].value(scene)
    return jnp.zeros_like(array).at[(shown.row, shown.column)[: array.ndim]].set(1)


@eqx.filter_jit
def _slope(scene: Scene, direction: Array, shown: Shown) -> Array:
    """Returns the derivative of a picture along a direction of one of the scene's arrays."""
    width, height = shown.size
    value = FITTED[shown.parameter].value

    def picture(array: Array) -> Array:
        moved = eqx.tree_at(value, scene, array)
        return render(moved, width=width, height=height, bounces=shown.bounces, needs=shown.needs)

    return jax.jvp(picture, (value(scene),), (direction,))[1]


def heat_map(numbers: Shaped[np.ndarray, "height width 3"]) -> Frame:
    """Draws the channel of each pixel that is furthest from 0: blue below, red above."""
    numbers = np.nan_to_num(numbers)
    channel = np.abs(numbers).argmax(-1, keepdims=True)
    worst = np.take_along_axis(numbers, channel, -1)
    scale = float(np.abs(worst).max()) or 1.0
    part = np.clip(worst / scale, -1, 1)
    # the root shows small numbers beside large ones
    colors = np.where(part < 0, _BELOW, _ABOVE) * np.sqrt(np.abs(part))
    return Frame(_opaque(colors), scale)


def _opaque(colors: Float[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "height width 4"]:
    pixels = np.full((*colors.shape[:2], 4), 255, np.uint8)
    pixels[..., :3] = np.round(colors * 255)
    return pixels
