"""Light buffers: which spheres may stand between a light and a point."""

import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from ..base.types import Mask, PixelArray, Scalar
from ..base.vec import Vec, cross, dot, norm, unit, where
from .binning import SLACK, BinBounds, Bins, Cluster, T, Visit, bounds_2d, central_range, most_bins

# Spheres nearer than this to the direction opposite to a chart's middle (as 1 minus the cosine of
# the angle) are everywhere.
BEHIND = 1e-3

# This part of a chart is drawn evenly.
AMID = 7 / 8


class LightBuffer(eqx.Module):
    """The spheres that may stand between a light and what it shines on."""

    chart: "LightProjection"
    bins: Bins

    def visit(
        self, point: Vec, some: Mask, meet: Visit, rays: Any, state: T, done: Callable[[T], Mask]
    ) -> T:
        """What becomes of points' states by meeting the spheres that may shade them.

        **Arguments:** `some`: which points there are. `rays`: what `meet` has to know of them.
        """
        shape = some.shape
        cell = jnp.where(some, self.bins.at(*self.chart.places(point)), -1).reshape(-1)
        rays, state = jax.tree.map(jnp.ravel, (rays, state))
        state = self.bins.visit(cell, meet, rays, state, done)
        return jax.tree.map(lambda plane: plane.reshape(shape), state)


class LightProjection(eqx.Module):
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

    def places(self, point: Vec) -> tuple[PixelArray, PixelArray]:
        """Where points are on the chart, in cells."""
        x, y = self.project(point)
        return self._cell(x, 0), self._cell(y, 1)

    def project(self, point: Vec) -> tuple[PixelArray, PixelArray]:
        """The stereographic projection of points: tan of half the angle from the middle."""
        w = unit(self.seen(point))
        # of two forms the one that subtracts no near numbers
        ahead = w.z >= 0
        bottom = jnp.where(ahead, 1 + w.z, w.x * w.x + w.y * w.y)
        scale = jnp.where(ahead, 1, 1 - w.z) / jnp.where(bottom > 0, bottom, 1)
        return w.x * scale, w.y * scale

    def layout(self, center: Vec, radius: PixelArray) -> BinBounds:
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
        return bounds_2d(low, high, [self.cells] * 2, step=2**0.5)

    def _cell(self, x: PixelArray, axis: int) -> PixelArray:
        """From the projection's coordinates to cells: evenly amid the spheres, and beyond that the
        more the further away. Never falls, so what is between two numbers stays so.
        """
        x = (x - self.middle[axis]) / self.spread[axis]
        far = jnp.abs(x) > 1
        beyond = jnp.sign(x) * (1 - (1 - AMID) / jnp.where(far, jnp.abs(x), 1))
        return (jnp.where(far, beyond, x * AMID) + 1) * (self.cells / 2)


def light_projection(light: Vec, spheres: int, group: Cluster) -> LightProjection:
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
    cells = int(math.sqrt(most_bins(spheres)))
    chart = LightProjection(
        near, offset, right, up, forward, (zero, zero), (one, one), group.slack, cells
    )
    within = central_range(chart.project(group.some))
    return eqx.tree_at(lambda c: (c.middle, c.spread), chart, tuple(map(tuple, within)))
