"""Gathers of table rows by object index, with a reverse pass that sums whole rows per object."""

from typing import TypeVar

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from ..base.types import Ids, PixelArray
from .barriers import barrier
from .loops import UNROLL

T = TypeVar("T")

# Number of pixels up to which rows of short tables are gathered, not selected by a binary tree.
# The tree is faster for more pixels, but takes a dozen selects for each column: a third of the
# program to compile for covered edges was selects.
MAX_GATHERED_PIXELS = 1 << 13

# Partial sums per object in the reverse pass. More of them keep neighbouring pixels from waiting
# for one another, and keep digits in float32; they are added up in the end.
SUB_BINS = 16


def gather_rows(table: T, ids: Ids) -> T:
    """Gathers a row of the table for each pixel.

    **Arguments:** `table`: a pytree of arrays of shape `(objects,)`. `ids`: row indices, shape
    `(*pixels,)`. An index out of range gives the row of another object, or 0 for an empty table.

    **Returns:** the same pytree with arrays of shape `(*pixels,)`.
    """
    columns, structure = jax.tree.flatten(table)
    if columns[0].size == 0:
        return jax.tree.map(lambda column: jnp.zeros(ids.shape, column.dtype), table)
    return jax.tree.unflatten(structure, _gather(columns, ids))


@jax.custom_jvp
def _gather(columns: list[Float[Array, " objects"]], ids: Ids) -> list[PixelArray]:
    if columns[0].shape[0] <= UNROLL and ids.size > MAX_GATHERED_PIXELS:
        return _select(columns, ids)
    row = _clip(ids, columns[0].shape[0])
    return [column.at[row].get(mode="promise_in_bounds") for column in columns]


def _gather_jvp(primals, tangents):
    columns, ids = primals
    gathered = _gather(columns, ids)
    varies = [not isinstance(t, SymbolicZero) for t in tangents[0]]
    if not any(varies):
        return gathered, [jnp.zeros_like(value) for value in gathered]
    # Whole rows make the reverse pass one segment sum of rows per pixel (3.6 ms); masked sums per
    # object and column take 5 to 30 times as long.
    rows = jnp.stack([t for t, moves in zip(tangents[0], varies, strict=True) if moves], axis=1)
    sub_bin = jnp.arange(ids.size, dtype=jnp.int32).reshape(ids.shape) % SUB_BINS
    index = _clip(ids, len(rows)) + len(rows) * sub_bin
    d = jnp.tile(rows, (SUB_BINS, 1)).at[index].get(mode="promise_in_bounds")
    # masks pick the columns, so that the reverse pass joins cotangents by masks: 3 ms for 8
    # columns of a million pixels, where a stack takes 9
    number = jnp.arange(rows.shape[1], dtype=jnp.int32)
    picked = iter([jnp.sum(jnp.where(number == k, d, 0), axis=-1) for k in range(rows.shape[1])])
    pairs = zip(varies, gathered, strict=True)
    return gathered, [next(picked) if moves else jnp.zeros_like(value) for moves, value in pairs]


_gather.defjvp(_gather_jvp, symbolic_zeros=True)


def gather_pixel_rows(table: T, ids: Ids) -> T:
    """Gathers rows from one table per pixel, of shape `(objects, *pixels)`; see `gather_rows`.

    Reverse mode only. A table of one row gives this row for every index.
    """
    columns, structure = jax.tree.flatten(table)
    return jax.tree.unflatten(structure, _gather_per_pixel(columns, ids))


@jax.custom_vjp
def _gather_per_pixel(columns: list[Float[Array, "rows *#pixels"]], ids: Ids) -> list[PixelArray]:
    if columns[0].shape[0] <= UNROLL:
        return _select(columns, ids)
    row = _clip(ids, columns[0].shape[0])[None]
    take = lambda column: jnp.take_along_axis(column, row, axis=0, mode="promise_in_bounds")[0]
    return [take(column) for column in columns]


def _gather_per_pixel_forward(columns: list, ids: Ids) -> tuple[list[PixelArray], tuple]:
    return _gather_per_pixel(columns, ids), (ids, columns[0].shape[0])


def _gather_per_pixel_backward(residuals: tuple, cotangents: list[PixelArray]) -> tuple[list, None]:
    ids, count = residuals
    if count == 1:
        return [cotangent[None] for cotangent in cotangents], None
    # without the barrier XLA recomputes the cotangents for each row
    cotangents = barrier(cotangents)
    rows = jnp.arange(count, dtype=jnp.int32).reshape(-1, *[1] * ids.ndim)
    is_row = _clip(ids, count)[None] == rows
    return [jnp.where(is_row, cotangent[None], 0) for cotangent in cotangents], None


_gather_per_pixel.defvjp(_gather_per_pixel_forward, _gather_per_pixel_backward)


def take_pixels(tree: T, places: Ids, count: int) -> T:
    """Returns what a pytree of pixel arrays holds for some of the pixels.

    **Arguments:** `places`: of these pixels. `count`: the number of all pixels. Arrays whose last
    axis has another length are shared by all pixels.
    """
    own = lambda x: jnp.ndim(x) > 0 and x.shape[-1] == count
    take = lambda x: x.at[..., places].get(mode="promise_in_bounds")
    return jax.tree.map(lambda x: take(x) if own(x) else x, tree)


def _clip(ids: Ids, count: int) -> Ids:
    return jnp.clip(ids, 0, count - 1).astype(jnp.int32)


def _select(columns: list[Array], ids: Ids) -> list[PixelArray]:
    """Computes column[ids] by a binary tree of selects on the bits of the ids.

    Without a gather XLA vectorises the loop.
    """
    bits = range((columns[0].shape[0] - 1).bit_length())
    bit_set = [(ids >> bit) & 1 == 1 for bit in bits]
    selected = []
    for column in columns:
        values = list(column)
        for is_set in bit_set:
            pairs = zip(values[::2], values[1::2], strict=False)
            last = values[-1:] if len(values) % 2 else []
            values = [jnp.where(is_set, b, a) for a, b in pairs] + last
        selected.append(jnp.broadcast_to(values[0], ids.shape))
    return selected


def smallest_int(count: int) -> jnp.dtype:
    """Returns the smallest signed integer type that holds -1 and all numbers up to `count`."""
    return jnp.dtype(jnp.int8 if count < 1 << 7 else jnp.int16 if count < 1 << 15 else jnp.int32)
