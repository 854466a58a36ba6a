"""`UniformGrid`: candidate spheres per cell of space, for rays of any origin and direction.

A ray steps from cell to cell and tests the spheres of each, until its hit is nearer than the next
cell: the 3D-DDA of Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing",
Eurographics 1987. The outermost cells extend to infinity, so that the grid covers all of space.
"""

import functools
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from ..base.types import Ids, Mask, PixelArray, Scalar
from ..base.vec import Vec, components
from ..scene.camera import Ray
from ..xla.barriers import barrier
from ..xla.compaction import while_active
from .binning import BinBounds, Bins, Cluster, T, Visitor

# Spheres that a ray tests per step of its traversal. More of them waste tests in cells with fewer
# spheres, fewer of them take more steps.
BLOCK = 2

# Bits of a packed cell index per axis: at most 2^BITS cells along an axis.
BITS = 10


class UniformGrid(eqx.Module):
    """The spheres that overlap each cell of a uniform grid."""

    low: Vec  #: the grid's lowest corner
    side: Scalar  #: of a finest cell, in units of length
    bins: Bins

    def visit(
        self,
        ray: Ray,
        mask: Mask,
        visitor: Visitor,
        rays: Any,
        state: T,
        max_distance: Callable[[T], PixelArray],
    ) -> T:
        """Lets rays test the spheres along their way, cell by cell; see `Bins.visit`.

        **Arguments:** `mask`: the rays to trace. `rays`: the rays' inputs to `visitor`.
        `max_distance`: from a state to the distance along the ray beyond which no sphere changes
        the state. A ray ends where the next cell is further away.
        """
        shape, bins = mask.shape, self.bins
        flat = lambda x: jnp.broadcast_to(x, shape).reshape(-1)
        rays, state, mask, ray = jax.tree.map(flat, (rays, state, mask, ray))
        low = jax.tree.map(flat, self.low)
        start = [x / self.side for x in components(ray.origin - low)]
        slope = [x / self.side for x in components(ray.direction)]
        state = bins.visit_global(visitor, rays, state)

        cell = _pack([bins.column(axis, x) for axis, x in enumerate(start)])
        slot = bins.slots(bins.cell(*_unpack(cell)))[0]
        now = jnp.where(mask, cell, -1), slot, state
        step = partial(self._step, visitor, max_distance)
        state = while_active(step, lambda _, now: now[0] >= 0, (rays, start, slope), now)[-1]
        return jax.tree.map(lambda x: x.reshape(shape), state)

    def _step(
        self,
        visitor: Visitor,
        max_distance: Callable[[T], PixelArray],
        context: tuple[Any, list[PixelArray], list[PixelArray]],
        now: tuple[Ids, Ids, T],
    ) -> tuple[Ids, Ids, T]:
        """Tests the next spheres of each ray's cell, and goes to the next cell after the last.

        **Arguments:** `context`: the rays' inputs, start and slope in finest cells. `now`: the
        packed cell, the slot of the next sphere, the state.
        """
        rays, start, slope = context
        cell, slot, state = now
        bins = self.bins
        end = bins.start.at[bins.cell(*_unpack(cell)) + 1].get(mode="promise_in_bounds")
        for k in range(BLOCK):
            state = visitor(rays, *bins.sphere_if((cell >= 0) & (slot + k < end), slot + k), state)
        state = barrier(state)
        slot = slot + BLOCK
        new = self._next_cell(start, slope, cell, max_distance(state))
        leaves = (cell >= 0) & (slot >= end)
        cell = jnp.where(leaves, new, cell)
        first = bins.slots(bins.cell(*_unpack(jnp.maximum(cell, 0))))[0]
        return cell, jnp.where(leaves, first, slot), state

    def _next_cell(
        self, start: list[PixelArray], slope: list[PixelArray], cell: Ids, max_distance: PixelArray
    ) -> Ids:
        """Returns the next cell along rays, -1 after the last or beyond `max_distance`."""
        columns, counts = _unpack(cell), self.bins.counts
        exits, steps = [], []
        for axis, column in enumerate(columns):
            up = slope[axis] > 0
            last = jnp.where(up, column == counts[axis] - 1, column == 0) | (slope[axis] == 0)
            border = (column + up.astype(jnp.int32)).astype(max_distance.dtype) * self.bins.width
            distance = (border - start[axis]) / jnp.where(last, 1, slope[axis])
            exits.append(jnp.where(last, jnp.inf, distance))
            steps.append(jnp.where(up, 1, -1).astype(jnp.int32))
        nearest = functools.reduce(jnp.minimum, exits)
        axes = zip(columns, exits, steps, strict=True)
        moved = [c + jnp.where(x == nearest, step, 0) for c, x, step in axes]
        ends = (nearest == jnp.inf) | (max_distance <= nearest)
        return jnp.where(ends, -1, _pack(moved))


def _pack(columns: list[Ids]) -> Ids:
    """Packs the indices of a cell along the three axes into one integer."""
    return columns[0] | columns[1] << BITS | columns[2] << 2 * BITS


def _unpack(cell: Ids) -> list[Ids]:
    """Returns the indices of a packed cell along the three axes; those of cell 0 for -1."""
    cell = jnp.maximum(cell, 0)
    return [(cell >> shift) & ((1 << BITS) - 1) for shift in (0, BITS, 2 * BITS)]


def grid_bounds(center: Vec, radius: PixelArray, group: Cluster) -> tuple[Vec, Scalar, BinBounds]:
    """Chooses the grid and bounds spheres in it.

    **Arguments:** `group`: the region of most spheres.

    **Returns:** the grid's lowest corner, the side of its finest cells, and the bounds.
    """
    most = max_grid_cells(radius.shape[0])
    # cells are cubes; there are half as many as allowed, also in a flat cluster
    largest = functools.reduce(jnp.maximum, components(group.half_width))
    ratios = [jnp.maximum(half / largest, 1 / most) for half in components(group.half_width)]
    side = 2 * largest * jnp.cbrt(math.prod(ratios) * (2 / most))
    # no more cells along an axis than fit into BITS
    side = jnp.maximum(side, largest * 2.0 ** (1 - BITS))
    corner, extent = group.middle - group.half_width, radius + group.slack
    position = components(center - corner)
    bounds = BinBounds(
        tuple((x - extent) / side for x in position),
        tuple((x + extent) / side for x in position),
        jnp.stack(components(group.half_width * 2)) / side,
        jnp.asarray(2**0.5, side.dtype),
    )
    return corner, side, bounds


def max_grid_cells(spheres: int) -> int:
    """Returns the most cells that a grid for this many spheres may have."""
    return 4 * spheres
