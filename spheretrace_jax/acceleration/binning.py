"""`Cells`: which of very many spheres may be met in each cell of a grid, in lists of fixed size.

A sphere is listed in every cell that a box around it touches: pairs of a cell and a sphere, sorted
by one sort of whole numbers, so that each cell's spheres lie side by side. The room for pairs is
fixed, and how wide the cells are is found out at run time: as narrow as there is room for. So no
list ever overflows, whatever the spheres' sizes, and the cells come out about as large as what is
in them.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Shaped

from ..base.types import Ids, Mask, PixelArray, Scalar
from ..base.vec import Vec
from ..xla.compaction import prefix_sum

T = TypeVar("T")
Visit = Callable[[Any, Vec, PixelArray, Ids, T], T]
"""What becomes of rays' states when they meet spheres: centre, radius (nan: none) and number."""

# Rays look at this many spheres of their cells at a time: 0.31 ms a sphere for 131,072 rays, where
# one at a time takes 0.42, and eight 0.26 but longer to compile.
BLOCK = 4

# A sphere in more than this part of all cells is in a list that all rays look at: that takes them
# 0.05 ms a sphere, where one more in their cells takes 0.26.
WIDE = 1 / 8

# Room for this many pairs per sphere, and for some more where spheres are few and large.
PAIRS, MORE_PAIRS = 3, 1 << 14


# The number of no sphere, nor of what is not a sphere, -1.
NOBODY = -2

# What rounding may move, in units of the last place of the largest length that is involved: the
# operations that find a hit are half a dozen.
SLACK = 16

# So many of the spheres, evenly chosen, tell where most of them are: this part.
SAMPLE, MOST = 1 << 10, 0.97

# Nothing further away than so many times the spheres' reach casts doubt on their lists.
FAR = 16


class BinBounds(eqx.Module):
    """A grid, and where n spheres are in it: a box around each, in finest cells.

    Boxes are of any finite size; where `low > high` along some axis the sphere is nowhere.
    """

    low: tuple[Float[Array, " n"], ...]  #: along each of three axes
    high: tuple[Float[Array, " n"], ...]
    size: Float[Array, " axes"]  #: how many finest cells there are along each axis
    step: Scalar  #: by how much cells are wider where there is no room for narrower ones


def bounds_2d(low: Sequence, high: Sequence, size: Sequence, step: float) -> BinBounds:
    """A layout of only two axes."""
    zero = jnp.zeros_like(low[0])
    sizes = jnp.asarray([*size, 1], zero.dtype)
    return BinBounds((*low, zero), (*high, zero), sizes, jnp.asarray(step, zero.dtype))


class Bins(eqx.Module):
    """The spheres of each cell, side by side."""

    center: Vec  #: of the spheres of cell 0, of cell 1, ...
    radius: Float[Array, " pairs"]
    number: Int[Array, " pairs"]  #: which sphere it is
    start: Int[Array, " cells"]  #: where each cell's spheres start; cell 0 is everywhere
    width: Scalar  #: of a cell, in finest cells
    counts: Int[Array, " axes"]  #: how many cells there are along each axis

    def at(self, *places: PixelArray) -> Ids:
        """The cells at some places, in finest cells; outside of the grid the nearest."""
        return self.cell(*(self.along(axis, x) for axis, x in enumerate(places)))

    def along(self, axis: int, place: PixelArray) -> Ids:
        """Which cell along an axis a coordinate is in."""
        return _along(place, self.width, self.counts[axis])

    def cell(self, *columns: Ids) -> Ids:
        """The cells of some columns, rows and so on."""
        return _number(columns, self.counts)

    def visit(
        self,
        cell: Ids,
        meet: Visit,
        rays: Any,
        state: T,
        done: Callable[[T], Mask],
    ) -> T:
        """What becomes of rays' states when they meet the spheres of their cells.

        **Arguments:** `cell`: per ray, or per group of rays; -1 for none. `rays`: what `meet` has
        to know of them, a pytree of arrays of shape `(n, ...)`, as are those of `state`. `done`:
        whether a state stays what it is, whatever is met.
        """
        everywhere = lambda k, state: meet(rays, *self.row(k), state)
        state = lax.fori_loop(0, self.start[1], everywhere, state)
        first, count = self.range(cell)
        end = first + count

        def go_on(now: tuple) -> Bool[Array, ""]:
            return jnp.any((now[0] < end) & ~done(now[1]))

        def step(now: tuple) -> tuple:
            slot, state = now
            for k in range(BLOCK):
                state = meet(rays, *self.row_if(slot + k < end, slot + k), state)
            return jnp.minimum(slot + BLOCK, end), state

        # to regroup the rays that are not done takes longer than to go on with all of them (14
        # against 18 ms for 100,000 spheres)
        return lax.while_loop(go_on, step, (first, state))[1]

    def range(self, cell: Ids) -> tuple[Ids, Ids]:
        """Where the spheres of cells start, and how many there are."""
        first = _at(self.start, jnp.maximum(cell, 0))
        return first, jnp.where(cell >= 0, _at(self.start, jnp.maximum(cell, 0) + 1) - first, 0)

    def row(self, slot: Ids) -> tuple[Vec, PixelArray, Ids]:
        """The spheres at some places of the lists: centre, radius, number."""
        slot = jnp.minimum(slot, self.number.size - 1)
        return jax.tree.map(lambda x: _at(x, slot), (self.center, self.radius, self.number))

    def row_if(self, some: Mask, slot: Ids) -> tuple[Vec, PixelArray, Ids]:
        """The same, but nobody where there are none."""
        center, radius, number = self.row(slot)
        return center, jnp.where(some, radius, jnp.nan), jnp.where(some, number, NOBODY)


