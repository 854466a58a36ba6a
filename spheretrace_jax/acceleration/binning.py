"""Binning: sorts spheres into the cells of a grid, with lists of fixed total size.

A sphere is listed in every cell that its bounding box overlaps. Pairs of a cell and a sphere are
sorted by integer keys, so that the spheres of each cell are contiguous. The capacity for pairs is
fixed; the cell width is chosen at run time, as narrow as the capacity allows. No list ever
overflows, whatever the spheres' sizes, and cells come out about as large as the spheres in them.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Shaped

from ..base.types import Ids, Mask, PixelArray, Scalar
from ..base.vec import SplitVec, Vec
from ..xla.compaction import prefix_sum

T = TypeVar("T")
Visitor = Callable[[Any, Vec, PixelArray, Ids, T], T]
"""`visitor(rays, center, radius, ids, state)`: the rays' new states after they test a sphere each.

A radius of nan, with the id `NO_SPHERE`, means that a ray has no sphere to test.
"""

# Spheres that rays test per iteration of the loop over their cells. For 131,072 rays four take
# 0.31 ms a sphere, one 0.42, and eight 0.26 but longer to compile.
BLOCK = 4

# Fraction of all cells above which a sphere moves to the global list that every ray tests. A
# sphere in the global list costs 0.05 ms, one more in the rays' cells 0.26.
MAX_CELL_FRACTION = 1 / 8

# Capacity for pairs of a cell and a sphere: this many per sphere, plus a constant for few large
# spheres. More capacity means narrower cells but a longer sort.
PAIRS_PER_SPHERE, EXTRA_PAIRS = 3, 1 << 14

# The id for "no sphere to test"; -1 is taken by "hit no sphere".
NO_SPHERE = -2

# Bound on rounding errors, in units of the last place of the largest length involved: half a
# dozen operations find a hit. Bounding boxes grow by this bound.
ROUNDING_ULPS = 16

# Number of spheres, evenly spaced in the table, that estimate the region of most spheres, and the
# quantile that bounds the region: 3 % of the centres are cut off at each end of each axis. More
# samples take longer to sort; a higher quantile makes cells coarser where there are outliers.
CLUSTER_SAMPLES, CLUSTER_QUANTILE = 1 << 10, 0.97

# Distance, in extents of the cluster, up to which the slack of bounding boxes covers the rounding
# of positions. A larger distance makes all boxes larger.
CLUSTER_EXTENTS = 16


class CoveredCells(NamedTuple):
    """The block of cells that each sphere's bounding box overlaps, for one cell width."""

    low: list[Ids]  #: the first column along each axis
    spans: list[Ids]  #: the number of columns along each axis
    wide: Mask  #: the sphere belongs to the global list
    pairs: Ids  #: the number of pairs: cells, 1 if `wide`, 0 for an empty box


class BinBounds(eqx.Module):
    """A grid and the bounding boxes of n spheres on it, in units of the finest cells.

    Boxes are of any finite size. A box with `low > high` along an axis is empty.
    """

    low: tuple[Float[Array, " n"], ...]  #: along each of three axes
    high: tuple[Float[Array, " n"], ...]
    size: Float[Array, " axes"]  #: the number of finest cells along each axis
    step: Scalar  #: the factor by which cells widen until the pairs fit

    def counts(self, width: Scalar) -> Float[Array, " axes"]:
        """Returns the number of cells along each axis."""
        return jnp.maximum(jnp.ceil(self.size / width), 1)

    def covered_cells(self, width: Scalar) -> CoveredCells:
        """Finds the cells of a width that each sphere's box overlaps."""
        counts = self.counts(width).astype(jnp.int32)
        low = [_column(x, width, m) for x, m in zip(self.low, counts, strict=True)]
        high = [_column(x, width, m) for x, m in zip(self.high, counts, strict=True)]
        spans = [b - a + 1 for a, b in zip(low, high, strict=True)]
        cells = math.prod(spans)
        most = jnp.maximum(jnp.prod(self.counts(width)) * MAX_CELL_FRACTION, 1)
        wide = cells > most.astype(jnp.int32)
        exists = [a <= b for a, b in zip(self.low, self.high, strict=True)]
        exists = functools.reduce(jnp.logical_and, exists)
        return CoveredCells(low, spans, wide, jnp.where(exists, jnp.where(wide, 1, cells), 0))


