"""Light buffers: candidate occluders for shadow rays, binned by their direction from the light.

After Haines and Greenberg, "The Light Buffer: A Shadow-Testing Accelerator", IEEE CG&A 6, 1986. A
stereographic projection of all directions takes the place of their cube.
"""

import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from ..base.types import Ids, Mask, PixelArray, Scalar
from ..base.vec import SplitVec, Vec, cross, dot, norm, unit, where
from ..scene.light import Light
from ..xla.compaction import while_active
from .binning import (
    ROUNDING_ULPS,
    BinBounds,
    Bins,
    Cluster,
    T,
    Visitor,
    bounds_2d,
    central_range,
    max_bins,
)

# Spheres that a pixel tests per step: most pixels have fewer in their cells.
BLOCK = 2

# Margin around the direction opposite to a projection's middle, as 1 minus the cosine of the angle.
# Spheres within this margin are projected too large to be useful and go to the global list.
ANTIPODE_MARGIN = 1e-3

# Fraction of a projection's width over which cells are uniform: the region of most spheres. The
# rest is for the directions beyond, ever coarser.
UNIFORM_FRACTION = 7 / 8


class LightBuffer(eqx.Module):
    """The spheres that may occlude a light, sorted by their direction from the light."""

    projection: "LightProjection"
    bins: Bins

    def visit(
        self,
        point: Vec,
        mask: Mask,
        done: Callable[[T], Mask],
        visitor: Visitor,
        rays: Any,
        state: T,
    ) -> T:
        """Lets shadow rays from points test the spheres in their direction; see `Bins.visit`.

        **Arguments:** `point`: the lit points. `mask`: the points that have a shadow ray.
        """
        shape = mask.shape
        cell = self.bins.cell_at(*self.projection.cell_position(point))
        cell = jnp.where(mask, cell, -1).reshape(-1)
        rays, state = jax.tree.map(lambda x: x.ravel() if x.ndim else x, (rays, state))
        state = self.bins.visit(cell, visitor, rays, state, done)
        return jax.tree.map(lambda x: x.reshape(shape), state)

    def cells_around(self, point: Vec, radius: PixelArray) -> "LightCells":
        """Returns the cells in which balls around points lie, seen from the light."""
        bins = self.bins
        first, last = (
            tuple(bins.column(axis, x) for axis, x in enumerate(sides))
            for sides in self.projection.boxes(point, radius)
        )
        across, down = (b - a + 1 for a, b in zip(first, last, strict=True))
        return LightCells(bins, first, across, across * down)


class LightCells(eqx.Module):
    """A rectangle of a light buffer's cells for each pixel."""

    bins: Bins
    first: tuple[Ids, ...]  #: the first column and row
    across: Ids  #: the number of columns
    count: Ids  #: the number of cells

    def visit(
        self, mask: Mask, done: Callable[[T], Mask], visitor: Visitor, rays: Any, state: T
    ) -> T:
        """Lets pixels test the spheres in their cells; see `Bins.visit`.

        A sphere that lies in several cells of a pixel is tested once for each.
        """
        shape, bins = mask.shape, self.bins
        flat = lambda x: jnp.broadcast_to(x, shape).reshape(-1)
        count = jnp.where(mask, self.count, 0)
        pixels, state = jax.tree.map(flat, ((self.first, self.across, count, rays), state))
        state = bins.visit_global(visitor, pixels[-1], state)

        def step(pixels: tuple, now: tuple) -> tuple:
            (column, row), across, count, rays = pixels
            number, slot, state = now
            cell = bins.cell(column + lax.rem(number, across), row + lax.div(number, across))
            start, spheres = bins.slots(jnp.where(number < count, cell, -1))
            for k in range(BLOCK):
                sphere = bins.sphere_if(slot + k < spheres, start + slot + k)
                state = visitor(rays, *sphere, state)
            slot = slot + BLOCK
            more = slot < spheres
            return jnp.where(more, number, number + 1), jnp.where(more, slot, 0), state

        active = lambda pixels, now: (now[0] < pixels[2]) & ~done(now[2])
        none = jnp.zeros_like(pixels[2])
        state = while_active(step, active, pixels, (none, none, state))[-1]
        return jax.tree.map(lambda x: x.reshape(shape), state)


