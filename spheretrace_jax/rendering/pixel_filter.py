"""The pixel filter: the mean of smooth shading over a pixel's area, from its neighbours.

The mean of a smooth f over a pixel of side s is f + s^2 (f_xx + f_yy)/24: without that what is
bright and small, as highlights are, is too bright at its centre. Second derivatives are taken as
second differences of neighbours, where no edge is between.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..base.types import Mask, Picture
from ..base.vec import Vec
from ..scene.settings import RenderSettings
from ..xla.barriers import barrier

#: A pixel and its neighbours left, right, above and below: how far to the right, and down.
NEIGHBOURS = (0, -1, 1, 0, 0), (0, 0, 0, -1, 1)


def filter_pixels(color: Vec, edge: Mask, settings: RenderSettings) -> Picture:
    """Returns the picture's rows, smooth shading averaged over the pixels' areas.

    `filter_weights` are the same filter as weights; a test holds the two together.

    **Arguments:** `color`: with the rows above and below. `edge`: where there may be edges.
    """
    across, down = _smooth_neighbours(edge, settings)
    # known once, and in one byte: in the reverse pass they are asked for five times a pixel
    sides = barrier(across.astype(jnp.int8) + 2 * down.astype(jnp.int8))
    across, down = sides & 1 > 0, sides & 2 > 0
    weight, width = _curvature_weight(settings), settings.width

    def mean(channel: Float[Array, "all width"]) -> Float[Array, "height width"]:
        shifted = _shifted(channel, settings)
        f = shifted(0)
        f_xx = shifted(-1) + shifted(1) - 2 * f
        f_yy = shifted(-width) + shifted(width) - 2 * f
        return f + (jnp.where(across, f_xx, 0) + jnp.where(down, f_yy, 0)) * weight

    return interleave(jax.tree.map(mean, color))


def filter_weights(
    edge: Mask, settings: RenderSettings, dtype: np.dtype
) -> Float[Array, "5 pixels"]:
    """Returns the filter's weights of each pixel and its `NEIGHBOURS`.

    Rows of a Jacobian are looked at pixel by pixel, not as a picture: they need the weights.
    """
    smooth = _smooth_neighbours(edge, settings)
    across, down = (_curvature_weight(settings) * m.astype(dtype) for m in smooth)
    return jnp.stack([1 - 2 * across - 2 * down, across, across, down, down]).reshape(5, -1)


def interleave(color: Vec) -> Picture:
    """Returns the three channels as one array of shape `(height, width, 3)`."""
    return jnp.stack([color.x, color.y, color.z], axis=-1)


def _curvature_weight(settings: RenderSettings) -> Float[Array, ""] | float:
    """Returns s^2/24, by which second differences count."""
    return settings.side**2 / 24


def _smooth_neighbours(edge: Mask, settings: RenderSettings) -> tuple[Mask, Mask]:
    """Tests for edges in a pixel or its neighbours: left and right, and above and below."""
    smooth = ~edge & settings.rows.within(settings.height)[:, None]
    shifted = _shifted(settings.rows.with_neighbours(smooth), settings)
    column = jnp.arange(settings.width, dtype=jnp.int32)
    inner = (column > 0) & (column < settings.width - 1)
    across = shifted(-1) & shifted(1) & inner[None, :]
    return smooth & across, smooth & shifted(-settings.width) & shifted(settings.width)


def _shifted(channel: Array, settings: RenderSettings) -> Callable[[int], Array]:
    """Returns a function from n to the numbers n pixels further on, row by row.

    **Arguments:** `channel`: with the rows above and below.
    """
    rows, width = settings.rows.count, settings.width
    flat = channel.reshape(-1)

    def shifted(by: int) -> Array:
        start = width + by
        return lax.slice(flat, (start,), (start + rows * width,)).reshape(rows, width)

    return shifted