def build_bins(center: Vec, radius: PixelArray, layouts: BinBounds, most: int) -> Bins:
    """Lists of the spheres in each cell of some grids.

    All grids at once, so that this is compiled once only.

    **Arguments:** `layouts`: several, stacked. `most`: how many cells a grid may have.

    **Returns:** the cells of each grid, stacked.
    """
    return lax.map(lambda layout: _sort_into_cells(center, radius, layout, most), layouts)


def _sort_into_cells(center: Vec, radius: PixelArray, layout: BinBounds, most: int) -> Bins:
    n, dtype = radius.shape[0], radius.dtype
    room = _room(n)

    def counts(width: Scalar) -> Float[Array, " axes"]:
        """How many cells there are along each axis."""
        return jnp.maximum(jnp.ceil(layout.size / width), 1)

    def covered(width: Scalar) -> tuple:
        """The first cell along each axis, how many there are, and the pairs."""
        count = counts(width).astype(jnp.int32)
        low = [_along(x, width, m) for x, m in zip(layout.low, count, strict=True)]
        high = [_along(x, width, m) for x, m in zip(layout.high, count, strict=True)]
        spans = [b - a + 1 for a, b in zip(low, high, strict=True)]
        pairs = math.prod(spans)
        wide = pairs > jnp.maximum(jnp.prod(counts(width)) * WIDE, 1).astype(jnp.int32)
        some = [a <= b for a, b in zip(layout.low, layout.high, strict=True)]
        some = functools.reduce(jnp.logical_and, some)
        return low, spans, wide, jnp.where(some, jnp.where(wide, 1, pairs), 0)

    def too_narrow(width: Scalar) -> Bool[Array, ""]:
        pairs = covered(width)[-1]
        # a sum of whole numbers is exact, but may overflow
        about = jnp.sum(pairs.astype(jnp.float32))
        fits = (about < 2 * room) & (jnp.sum(pairs, dtype=jnp.int32) <= room)
        return (jnp.prod(counts(width)) > most) | ~fits

    # there always is room for all spheres in a single cell
    width = lax.while_loop(too_narrow, lambda width: width * layout.step, jnp.ones((), dtype))
    count = counts(width).astype(jnp.int32)
    low, spans, wide, pairs = covered(width)
    none = jnp.prod(count, dtype=jnp.int32) + 1

    # whose the pairs are: the last one's whose pairs start there or before
    end = prefix_sum(pairs)
    start = end - pairs
    slot = jnp.arange(room, dtype=jnp.int32)
    owner = prefix_sum(jnp.zeros(room, jnp.int32).at[start].add(1, mode="drop")) - 1
    rest, columns = slot - _at(start, owner), []
    for first, span in zip(low, spans, strict=True):
        span = _at(span, owner)
        columns.append(_at(first, owner) + lax.rem(rest, span))
        rest = lax.div(rest, span)
    cell = jnp.where(_at(wide, owner), 0, _number(columns, count))
    cell = jnp.where(slot < end[-1], cell, none)

    number = _at(owner, _order(cell, none))
    filled = jnp.zeros(most + 2, jnp.int32).at[cell].add(1)
    center, radius = jax.tree.map(lambda column: _at(column, number), (center, radius))
    return Bins(center, radius, number, prefix_sum(filled) - filled, width, count)


