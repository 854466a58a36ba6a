"""Charts of what is seen from a point, from the eye or from a light, with lists of spheres.

All rays through one point are points of a picture, and spheres are spots in it: a ray only meets
spheres whose spots' boxes are in the ray's cell of the chart. From the eye the chart is the window
itself, and its cells are tiles of pixels, whose rays look at one list together. From a light it is
a stereographic one, that shows all directions.
"""

import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, Shaped

from ._types import Mask, Plane, Scalar
from .camera import view_frame
from .cells import (
    SLACK,
    Cells,
    Cluster,
    Layout,
    Meet,
    T,
    flat_layout,
    most_cells,
    most_within,
)
from .scene import Camera
from .sharding import Rows
from .vec import Vec, cross, dot, norm, unit, where

# Tiles of this many pixels along each side.
TILE = 8

# Spheres nearer than this to the direction opposite to a chart's middle (as 1 minus the cosine of
# the angle) are everywhere.
BEHIND = 1e-3

# This part of a chart is drawn evenly.
AMID = 7 / 8


class View(eqx.Module):
    """The spheres of each tile of a picture."""

    cells: Cells
    row: Int[Array, ""] | None = None  #: of tiles, with which a strip of pixels starts, if any

    def of_strip(self, first_row: Int[Array, ""]) -> "View":
        """The view from pixels on that start at a row, a multiple of `TILE`."""
        return View(self.cells, first_row // TILE)

    def over(self, rays: Any, meet: Meet, state: T, done: Callable[[T], Mask]) -> T:
        """What becomes of a strip's pixels by meeting the spheres of their tiles.

        **Arguments:** `rays`, `state`: what `meet` has to know of each ray, and what it changes.
        """
        shape = jax.tree.leaves(state)[0].shape
        rows, columns = (-(-n // TILE) for n in shape)
        step = self.cells.width.astype(jnp.int32)
        assert self.row is not None
        row = (self.row + jnp.arange(rows, dtype=jnp.int32)) // step
        column = jnp.arange(columns, dtype=jnp.int32) // step
        cell = self.cells.cell(column[None, :], row[:, None]).reshape(-1, 1)
        rays, state = jax.tree.map(tiles, (rays, state))
        state = self.cells.over(cell, meet, rays, state, done)
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


def layout_of_view(
    center: Vec, radius: Plane, camera: Camera, size: tuple[int, int], rows: Rows
) -> Layout:
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
    return flat_layout(low, high, [-(-n // TILE) for n in shape], step=2.0)


def tangents(x: Plane, z: Plane, radius: Plane) -> tuple[Plane, Plane]:
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


class Lamp(eqx.Module):
    """The spheres that may stand between a light and what it shines on."""

    chart: "Chart"
    cells: Cells

    def over(
        self, point: Vec, some: Mask, meet: Meet, rays: Any, state: T, done: Callable[[T], Mask]
    ) -> T:
        """What becomes of points' states by meeting the spheres that may shade them.

        **Arguments:** `some`: which points there are. `rays`: what `meet` has to know of them.
        """
        shape = some.shape
        cell = jnp.where(some, self.cells.at(*self.chart.places(point)), -1).reshape(-1)
        rays, state = jax.tree.map(jnp.ravel, (rays, state))
        state = self.cells.over(cell, meet, rays, state, done)
        return jax.tree.map(lambda plane: plane.reshape(shape), state)


class Chart(eqx.Module):
    """A flat picture of all directions from a light: cells count from 0 to `cells` along x and y.

    A stereographic projection: circles around a direction, as spheres are seen, stay circles, so
    their boxes are exact (Snyder, "Map Projections: A Working Manual", 1987, ch. 21). Its middle
    is where the spheres are; there it is drawn to the scale that they need, and towards the
    opposite direction ever smaller, so that the whole of it has a finite size.
    """

    near: Vec  #: a point amid the spheres: what is near is computed from here, not from the light
    offset: Vec  #: from the light to it, along the axes
    right: Vec
    up: Vec
    forward: Vec
    middle: tuple[Scalar, Scalar]  #: of the spheres' pictures
    spread: tuple[Scalar, Scalar]  #: how far they reach from there
    slack: Scalar  #: what rounding may move, in units of length
    cells: int = eqx.field(static=True)

    def seen(self, point: Vec) -> Vec:
        """Points seen from the light, along the axes.

        From a far light everything is in nearly the same direction: what is left of that after
        rounding is too little, where differences to a point near by keep theirs.
        """
        away = point - self.near
        away = Vec(dot(away, self.right), dot(away, self.up), dot(away, self.forward))
        return away + self.offset

    def places(self, point: Vec) -> tuple[Plane, Plane]:
        """Where points are on the chart, in cells."""
        x, y = self.project(point)
        return self._cell(x, 0), self._cell(y, 1)

    def project(self, point: Vec) -> tuple[Plane, Plane]:
        """The stereographic projection of points: tan of half the angle from the middle."""
        w = unit(self.seen(point))
        # of two forms the one that subtracts no near numbers
        ahead = w.z >= 0
        bottom = jnp.where(ahead, 1 + w.z, w.x * w.x + w.y * w.y)
        scale = jnp.where(ahead, 1, 1 - w.z) / jnp.where(bottom > 0, bottom, 1)
        return w.x * scale, w.y * scale

    def layout(self, center: Vec, radius: Plane) -> Layout:
        """Where spheres are on the chart: a cap of angular radius a around u is a circle around
        (u.x, u.y) / (u.z + cos a) of radius sin a / (u.z + cos a).
        """
        v = self.seen(center)
        distance = norm(v)
        outside = distance > radius + self.slack
        per = 1 / jnp.where(outside, distance, 1)
        sine = jnp.where(outside, (radius + self.slack) * per, 1)
        bottom = v.z * per + jnp.sqrt(jnp.maximum(1 - sine * sine, 0))
        # what is around the light, or opposite to the middle, is everywhere
        whole = ~outside | (bottom < BEHIND)
        bottom = jnp.where(whole, 1, bottom)
        low, high = [], []
        for axis, x in enumerate((v.x, v.y)):
            x, r = x * per / bottom, sine / bottom
            r = r + (SLACK * jnp.finfo(r.dtype).eps) * (jnp.abs(x) + r) / bottom
            low.append(jnp.where(whole, 0, self._cell(x - r, axis)))
            high.append(jnp.where(whole, self.cells, self._cell(x + r, axis)))
        return flat_layout(low, high, [self.cells] * 2, step=2**0.5)

    def _cell(self, x: Plane, axis: int) -> Plane:
        """From the projection's coordinates to cells: evenly amid the spheres, and beyond that the
        more the further away. Never falls, so what is between two numbers stays so.
        """
        x = (x - self.middle[axis]) / self.spread[axis]
        far = jnp.abs(x) > 1
        beyond = jnp.sign(x) * (1 - (1 - AMID) / jnp.where(far, jnp.abs(x), 1))
        return (jnp.where(far, beyond, x * AMID) + 1) * (self.cells / 2)


def chart_of(light: Vec, spheres: int, group: Cluster) -> Chart:
    """The chart of a light. **Arguments:** `spheres`, `group`: how many there are, and where."""
    near, dtype = group.middle, light.x.dtype
    forward = unit(near - light)
    forward = where(dot(forward, forward) > 0.5, forward, Vec(*jnp.eye(3, dtype=dtype)[0]))
    flat = jnp.abs(forward.x) > 0.5
    zero, one = jnp.zeros_like(forward.x), jnp.ones_like(forward.x)
    right = unit(cross(forward, where(flat, Vec(zero, one, zero), Vec(one, zero, zero))))
    up = cross(right, forward)
    offset = near - light
    offset = Vec(dot(offset, right), dot(offset, up), dot(offset, forward))
    cells = int(math.sqrt(most_cells(spheres)))
    chart = Chart(near, offset, right, up, forward, (zero, zero), (one, one), group.slack, cells)
    within = most_within(chart.project(group.some))
    return eqx.tree_at(lambda c: (c.middle, c.spread), chart, tuple(map(tuple, within)))