def bounds_2d(low: Sequence, high: Sequence, size: Sequence, step: float) -> BinBounds:
    """Builds the `BinBounds` of a grid with two axes."""
    zero = jnp.zeros_like(low[0])
    sizes = jnp.asarray([*size, 1], zero.dtype)
    return BinBounds((*low, zero), (*high, zero), sizes, jnp.asarray(step, zero.dtype))


class Bins(eqx.Module):
    """The spheres of each cell, contiguous in arrays of fixed size; cell 0 is the global list."""

    center: Vec  #: of the spheres of cell 0, then of cell 1, ...
    radius: Float[Array, " pairs"]
    ids: Int[Array, " pairs"]  #: the sphere's row in the tables
    start: Int[Array, " cells"]  #: the slot of each cell's first sphere
    width: Scalar  #: of a cell, in finest cells
    counts: Int[Array, " axes"]  #: the number of cells along each axis

    def cell_at(self, *position: PixelArray) -> Ids:
        """Returns the cells at positions in finest cells; outside of the grid the nearest."""
        return self.cell(*(self.column(axis, x) for axis, x in enumerate(position)))

    def column(self, axis: int, position: PixelArray) -> Ids:
        """Returns the index along an axis of the cell that contains a coordinate."""
        return _column(position, self.width, self.counts[axis])

    def cell(self, *columns: Ids) -> Ids:
        """Returns the cells with these indices along each axis."""
        return _cell_index(columns, self.counts)

    def visit(
        self,
        cell: Ids,
        visitor: Visitor,
        rays: Any,
        state: T,
        done: Callable[[T], Mask],
    ) -> T:
        """Lets rays test the spheres of the global list, then those of their cells.

        **Arguments:** `cell`: per ray, or per group of rays; -1 for none. `rays`: the rays' inputs
        to `visitor`; `rays` and `state` are pytrees of arrays of shape `(n, ...)`. `done`: the mask
        of states that no further sphere changes.

        **Returns:** the rays' final states.
        """
        state = self.visit_global(visitor, rays, state)
        first, count = self.slots(cell)
        end = first + count

        def proceed(now: tuple) -> Bool[Array, ""]:
            return jnp.any((now[0] < end) & ~done(now[1]))

        def step(now: tuple) -> tuple:
            slot, state = now
            for k in range(BLOCK):
                state = visitor(rays, *self.sphere_if(slot + k < end, slot + k), state)
            return jnp.minimum(slot + BLOCK, end), state

        # all rays stay in the loop: to compact the active ones takes longer (18 against 14 ms for
        # 100,000 spheres)
        return lax.while_loop(proceed, step, (first, state))[1]

    def visit_global(self, visitor: Visitor, rays: Any, state: T) -> T:
        """Lets rays test the spheres of the global list; see `visit`."""
        test = lambda k, state: visitor(rays, *self.sphere(k), state)
        return lax.fori_loop(0, self.start[1], test, state)

    def slots(self, cell: Ids) -> tuple[Ids, Ids]:
        """Returns the first slot of each cell and its number of spheres, 0 for cell -1."""
        first = take(self.start, jnp.maximum(cell, 0))
        return first, jnp.where(cell >= 0, take(self.start, jnp.maximum(cell, 0) + 1) - first, 0)

    def sphere(self, slot: Ids) -> tuple[Vec, PixelArray, Ids]:
        """Returns centre, radius and id of the spheres in slots."""
        slot = jnp.minimum(slot, self.ids.size - 1)
        return jax.tree.map(lambda x: take(x, slot), (self.center, self.radius, self.ids))

    def sphere_if(self, mask: Mask, slot: Ids) -> tuple[Vec, PixelArray, Ids]:
        """Returns `sphere(slot)` where `mask` is set, else radius nan and `NO_SPHERE`."""
        center, radius, ids = self.sphere(slot)
        return center, jnp.where(mask, radius, jnp.nan), jnp.where(mask, ids, NO_SPHERE)