class Cluster(eqx.Module):
    """Where most of many spheres are, whatever a few of them do."""

    some: Vec  #: the centres of some spheres
    middle: Vec  #: of where most of them are, along each axis
    half: Vec  #: half as wide as that; 1 where they are all in one plane
    slack: Scalar  #: how far rounding may move what is near, in units of length


def cluster(center: Vec, radius: PixelArray) -> Cluster:
    """Where most of some spheres are."""
    every = -(-radius.shape[0] // SAMPLE)
    some, size = jax.tree.map(lambda x: x[::every], (center, radius))
    middle, half = central_range((some.x, some.y, some.z, size))
    reach = jnp.sum(half[:3]) + (middle[3] + half[3])
    slack = FAR * SLACK * jnp.finfo(radius.dtype).eps * reach
    return Cluster(some, Vec(*middle[:3]), Vec(*half[:3]), slack)


def central_range(
    columns: Sequence[Float[Array, " n"]],
) -> tuple[Float[Array, " columns"], Float[Array, " columns"]]:
    """The middle and half the width of where most of the numbers of each column are.

    The width of what has none is 1.
    """
    # all in one, as to sort floating-point numbers takes 0.3 s to compile
    each = jnp.sort(jnp.stack(list(columns)), axis=1)
    last = each.shape[1] - 1
    low, high = each[:, int((1 - MOST) * last)], each[:, int(MOST * last)]
    return (low + high) / 2, jnp.where(high > low, (high - low) / 2, 1)


def most_bins(spheres: int) -> int:
    """For how many cells it takes one sort only, unless these are too few; then two."""
    digit = 32 - (_room(spheres) - 1).bit_length()
    return min(1 << digit if 16 << digit >= spheres else 1 << 2 * digit, 8 * spheres) - 2


def _room(spheres: int) -> int:
    """How many pairs there is room for."""
    return PAIRS * spheres + MORE_PAIRS


def _order(cell: Ids, last: Int[Array, ""]) -> Ids:
    """The order of cells from 0 to `last`: where the first one is, and so on, equals as they come.

    To sort whole numbers that hold both a cell and its place takes 41 ns each, pairs of a cell and
    a place 300. What does not fit into one number is sorted from the last digit on.
    """
    place = jnp.arange(cell.size, dtype=jnp.uint32)
    bits = (cell.size - 1).bit_length()

    def sort(now: tuple[Int[Array, ""], Ids]) -> tuple[Int[Array, ""], Ids]:
        shift, order = now
        digit = (_at(cell, order) >> shift).astype(jnp.uint32)
        keys = jnp.sort(digit << bits | place)
        return shift + (32 - bits), _at(order, (keys & ((1 << bits) - 1)).astype(jnp.int32))

    digits_left = lambda now: last >> now[0] > 0
    return lax.while_loop(digits_left, sort, (jnp.int32(0), place.astype(jnp.int32)))[1]


def _along(place: PixelArray, width: Scalar, count: Ids) -> Ids:
    """Which cell along an axis a coordinate is in."""
    last = (count - 1).astype(place.dtype)
    return jnp.clip(place / width, 0, last).astype(jnp.int32)


def _number(columns, counts: Int[Array, " axes"]) -> Ids:
    """The numbers of cells, from 1."""
    number = jnp.zeros_like(columns[-1])
    for k in reversed(range(len(columns))):
        number = number * counts[k] + columns[k]
    return number + 1


def _at(column: Shaped[Array, " rows"], place: Ids) -> Shaped[Array, "*#pixels"]:
    return column.at[place].get(mode="promise_in_bounds")
