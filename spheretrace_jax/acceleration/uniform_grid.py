"""`Grid`: boxes in space with lists of their spheres, for rays from anywhere to anywhere.

A ray steps from box to box and looks at the spheres of each, until what it has met is nearer than
the next box (Amanatides, Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", Eurographics
1987). The outermost boxes reach to infinity, so nothing is outside of the grid.
"""

import functools
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from ..base.types import Ids, Mask, PixelArray, Scalar
from ..base.vec import Vec, parts
from ..scene.camera import Ray
from ..xla.barriers import barrier
from ..xla.compaction import while_active
from .binning import BinBounds, Bins, Cluster, T, Visit

# Rays look at this many spheres at each step.
BLOCK = 2


class UniformGrid(eqx.Module):
    """The spheres of each box of space."""

    low: Vec  #: a corner of the grid
    side: Scalar  #: of a finest cell
    bins: Bins

    def visit(
        self,
        ray: Ray,
        alive: Mask,
        meet: Visit,
        rays: Any,
        state: T,
        reach: Callable[[T], PixelArray],
    ) -> T:
        """What becomes of rays' states when they meet the spheres along them.

        **Arguments:** `alive`: which rays there are. `rays`: what `meet` has to know of them.
        `reach`: from a state to how far along the ray it matters what is met: where the next box
        is further away than that, a ray ends.
        """
        shape, cells = alive.shape, self.bins
        flat = lambda x: jnp.broadcast_to(x, shape).reshape(-1)
        rays, state, alive, ray = jax.tree.map(flat, (rays, state, alive, ray))
        low = jax.tree.map(flat, self.low)
        start = [x / self.side for x in parts(ray.origin - low)]
        slope = [x / self.side for x in parts(ray.direction)]
        state = lax.fori_loop(0, cells.start[1], lambda k, s: meet(rays, *cells.row(k), s), state)

        def step(given: tuple, now: tuple) -> tuple:
            rays, start, slope = given
            box, slot, state = now
            end = cells.start.at[cells.cell(*_columns(box)) + 1].get(mode="promise_in_bounds")
            for k in range(BLOCK):
                state = meet(rays, *cells.row_if((box >= 0) & (slot + k < end), slot + k), state)
            state = barrier(state)
            slot = slot + BLOCK
            new = self._next(start, slope, box, reach(state))
            leaves = (box >= 0) & (slot >= end)
            box = jnp.where(leaves, new, box)
            first = cells.range(cells.cell(*_columns(jnp.maximum(box, 0))))[0]
            return box, jnp.where(leaves, first, slot), state

        box = _packed([cells.along(axis, x) for axis, x in enumerate(start)])
        slot = cells.range(cells.cell(*_columns(box)))[0]
        now = jnp.where(alive, box, -1), slot, state
        state = while_active(step, lambda _, now: now[0] >= 0, (rays, start, slope), now)[-1]
        return jax.tree.map(lambda x: x.reshape(shape), state)

    def _next(
        self, start: list[PixelArray], slope: list[PixelArray], box: Ids, reach: PixelArray
    ) -> Ids:
        """The box after one on rays, -1 after the last, or if it is further away than `reach`."""
        columns, counts = _columns(box), self.bins.counts
        exits, ahead = [], []
        for axis, column in enumerate(columns):
            up = slope[axis] > 0
            last = jnp.where(up, column == counts[axis] - 1, column == 0) | (slope[axis] == 0)
            border = (column + up.astype(jnp.int32)).astype(reach.dtype) * self.bins.width
            away = (border - start[axis]) / jnp.where(last, 1, slope[axis])
            exits.append(jnp.where(last, jnp.inf, away))
            ahead.append(jnp.where(up, 1, -1).astype(jnp.int32))
        exit_ = functools.reduce(jnp.minimum, exits)
        steps = zip(columns, exits, ahead, strict=True)
        moved = [c + jnp.where(x == exit_, a, 0) for c, x, a in steps]
        ends = (exit_ == jnp.inf) | (reach <= exit_)
        return jnp.where(ends, -1, _packed(moved))


# A box's place along each axis takes up this many bits of a number.
BITS = 10


def _packed(columns: list[Ids]) -> Ids:
    return columns[0] | columns[1] << BITS | columns[2] << 2 * BITS


def _columns(box: Ids) -> list[Ids]:
    box = jnp.maximum(box, 0)
    return [(box >> shift) & ((1 << BITS) - 1) for shift in (0, BITS, 2 * BITS)]


def grid_bounds(center: Vec, radius: PixelArray, group: Cluster) -> tuple[Vec, Scalar, BinBounds]:
    """A corner of the grid, the side of its finest boxes, and where spheres are in it.

    **Arguments:** `group`: where most of the spheres are.
    """
    most = most_boxes(radius.shape[0])
    # boxes are cubes, and half as many as there may be, of a flat cluster too
    largest = functools.reduce(jnp.maximum, parts(group.half))
    thin = [jnp.maximum(half / largest, 1 / most) for half in parts(group.half)]
    side = 2 * largest * jnp.cbrt(math.prod(thin) * (2 / most))
    # no more along an axis than there are numbers for
    side = jnp.maximum(side, largest * 2.0 ** (1 - BITS))
    corner, reach = group.middle - group.half, radius + group.slack
    away = parts(center - corner)
    layout = BinBounds(
        tuple((x - reach) / side for x in away),
        tuple((x + reach) / side for x in away),
        jnp.stack(parts(group.half * 2)) / side,
        jnp.asarray(2**0.5, side.dtype),
    )
    return corner, side, layout


def most_boxes(spheres: int) -> int:
    """How many boxes there may be."""
    return 4 * spheres