def build_bins(center: Vec, radius: PixelArray, bounds: BinBounds, max_cells: int) -> Bins:
    """Sorts spheres into the cells of several grids.

    One `lax.map` over all grids compiles the sort only once.

    **Arguments:** `bounds`: of all grids, stacked. `max_cells`: per grid.

    **Returns:** the bins of all grids, stacked.
    """
    return lax.map(lambda grid: _sort_into_cells(center, radius, grid, max_cells), bounds)


def _sort_into_cells(center: Vec, radius: PixelArray, bounds: BinBounds, max_cells: int) -> Bins:
    """Sorts spheres into the narrowest cells for which the pairs fit the capacity."""
    capacity = _pair_capacity(radius.shape[0])
    too_narrow = lambda width: _overflows(bounds, width, max_cells, capacity)
    # a single cell always has room for all spheres, so the loop ends
    start = jnp.ones((), radius.dtype)
    width = lax.while_loop(too_narrow, lambda width: width * bounds.step, start)
    counts = bounds.counts(width).astype(jnp.int32)
    covered = bounds.covered_cells(width)
    no_cell = jnp.prod(counts, dtype=jnp.int32) + 1
    ids, cell = _expand_pairs(covered, counts, no_cell, capacity)
    ids = take(ids, stable_order(cell, no_cell))
    # counting sort: the histogram of the cells gives their first slots
    filled = jnp.zeros(max_cells + 2, jnp.int32).at[cell].add(1)
    center, radius = jax.tree.map(lambda column: take(column, ids), (center, radius))
    return Bins(center, radius, ids, prefix_sum(filled) - filled, width, counts)


def _overflows(bounds: BinBounds, width: Scalar, max_cells: int, capacity: int) -> Bool[Array, ""]:
    """Tests whether cells of a width are too many, or their pairs exceed the capacity."""
    pairs = bounds.covered_cells(width).pairs
    # the integer sum is exact but may overflow; the float sum rules that out
    approximate = jnp.sum(pairs.astype(jnp.float32))
    fits = (approximate < 2 * capacity) & (jnp.sum(pairs, dtype=jnp.int32) <= capacity)
    return (jnp.prod(bounds.counts(width)) > max_cells) | ~fits


def _expand_pairs(
    covered: CoveredCells, counts: Int[Array, " axes"], no_cell: Int[Array, ""], capacity: int
) -> tuple[Int[Array, " pairs"], Int[Array, " pairs"]]:
    """Lists all pairs, sphere by sphere. **Returns:** sphere and cell, `no_cell` when unused."""
    # a slot belongs to the last sphere whose pairs start at or before it
    end = prefix_sum(covered.pairs)
    start = end - covered.pairs
    slot = jnp.arange(capacity, dtype=jnp.int32)
    ids = prefix_sum(jnp.zeros(capacity, jnp.int32).at[start].add(1, mode="drop")) - 1
    rest, columns = slot - take(start, ids), []
    for first, span in zip(covered.low, covered.spans, strict=True):
        span = take(span, ids)
        columns.append(take(first, ids) + lax.rem(rest, span))
        rest = lax.div(rest, span)
    cell = jnp.where(take(covered.wide, ids), 0, _cell_index(columns, counts))
    return ids, jnp.where(slot < end[-1], cell, no_cell)