class LightProjection(eqx.Module):
    """A stereographic projection of all directions from a light onto a square of cells.

    From a directional light it is the orthographic projection, along its parallel rays, to which
    the stereographic one comes, but for scale, as a light moves away.

    Coordinates run from 0 to `cells` along x and y. The projection maps circles to circles, so
    that the bounding boxes of spheres, seen as circles, are exact (Snyder, "Map Projections: A
    Working Manual", 1987, ch. 21). Its middle points at the cluster of spheres, whose extent sets
    the scale. Towards the opposite direction the scale shrinks, so that the square is finite.
    """

    anchor: Vec  #: a point amid the spheres; near points are computed relative to it
    offset: Vec  #: from the light to the anchor, along the axes; 0 for a directional one
    right: Vec
    up: Vec
    forward: Vec
    middle: tuple[Scalar, Scalar]  #: of the projected cluster
    half_width: tuple[Scalar, Scalar]  #: of the projected cluster
    slack: Scalar  #: the rounding error of positions, in units of length
    cells: int = eqx.field(static=True)
    directional: bool = eqx.field(static=True)

    def from_light(self, point: Vec) -> Vec:
        """Returns the vectors from the light to points, along the axes.

        Seen from a far light all points have nearly the same direction, and rounding loses the
        rest. Differences to a near anchor keep it.
        """
        v = point - self.anchor
        v = SplitVec(dot(v, self.right), dot(v, self.up), dot(v, self.forward))
        return v + self.offset

    def cell_position(self, point: Vec) -> tuple[PixelArray, PixelArray]:
        """Returns the projected coordinates of points, in cells."""
        x, y = self.project(point)
        return self._to_cells(x, 0), self._to_cells(y, 1)

    def project(self, point: Vec) -> tuple[PixelArray, PixelArray]:
        """Projects points stereographically: the radius is tan of half the angle to forward."""
        v = self.from_light(point)
        if self.directional:
            return v.x, v.y
        w = unit(v)
        # of two equal forms the one that subtracts no nearly equal numbers
        ahead = w.z >= 0
        bottom = jnp.where(ahead, 1 + w.z, w.x * w.x + w.y * w.y)
        scale = jnp.where(ahead, 1, 1 - w.z) / jnp.where(bottom > 0, bottom, 1)
        return w.x * scale, w.y * scale

    def bounds(self, center: Vec, radius: PixelArray) -> BinBounds:
        """Bounds the projections of the scene's spheres, in cells."""
        return bounds_2d(*self.boxes(center, radius), [self.cells] * 2, step=2**0.5)

    def boxes(self, center: Vec, radius: PixelArray) -> tuple[list[PixelArray], list[PixelArray]]:
        """Returns the least and the largest coordinates of the projections of spheres, in cells.

        A cap of angular radius a around u becomes a circle. Its centre is
        (u.x, u.y) / (u.z + cos a), its radius sin a / (u.z + cos a).
        """
        v = self.from_light(center)
        if self.directional:
            return self._shadow_boxes(v, radius + self.slack)
        distance = norm(v)
        outside = distance > radius + self.slack
        per_distance = 1 / jnp.where(outside, distance, 1)
        sine = jnp.where(outside, (radius + self.slack) * per_distance, 1)
        bottom = v.z * per_distance + jnp.sqrt(jnp.maximum(1 - sine * sine, 0))
        # spheres that contain the light or the antipode may occlude in any direction
        unbounded = ~outside | (bottom < ANTIPODE_MARGIN)
        bottom = jnp.where(unbounded, 1, bottom)
        low, high = [], []
        for axis, x in enumerate((v.x, v.y)):
            x, r = x * per_distance / bottom, sine / bottom
            r = r + (ROUNDING_ULPS * jnp.finfo(r.dtype).eps) * (jnp.abs(x) + r) / bottom
            low.append(jnp.where(unbounded, 0, self._to_cells(x - r, axis)))
            high.append(jnp.where(unbounded, self.cells, self._to_cells(x + r, axis)))
        return low, high

    def _shadow_boxes(
        self, v: Vec, radius: PixelArray
    ) -> tuple[list[PixelArray], list[PixelArray]]:
        """Returns the boxes around the discs that spheres are along parallel rays."""
        low, high = [], []
        for axis, x in enumerate((v.x, v.y)):
            r = radius + (ROUNDING_ULPS * jnp.finfo(radius.dtype).eps) * (jnp.abs(x) + radius)
            low.append(self._to_cells(x - r, axis))
            high.append(self._to_cells(x + r, axis))
        return low, high

    def _to_cells(self, x: PixelArray, axis: int) -> PixelArray:
        """Converts a projected coordinate to cells: linear amid the cluster, compressed beyond.

        The map never decreases, so that intervals stay intervals.
        """
        x = (x - self.middle[axis]) / self.half_width[axis]
        far = jnp.abs(x) > 1
        compressed = jnp.sign(x) * (1 - (1 - UNIFORM_FRACTION) / jnp.where(far, jnp.abs(x), 1))
        return (jnp.where(far, compressed, x * UNIFORM_FRACTION) + 1) * (self.cells / 2)


def light_projection(light: Light, spheres: int, group: Cluster) -> LightProjection:
    """Builds the projection of a light.

    **Arguments:** `spheres`: the number of spheres. `group`: the region of most of them.
    """
    anchor, dtype = group.middle, light.place.x.dtype
    to_anchor = -light.toward(anchor)
    forward = unit(to_anchor)
    forward = where(dot(forward, forward) > 0.5, forward, SplitVec(*jnp.eye(3, dtype=dtype)[0]))
    near_x_axis = jnp.abs(forward.x) > 0.5
    zero, one = jnp.zeros_like(forward.x), jnp.ones_like(forward.x)
    right = unit(
        cross(forward, where(near_x_axis, SplitVec(zero, one, zero), SplitVec(one, zero, zero)))
    )
    up = cross(right, forward)
    offset = SplitVec(dot(to_anchor, right), dot(to_anchor, up), dot(to_anchor, forward))
    if light.directional:
        offset = SplitVec(zero, zero, zero)
    cells = int(math.sqrt(max_bins(spheres)))
    unscaled = LightProjection(
        anchor, offset, right, up, forward, (zero, zero), (one, one), group.slack, cells,
        light.directional,
    )  # fmt: skip
    region = central_range(unscaled.project(group.sample))
    return eqx.tree_at(lambda p: (p.middle, p.half_width), unscaled, tuple(map(tuple, region)))
