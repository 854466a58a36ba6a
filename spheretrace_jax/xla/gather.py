"""Gathers of table rows, with a reverse pass that sums whole rows per object."""

from typing import TypeVar

import jax
import jax.core
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from ..base.types import Ids, PixelArray
from .barriers import barrier
from .loops import UNROLL

T = TypeVar("T")

# For at most this many pixels rows of short tables are fetched one by one, too: selects are faster
# for many, but there are a dozen of them for each number, and a third of what there is to compile
# of covered edges was these.
MOST_GATHERED = 1 << 13

# Sums over pixels are spread over this many bins per object before they are added up: neighbours
# then do not wait for one another, and float32 keeps its digits.
SUB_BINS = 16


def gather_rows(table: T, ids: Ids) -> T:
    """The rows of a table that pixels ask for.

    **Arguments:** `table`: a pytree of arrays of shape `(objects,)`. `ids`: which row, shape
    `(*pixels,)`; where there is no such row the answer is some other's, of an empty table 0.

    **Returns:** the same pytree with arrays of shape `(*pixels,)`.
    """
    columns, shape = jax.tree.flatten(table)
    if columns[0].size == 0:
        return jax.tree.map(lambda column: jnp.zeros(ids.shape, column.dtype), table)
    return jax.tree.unflatten(shape, _fetch(columns, ids))


@jax.custom_jvp
def _fetch(columns: list[Float[Array, " objects"]], ids: Ids) -> list[PixelArray]:
    if columns[0].shape[0] <= UNROLL and ids.size > MOST_GATHERED:
        return _select(columns, ids)
    row = _within(ids, columns[0].shape[0])
    return [column.at[row].get(mode="promise_in_bounds") for column in columns]


def _fetch_jvp(primals, tangents):
    columns, ids = primals
    fetched = _fetch(columns, ids)
    moves = [not isinstance(t, SymbolicZero) for t in tangents[0]]
    if not any(moves):
        return fetched, [jnp.zeros_like(value) for value in fetched]
    # Whole rows, so that the reverse pass is one segment sum of rows per pixel (3.6 ms), where
    # masked sums per object and column take 5 to 30 times as long.
    rows = jnp.stack([t for t, some in zip(tangents[0], moves, strict=True) if some], axis=1)
    bin_ = jnp.arange(ids.size, dtype=jnp.int32).reshape(ids.shape) % SUB_BINS
    at = _within(ids, len(rows)) + len(rows) * bin_
    d = jnp.tile(rows, (SUB_BINS, 1)).at[at].get(mode="promise_in_bounds")
    # picked by a mask, so that backwards they are put side by side by masks: 3 ms for 8 of a
    # million pixels, where a stack takes 9
    number = jnp.arange(rows.shape[1], dtype=jnp.int32)
    picked = iter([jnp.sum(jnp.where(number == k, d, 0), axis=-1) for k in range(rows.shape[1])])
    each = zip(moves, fetched, strict=True)
    return fetched, [next(picked) if some else jnp.zeros_like(value) for some, value in each]


_fetch.defjvp(_fetch_jvp, symbolic_zeros=True)


def gather_pixel_rows(table: T, ids: Ids) -> T:
    """`fetch` from tables of each pixel's own, of shape `(objects, *pixels)`; not forwards.

    A table of one row gives that row, whatever the number.
    """
    columns, shape = jax.tree.flatten(table)
    return jax.tree.unflatten(shape, _fetch_own(columns, ids))


@jax.custom_vjp
def _fetch_own(columns: list[Float[Array, "rows *#pixels"]], ids: Ids) -> list[PixelArray]:
    if columns[0].shape[0] <= UNROLL:
        return _select(columns, ids)
    row = _within(ids, columns[0].shape[0])[None]
    take = lambda column: jnp.take_along_axis(column, row, axis=0, mode="promise_in_bounds")[0]
    return [take(column) for column in columns]


def _fetch_own_forward(columns: list, ids: Ids) -> tuple[list[PixelArray], tuple]:
    return _fetch_own(columns, ids), (ids, columns[0].shape[0])


def _fetch_own_backward(kept: tuple, slopes: list[PixelArray]) -> tuple[list, None]:
    ids, count = kept
    if count == 1:
        return [slope[None] for slope in slopes], None
    # kept, or what leads to them is computed again for each row
    slopes = barrier(slopes)
    rows = jnp.arange(count, dtype=jnp.int32).reshape(-1, *[1] * ids.ndim)
    mine = _within(ids, count)[None] == rows
    return [jnp.where(mine, slope[None], 0) for slope in slopes], None


_fetch_own.defvjp(_fetch_own_forward, _fetch_own_backward)


def _within(ids: Ids, count: int) -> Ids:
    return jnp.clip(ids, 0, count - 1).astype(jnp.int32)


def _select(columns: list[Array], ids: Ids) -> list[PixelArray]:
    """column[ids] by a binary tree of selects on the bits of the ids: no gather, so vectorised."""
    bits = range((columns[0].shape[0] - 1).bit_length())
    odd = [(ids >> bit) & 1 == 1 for bit in bits]
    selected = []
    for column in columns:
        values = list(column)
        for one in odd:
            pairs = zip(values[::2], values[1::2], strict=False)
            last = values[-1:] if len(values) % 2 else []
            values = [jnp.where(one, b, a) for a, b in pairs] + last
        selected.append(jnp.broadcast_to(values[0], ids.shape))
    return selected


def smallest_int(count: int) -> jnp.dtype:
    """The smallest signed integer type that holds -1 and all numbers up to `count`."""
    return jnp.dtype(jnp.int8 if count < 1 << 7 else jnp.int16 if count < 1 << 15 else jnp.int32)
