"""Screen tiles: which spheres the rays of each 8 x 8 pixels from the eye may meet."""

import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, Shaped

from ..base.types import Mask, PixelArray
from ..base.vec import Vec, dot, norm
from ..scene.camera import Camera, view_frame
from ..xla.sharding import Rows
from .binning import SLACK, BinBounds, Bins, T, Visit, bounds_2d

# Tiles of this many pixels along each side.
TILE = 8


class ScreenTiles(eqx.Module):
    """The spheres of each tile of a picture."""

    bins: Bins
    row: Int[Array, ""] | None = None  #: of tiles, with which a strip of pixels starts, if any

    def of_strip(self, first_row: Int[Array, ""]) -> "ScreenTiles":
        """The view from pixels on that start at a row, a multiple of `TILE`."""
        return ScreenTiles(self.bins, first_row // TILE)

    def visit(self, rays: Any, meet: Visit, state: T, done: Callable[[T], Mask]) -> T:
        """What becomes of a strip's pixels by meeting the spheres of their tiles.

        **Arguments:** `rays`, `state`: what `meet` has to know of each ray, and what it changes.
        """
        shape = jax.tree.leaves(state)[0].shape
        rows, columns = (-(-n // TILE) for n in shape)
        step = self.bins.width.astype(jnp.int32)
        assert self.row is not None
        row = (self.row + jnp.arange(rows, dtype=jnp.int32)) // step
        column = jnp.arange(columns, dtype=jnp.int32) // step
        cell = self.bins.cell(column[None, :], row[:, None]).reshape(-1, 1)
        rays, state = jax.tree.map(tiles, (rays, state))
        state = self.bins.visit(cell, meet, rays, state, done)
        return jax.tree.map(lambda plane: untiled(plane, shape), state)


def tiles_in(size: tuple[int, int]) -> int:
    """How many tiles there are in a picture of a width and height in pixels."""
    return math.prod(-(-n // TILE) for n in size)


def tiles(plane: Shaped[Array, "rows columns"]) -> Shaped[Array, "tiles pixels"]:
    """A strip's pixels tile by tile; those beyond its border are like the last."""
    rows, columns = (-n % TILE for n in plane.shape)
    wide = jnp.pad(plane, ((0, rows), (0, columns)), mode="edge")
    down, across = (n // TILE for n in wide.shape)
    return wide.reshape(down, TILE, across, TILE).swapaxes(1, 2).reshape(-1, TILE**2)


def untiled(
    plane: Shaped[Array, "tiles pixels"], shape: tuple[int, int]
) -> Shaped[Array, "rows columns"]:
    """A strip's pixels row by row: `tiles` the other way round."""
    down, across = (-(-n // TILE) for n in shape)
    wide = plane.reshape(down, across, TILE, TILE).swapaxes(1, 2)
    return wide.reshape(down * TILE, across * TILE)[: shape[0], : shape[1]]


def screen_bounds(
    center: Vec, radius: PixelArray, camera: Camera, size: tuple[int, int], rows: Rows
) -> BinBounds:
    """Where spheres are in the tiles of some rows of a picture of `size` (width, height)."""
    frame, scale = view_frame(camera), camera.distance / (camera.window / size[1])
    to_center, slack = center - frame.eye, SLACK * jnp.finfo(radius.dtype).eps
    radius = radius + norm(to_center) * slack
    along = dot(to_center, frame.forward)
    shape = size[0], rows.count
    first = jnp.zeros_like(scale), jnp.asarray(rows.first, scale.dtype)
    low, high = [], []
    for side, pixels, start, count in zip(
        (frame.right, -frame.up), size, first, shape, strict=True
    ):
        left, right = tangents(dot(to_center, side), along, radius)
        left = (left * scale + (pixels / 2 - slack * pixels - start)) / TILE
        right = (right * scale + (pixels / 2 + slack * pixels - start)) / TILE
        border = count / TILE
        seen = (left < border) & (right > 0)
        low.append(jnp.where(seen, jnp.maximum(left, 0), 1))
        high.append(jnp.where(seen, jnp.minimum(right, border), 0))
    return bounds_2d(low, high, [-(-n // TILE) for n in shape], step=2.0)


def tangents(x: PixelArray, z: PixelArray, radius: PixelArray) -> tuple[PixelArray, PixelArray]:
    """Between which x/z circles lie that are seen from the origin, as far as they are at z > 0.

    The tangents' slopes m solve (z^2 - R^2) m^2 - 2 x z m + x^2 - R^2 = 0; of the two forms of
    each root the one is taken that subtracts no near numbers.

    **Arguments:** `x`, `z`: the circles' centres, the view along z.

    **Returns:** the least and the largest slope, infinite where the circle reaches sideways beyond
    all slopes, inf and -inf where it is behind.
    """
    left, x = x < 0, jnp.abs(x)
    square = radius * radius
    root = radius * jnp.sqrt(jnp.maximum(x * x + z * z - square, 0))
    beyond, before = z * z - square, z > 0
    top = jnp.where(before, x * x - square, x * z - root)
    bottom = jnp.where(before, x * z + root, beyond)
    low = jnp.where(bottom != 0, top / jnp.where(bottom != 0, bottom, 1), -jnp.inf)
    ahead = z > radius
    high = jnp.where(ahead, (x * z + root) / jnp.where(ahead, beyond, 1), jnp.inf)
    inside, behind = x * x + z * z <= square, z <= -radius
    low = jnp.where(inside, -jnp.inf, jnp.where(behind, jnp.inf, low))
    high = jnp.where(behind & ~inside, -jnp.inf, high)
    mirrored = left & ~(behind & ~inside)
    return jnp.where(mirrored, -high, low), jnp.where(mirrored, -low, high)
