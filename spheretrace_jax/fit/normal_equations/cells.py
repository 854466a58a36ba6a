"""Cells: the samples of one object in one pixel, with the weights by which the pixel shows them.

A pixel's row of the Jacobian is the sum of its cells. Everything here is NumPy, on the host.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from ...rendering.pixel_filter import NEIGHBOURS
from ...rendering.shading_samples import Contribution

#: Rows of one object in a chunk. Smaller chunks waste less where objects are small.
CHUNK = 1 << 9

#: Rows with several cells in a group, its cells at most (more if a pixel has as many), and the
#: samples of each such cell: cells of more samples are split.
ROWS, CELLS, SAMPLES = 1 << 9, 1 << 12, 5


class Cells(eqx.Module):
    """Sums of samples of one object, seen through the same mirrors and bubbles."""

    sample: Int[Array | np.ndarray, "*n samples"]  #: points from 0 on, layers from -1 down
    weight: Float[Array | np.ndarray, "*n samples"]
    object: Int[Array | np.ndarray, "*n"]  #: the background comes after the last object
    #: factors of the weight, numbers in `all_turns`; None where all are known
    turns: Int[Array | np.ndarray, "*n bounces"] | None
    row: Int[Array | np.ndarray, "*n"]  #: of its group, in which row it is; `ROWS` for none

    @property
    def samples(self) -> np.ndarray:
        """Returns up to which of its samples each cell has weights, in NumPy."""
        # not how many: a weight may underflow to 0 before others
        number = np.arange(1, self.weight.shape[-1] + 1, dtype=np.int32)
        return np.max(np.where(self.weight != 0, number, 0), axis=-1)


class Entries(NamedTuple):
    """Which samples count in which pixels."""

    pixel: np.ndarray
    sample: np.ndarray
    weight: np.ndarray

    def taken(self, order: np.ndarray) -> "Entries":
        """Returns some of the entries, or all in another order."""
        return Entries(*(x[order] for x in self))

    def between(self, begin: int, end: int) -> "Entries":
        """Returns the entries of some pixels, if entries are sorted by pixel."""
        first, last = np.searchsorted(self.pixel, (begin, end))
        return Entries(*(x[first:last] for x in self))


def make_entries(
    points: Contribution,
    layers: Contribution,
    filter_weights: Float[np.ndarray, "5 pixels"] | None,
    width: int,
) -> Entries:
    """Returns which samples count in which pixels, by pixel, the pixel filter included."""
    number = np.concatenate([np.arange(points.pixel.size), -1 - np.arange(layers.pixel.size)])
    pixel = np.concatenate([points.pixel, layers.pixel])
    entries = Entries(pixel, number, np.concatenate([points.weight, layers.weight]))
    if filter_weights is not None:
        # a sample counts in its own pixel, and where a pixel's filter reaches this one
        column, parts = pixel % width, []
        for weights, right, down in zip(filter_weights, *NEIGHBOURS, strict=True):
            at = pixel - right - down * width
            inside = (column >= right) & (column - right < width)
            inside = inside & (at >= 0) & (at < weights.size)
            weight = entries.weight * np.where(inside, weights[np.where(inside, at, 0)], 0)
            reaches = np.flatnonzero(weight)
            parts.append(Entries(at, number, weight).taken(reaches))
        entries = Entries(*(np.concatenate(x) for x in zip(*parts, strict=True)))
    return entries.taken(np.argsort(entries.pixel, kind="stable"))


class CellList:
    """The cells of some pixels, before they are arranged."""

    def __init__(self, entries: Entries, object_: np.ndarray, turns: np.ndarray):
        """Finds the cells. **Arguments:** `object_`, `turns`: of each entry's sample."""
        ways, way = np.unique(turns.T, axis=0, return_inverse=True)
        objects = int(object_.max(initial=0)) + 1
        key = (entries.pixel.astype(np.int64) * objects + object_) * len(ways) + way.reshape(-1)
        order = np.argsort(key, kind="stable")
        self.entries = entries.taken(order)
        self.starts = np.flatnonzero(np.diff(key[order], prepend=-1))
        self.sizes = np.diff(self.starts, append=key.size)
        first = order[self.starts]
        self.pixel, self.object, self.turns = entries.pixel[first], object_[first], turns.T[first]

    def only_cells(self, no_turn: int) -> np.ndarray:
        """Tests which cells are the only ones of their pixel, and seen directly.

        **Arguments:** `no_turn`: the number of no turn in `all_turns`.
        """
        same = np.diff(self.pixel) == 0
        only = ~(np.append(same, False) | np.insert(same, 0, False)[: same.size + 1])
        return only & (self.turns == no_turn).all(axis=1)

    def most_in_a_pixel(self, samples: int) -> int:
        """Returns the most cells of one pixel, if they are split at so many samples."""
        pieces = np.repeat(self.pixel, -(-self.sizes // samples))
        return int(np.unique(pieces, return_counts=True)[1].max(initial=1))

    def cells(self, chosen: np.ndarray, most: int, known: bool) -> tuple[Cells, np.ndarray]:
        """Returns some cells, those of more than `most` samples split, and their pixels.

        **Arguments:** `known`: whether the weights hold all of their factors.
        """
        pieces = -(-self.sizes[chosen] // most)
        cell = np.repeat(chosen, pieces)
        piece = np.arange(cell.size) - np.repeat(np.cumsum(pieces) - pieces, pieces)
        at = self.starts[cell][:, None] + piece[:, None] * most + np.arange(most)
        inside = at < (self.starts + self.sizes)[cell][:, None]
        at = np.where(inside, at, self.starts[cell][:, None])
        weight = np.where(inside, self.entries.weight[at], 0)
        turns = None if known else self.turns[cell]
        row = np.zeros(cell.size, np.int32)
        made = Cells(self.entries.sample[at], weight, self.object[cell], turns, row)
        return made, self.pixel[cell]


class Arranged(NamedTuple):
    """Cells in groups."""

    cells: Cells
    most: np.ndarray  #: of each group, how many samples its cells have at most
    pixel: np.ndarray  #: of each group's rows: the number of pixels for no row


def arrange_in_chunks(cells: Cells, pixel: np.ndarray, pixels: int) -> Arranged:
    """Arranges cells in chunks of `CHUNK` rows of one object each, those of few samples first."""
    order = np.lexsort((cells.samples, cells.object))
    counts = np.bincount(cells.object)
    chunks = -(-counts // CHUNK)
    starts, slots = np.cumsum(counts) - counts, (np.cumsum(chunks) - chunks) * CHUNK
    object_ = cells.object[order]
    slot = slots[object_] + np.arange(len(order)) - starts[object_]
    place = lambda x, value=0: _placed(x[order], slot, int(chunks.sum()), CHUNK, value)
    placed = jax.tree.map(place, cells)
    arranged = Arranged(placed, placed.samples.max(axis=1), place(pixel, pixels))
    order = np.argsort(arranged.most, kind="stable")
    return jax.tree.map(lambda x: x[order], arranged)


def arrange_in_groups(cells: Cells, pixel: np.ndarray, pixels: int, most: int) -> Arranged:
    """Arranges cells in groups of at most `ROWS` pixels and `most` cells."""
    starts = np.flatnonzero(np.diff(pixel, prepend=-1))
    ends = np.append(starts[1:], len(pixel)).astype(int)
    first_rows = [0] if len(starts) else []
    while first_rows and first_rows[-1] < len(starts):
        first = first_rows[-1]
        fitting = np.searchsorted(ends, starts[first] + most, side="right")
        first_rows.append(min(int(fitting), first + ROWS))
    groups = max(len(first_rows) - 1, 0)
    rows = np.arange(len(starts))
    group = np.searchsorted(first_rows[:-1], rows, side="right") - 1
    first = np.array(first_rows[:-1], int)
    row = rows - first[group]
    of_cell = np.repeat(rows, ends - starts)
    slot = group[of_cell] * most + np.arange(len(pixel)) - starts[first][group[of_cell]]
    cells = eqx.tree_at(lambda c: c.row, cells, row[of_cell].astype(np.int32))
    place = lambda x, value=0: _placed(x, slot, groups, most, value)
    placed = eqx.tree_at(lambda c: c.row, jax.tree.map(place, cells), place(cells.row, ROWS))
    pixel = _placed(pixel[starts], group * ROWS + row, groups, ROWS, pixels)
    return Arranged(placed, placed.samples.max(axis=1), pixel)


def _placed(x: np.ndarray, slot: np.ndarray, groups: int, size: int, value: int) -> np.ndarray:
    """Returns rows at their slots in groups, and a value in all others."""
    groups = max(groups, 1)
    placed = np.full((groups * size, *x.shape[1:]), value, x.dtype)
    placed[slot] = x
    return placed.reshape(groups, size, *x.shape[1:])
