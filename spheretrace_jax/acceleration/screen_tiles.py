"""Screen tiles: candidate spheres of the primary rays of each 8 x 8 pixels (tiled rendering)."""

import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, Shaped

from ..base.types import Ids, PixelArray, Scalar
from ..base.vec import Vec, dot, norm
from ..scene.camera import Camera, intrinsics, view_frame
from ..xla.sharding import Rows
from .binning import ROUNDING_ULPS, BinBounds, Bins, T, Visitor, bounds_2d
from .candidate_list import Found, Search, visit_listed
from .sphere_blocks import PixelCone

# Side of a tile in pixels. Larger tiles have more candidates per ray, smaller ones more pairs to
# sort.
TILE = 8


class ScreenTiles(eqx.Module):
    """The spheres that may cover each tile of a picture, for a strip or some pixels of it."""

    bins: Bins
    row: Int[Array, ""] | None = None  #: the strip's first row of tiles
    cell: Ids | None = None  #: the cells of some pixels

    def from_row(self, first_row: Int[Array, ""]) -> "ScreenTiles":
        """Returns the tiles of a strip that starts at a pixel row, a multiple of `TILE`."""
        return ScreenTiles(self.bins, first_row // TILE)

    def of_pixels(self, column: Ids, row: Ids) -> "ScreenTiles":
        """Returns the tiles of some pixels."""
        step = self.bins.width.astype(jnp.int32)
        return ScreenTiles(
            self.bins, cell=self.bins.cell(*(x // TILE // step for x in (column, row)))
        )

    def visit(self, visitor: Visitor, rays: Any, state: T) -> T:
        """Lets the primary rays of a strip test the spheres of their tiles; see `Bins.visit`.

        **Arguments:** `rays`, `state`: pytrees of arrays of shape `(rows, columns)` or scalars.
        """
        never = lambda state: jnp.full(jax.tree.leaves(state)[0].shape, False)
        shape = jax.tree.leaves(state)[0].shape
        rows, columns = (-(-n // TILE) for n in shape)
        step = self.bins.width.astype(jnp.int32)
        assert self.row is not None
        row = (self.row + jnp.arange(rows, dtype=jnp.int32)) // step
        column = jnp.arange(columns, dtype=jnp.int32) // step
        cell = self.bins.cell(column[None, :], row[:, None]).reshape(-1, 1)
        rays, state = jax.tree.map(lambda x: to_tiles(x) if x.ndim else x, (rays, state))
        state = self.bins.visit(cell, visitor, rays, state, never)
        return jax.tree.map(lambda tiles: from_tiles(tiles, shape), state)

    def visit_nearest(
        self,
        cone: PixelCone,
        max_distance: Callable[[T], PixelArray],
        visitor: Visitor,
        rays: Any,
        state: T,
    ) -> T:
        """Lets some pixels test the nearest spheres of their tiles; see `visit_each` of blocks."""
        assert self.cell is not None
        bins = self.bins
        first, count = bins.slots(self.cell)
        everywhere, end = bins.start[1], first + count  # the spheres of the global list come first

        def step(own: tuple[PixelCone, Ids, Ids], slot: Ids, limit: PixelArray) -> Found:
            cone, first, end = own
            center, radius, _ = bins.sphere(slot)
            distance = cone.distance(center, radius)
            seen = cone.meets(center, radius) & (distance <= limit)
            new = jnp.where(slot + 1 == everywhere, first, slot + 1)
            new = jnp.where(new >= end, -1, new)
            return Found(new, jnp.where(seen, slot, -1), distance)

        start = jnp.where(everywhere > 0, 0, first)
        start = jnp.where(start < end, start, -1)
        sphere = lambda slot: bins.sphere_if(slot >= 0, jnp.maximum(slot, 0))
        search = Search(step, sphere, max_distance, (cone, first, end), start, count)
        return visit_listed(search, visitor, rays, state)


def tile_count(size: tuple[int, int]) -> int:
    """Returns the number of tiles of a picture with `size` (width, height) in pixels."""
    return math.prod(-(-n // TILE) for n in size)


def to_tiles(pixels: Shaped[Array, "rows columns"]) -> Shaped[Array, "tiles pixels"]:
    """Reorders a strip's pixels tile by tile; repeats the border to fill the last tiles."""
    rows, columns = (-n % TILE for n in pixels.shape)
    full = jnp.pad(pixels, ((0, rows), (0, columns)), mode="edge")
    down, across = (n // TILE for n in full.shape)
    return full.reshape(down, TILE, across, TILE).swapaxes(1, 2).reshape(-1, TILE**2)


def from_tiles(
    tiles: Shaped[Array, "tiles pixels"], shape: tuple[int, int]
) -> Shaped[Array, "rows columns"]:
    """Reorders a strip's pixels row by row: the inverse of `to_tiles`."""
    down, across = (-(-n // TILE) for n in shape)
    full = tiles.reshape(down, across, TILE, TILE).swapaxes(1, 2)
    return full.reshape(down * TILE, across * TILE)[: shape[0], : shape[1]]


def screen_bounds(
    center: Vec,
    radius: PixelArray,
    camera: Camera,
    size: tuple[int, int],
    rows: Rows,
    pixel: Scalar | float,
) -> BinBounds:
    """Bounds spheres on the screen, in tiles.

    **Arguments:** `size`: the picture's (width, height) in pixels. `rows`: the block of pixel rows
    that the tiles cover. `pixel`: how far from its ray a pixel reaches, in pixels.
    """
    frame, (scales, middles) = view_frame(camera), intrinsics(camera, size)
    to_center, slack = center - frame.eye, ROUNDING_ULPS * jnp.finfo(radius.dtype).eps
    least_scale = scales[1] if camera.pixel_aspect is None else jnp.minimum(*scales)
    reach, far = pixel / least_scale, norm(to_center)
    if camera.orthographic:  # its rays start at points of the eye's plane, rounded as these are
        radius = radius + reach + (far + norm(frame.eye)) * slack
    else:
        radius = radius + far * (reach + slack)
    depth = dot(to_center, frame.forward)
    bounds = parallel_bounds if camera.orthographic else tangent_slopes
    shape = size[0], rows.count
    first = jnp.zeros_like(camera.window), jnp.asarray(rows.first, camera.window.dtype)
    low, high = [], []
    axes = zip((frame.right, -frame.up), scales, middles, size, first, shape, strict=True)
    for axis, scale, middle, pixels, start, count in axes:
        least, most = bounds(dot(to_center, axis), depth, radius)
        error = slack * (pixels + abs(middle))
        least = (least * scale + (middle - error - start)) / TILE
        most = (most * scale + (middle + error - start)) / TILE
        border = count / TILE
        visible = (least < border) & (most > 0)
        low.append(jnp.where(visible, jnp.maximum(least, 0), 1))
        high.append(jnp.where(visible, jnp.minimum(most, border), 0))
    return bounds_2d(low, high, [-(-n // TILE) for n in shape], step=2.0)


def parallel_bounds(
    x: PixelArray, z: PixelArray, radius: PixelArray
) -> tuple[PixelArray, PixelArray]:
    """Bounds circles seen along parallels to z, from z = 0 on; see `tangent_slopes`."""
    behind = z <= -radius
    return jnp.where(behind, jnp.inf, x - radius), jnp.where(behind, -jnp.inf, x + radius)


def tangent_slopes(
    x: PixelArray, z: PixelArray, radius: PixelArray
) -> tuple[PixelArray, PixelArray]:
    """Bounds the slopes x/z of circles seen from the origin, as far as they lie at z > 0.

    The tangents' slopes m solve (z^2 - R^2) m^2 - 2 x z m + x^2 - R^2 = 0. Of the two forms of
    each root the code takes the one that subtracts no nearly equal numbers.

    **Arguments:** `x`, `z`: the circles' centres, with the view along z.

    **Returns:** the least and the largest slope. A bound is infinite where the circle extends
    sideways beyond all slopes; (inf, -inf) where it is behind the origin.
    """
    left, x = x < 0, jnp.abs(x)
    square = radius * radius
    root = radius * jnp.sqrt(jnp.maximum(x * x + z * z - square, 0))
    leading, center_ahead = z * z - square, z > 0
    top = jnp.where(center_ahead, x * x - square, x * z - root)
    bottom = jnp.where(center_ahead, x * z + root, leading)
    low = jnp.where(bottom != 0, top / jnp.where(bottom != 0, bottom, 1), -jnp.inf)
    ahead = z > radius
    high = jnp.where(ahead, (x * z + root) / jnp.where(ahead, leading, 1), jnp.inf)
    inside, behind = x * x + z * z <= square, z <= -radius
    low = jnp.where(inside, -jnp.inf, jnp.where(behind, jnp.inf, low))
    high = jnp.where(behind & ~inside, -jnp.inf, high)
    mirrored = left & ~(behind & ~inside)
    return jnp.where(mirrored, -high, low), jnp.where(mirrored, -low, high)