class Cluster(eqx.Module):
    """The region of most spheres, robust against a few outliers."""

    sample: Vec  #: the centres of evenly chosen spheres
    middle: Vec  #: of the region, along each axis
    half_width: Vec  #: of the region; 1 along an axis across which all centres are equal
    slack: Scalar  #: the rounding error of positions near the region, in units of length


def cluster(center: Vec, radius: PixelArray) -> Cluster:
    """Estimates the region of most spheres from quantiles of a sample."""
    stride = -(-radius.shape[0] // CLUSTER_SAMPLES)
    sample, radii = jax.tree.map(lambda x: x[::stride], (center, radius))
    middle, half = central_range((sample.x, sample.y, sample.z, radii))
    extent = jnp.sum(half[:3]) + (middle[3] + half[3])
    slack = CLUSTER_EXTENTS * ROUNDING_ULPS * jnp.finfo(radius.dtype).eps * extent
    return Cluster(sample, SplitVec(*middle[:3]), SplitVec(*half[:3]), slack)


def central_range(
    columns: Sequence[Float[Array, " n"]],
) -> tuple[Float[Array, " columns"], Float[Array, " columns"]]:
    """Returns the middle and half the width of the range between two quantiles of each column.

    The half width is 1 where the quantiles are equal.
    """
    # one sort for all columns: a floating-point sort takes 0.3 s to compile
    values = jnp.sort(jnp.stack(list(columns)), axis=1)
    last = values.shape[1] - 1
    low = values[:, int((1 - CLUSTER_QUANTILE) * last)]
    high = values[:, int(CLUSTER_QUANTILE * last)]
    return (low + high) / 2, jnp.where(high > low, (high - low) / 2, 1)


def max_bins(spheres: int) -> int:
    """Returns how many cells one pass of the sort can tell apart, or two if these are too few."""
    digit = 32 - (_pair_capacity(spheres) - 1).bit_length()
    return min(1 << digit if 16 << digit >= spheres else 1 << 2 * digit, 8 * spheres) - 2


def _pair_capacity(spheres: int) -> int:
    """Returns how many pairs of a cell and a sphere fit."""
    return PAIRS_PER_SPHERE * spheres + EXTRA_PAIRS


def stable_order(cell: Ids, last: Int[Array, ""]) -> Ids:
    """Returns the permutation that sorts cells 0..`last` stably (radix sort, lowest digit first).

    A key is one integer of a digit and a position: 41 ns each, where pairs of a cell and a position
    take 300. The digit has the bits that the position leaves free.
    """
    position = jnp.arange(cell.size, dtype=jnp.uint32)
    bits = (cell.size - 1).bit_length()

    def sort(now: tuple[Int[Array, ""], Ids]) -> tuple[Int[Array, ""], Ids]:
        shift, order = now
        digit = (take(cell, order) >> shift).astype(jnp.uint32)
        keys = jnp.sort(digit << bits | position)
        return shift + (32 - bits), take(order, (keys & ((1 << bits) - 1)).astype(jnp.int32))

    digits_left = lambda now: last >> now[0] > 0
    return lax.while_loop(digits_left, sort, (jnp.int32(0), position.astype(jnp.int32)))[1]


def _column(position: PixelArray, width: Scalar, count: Ids) -> Ids:
    """Returns the index along an axis of the cell that contains a coordinate, clamped."""
    last = (count - 1).astype(position.dtype)
    return jnp.clip(position / width, 0, last).astype(jnp.int32)


def _cell_index(columns: Sequence[Ids], counts: Int[Array, " axes"]) -> Ids:
    """Returns the flat index of cells, from 1 on: cell 0 is the global list."""
    index = jnp.zeros_like(columns[-1])
    for k in reversed(range(len(columns))):
        index = index * counts[k] + columns[k]
    return index + 1


def take(column: Shaped[Array, " rows"], index: Ids) -> Shaped[Array, "*#pixels"]:
    """Returns the rows of a column at indices in bounds."""
    return column.at[index].get(mode="promise_in_bounds")
