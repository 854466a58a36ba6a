"""Stream compaction: finds the set elements of a mask and works only on these, in chunks."""

import math
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from ..base.types import Index
from .barriers import barrier
from .rematerialization import remat

T = TypeVar("T")
C = TypeVar("C")

# Number of chunks from which empty ones are skipped in groups instead of one by one. Each chunk
# tested alone takes some 2 us for every array that the reverse pass stores (with 512 chunks half
# of a gradient's time).
MAX_SINGLE_CHUNKS = 16

# Active rays are compacted into chunks of this fraction of all rays (1 / ACTIVE_CHUNKS). Smaller
# chunks leave fewer finished rays in a loop but start more loops.
ACTIVE_CHUNKS = 4

# Smallest such chunk, in rays: fewer rays than ACTIVE_CHUNKS of these run uncompacted.
MIN_ACTIVE_CHUNK = 1 << 10


def nth_set(
    mask: Bool[Array, " n"],
) -> tuple[Int[Array, ""], Callable[[Int[Array, " k"]], Int[Array, " k"]]]:
    """Counts the set elements of a mask and finds the k-th of them (rank and select by popcount).

    **Returns:** the count, and a function from k (from 0 on) to the index of the k-th set element.
    Population counts are summed over 32-bit words; single bits are searched only in the words
    looked up. For a million elements: 1 ms, against 15 for a prefix sum of all and a scatter.
    """
    bits = jnp.arange(32, dtype=jnp.uint32)
    words = jnp.pad(mask, (0, -mask.size % 32)).reshape(-1, 32).astype(jnp.uint32)
    words = jnp.sum(words << bits[None], axis=1, dtype=jnp.uint32)
    counts = lax.population_count(words).astype(jnp.int32)
    ends = prefix_sum(counts)

    def select(k: Int[Array, " k"]) -> Int[Array, " k"]:
        index = jnp.searchsorted(ends, k, side="right").astype(jnp.int32)
        index = jnp.minimum(index, ends.size - 1)
        word, rank = words[index], k - (ends[index] - counts[index])
        bit = jnp.zeros_like(k)
        for width in (16, 8, 4, 2, 1):
            low = lax.population_count(word & jnp.uint32((1 << width) - 1)).astype(jnp.int32)
            in_high_half = rank >= low
            rank = jnp.where(in_high_half, rank - low, rank)
            word = jnp.where(in_high_half, word >> jnp.uint32(width), word)
            bit = jnp.where(in_high_half, bit + width, bit)
        return index * 32 + bit

    return ends[-1], select


def replace_where(
    values: T,
    mask: Bool[Array, " n"],
    work: Callable[[Int[Array, " size"], Bool[Array, " size"]], T],
    size: int,
) -> T:
    """Replaces the values where `mask` is set by those of `work`; arguments as for `add_where`."""
    # adding to zeros instead of setting leaves the cotangents of `values` untouched in the reverse
    # pass: clearing them in each chunk copies all of them (260 against 180 ms for a gradient)
    values = jax.tree.map(lambda v: jnp.where(mask, 0, v), values)
    return add_where(values, mask, work, size)


def add_where(
    values: T,
    mask: Bool[Array, " n"],
    work: Callable[[Int[Array, " size"], Bool[Array, " size"]], T],
    size: int,
    rematerialize: bool = False,
) -> T:
    """Adds the values of `work` where `mask` is set, in fixed-size chunks (stream compaction).

    The run time grows with the number of set elements, not with n.

    **Arguments:** `values`: a pytree of arrays of shape `(n, ...)`. `work`: from the indices of a
    chunk and the mask of its valid indices to their values. `size`: indices per chunk.
    `rematerialize`: whether the reverse pass recomputes `work` instead of storing its values.
    """
    n = mask.size
    total, select = nth_set(mask)
    one_chunk = jnp.arange(size, dtype=jnp.int32)

    def work_at(indices: Int[Array, "size 1"]) -> T:
        valid = indices[:, 0] < n
        return work(jnp.where(valid, indices[:, 0], 0), valid)

    def add_chunk(values: T, first: Index) -> T:
        ranks = first + one_chunk
        indices = barrier(jnp.where(ranks < total, select(ranks), n)[:, None])

        def scatter(v: Array, x: Array) -> Array:
            axes = lax.ScatterDimensionNumbers(tuple(range(1, x.ndim)), (0,), (0,))
            return lax.scatter_add(v, indices, x, axes, unique_indices=True, mode="drop")

        # rematerialised, all that the reverse pass stores is one array with room for every chunk
        new = remat(work_at)(indices) if rematerialize else work_at(indices)
        return jax.tree.map(scatter, values, new)

    def add_chunks(values: T, firsts: Int[Array, "..."]) -> tuple[T, None]:
        skip = lambda values, _: values
        add = add_chunk if firsts.ndim == 0 else lambda v, x: lax.scan(add_chunks, v, x)[0]
        return lax.cond(firsts.reshape(-1)[0] < total, add, skip, values, firsts), None

    chunks = -(-n // size)
    groups = math.isqrt(chunks)
    shape = (groups, -(-chunks // groups)) if chunks > MAX_SINGLE_CHUNKS else (chunks,)
    firsts = jnp.arange(math.prod(shape), dtype=jnp.int32).reshape(shape) * size
    return lax.scan(add_chunks, values, firsts)[0]


def while_active(
    step: Callable[[C, T], T],
    is_active: Callable[[C, T], Bool[Array, " n"]],
    context: C,
    state: T,
) -> T:
    """Repeats `step` for n rays until no ray is active, with stream compaction between loops.

    Rays take very different numbers of steps, and a loop over all of them takes as many as the
    longest ray. Active rays are therefore compacted into chunks; a chunk's loop ends when few of
    its rays are still active.

    **Arguments:** `step`: from the rays' context and states to their next states; it must not
    change the states of inactive rays. `context`, `state`: pytrees of arrays of shape `(n, ...)`.
    """
    n = jax.tree.leaves(state)[0].shape[0]
    count = lambda context, state: jnp.sum(is_active(context, state), dtype=jnp.int32)

    def run(context: C, state: T, most_active: Index) -> T:
        """Steps until at most `most_active` rays are active."""
        proceed = lambda state: count(context, state) > most_active
        return lax.while_loop(proceed, partial(step, context), state)

    if n < ACTIVE_CHUNKS * MIN_ACTIVE_CHUNK:
        return run(context, state, 0)
    size = -(-n // ACTIVE_CHUNKS)
    ranks = jnp.arange(size, dtype=jnp.int32)

    def run_chunk(state: T) -> T:
        total, select = nth_set(is_active(context, state))
        # the last active ray fills up the chunk: the copies do the same steps
        indices = jnp.clip(select(jnp.minimum(ranks, total - 1)), 0, n - 1)
        take = lambda x: x.at[indices].get(mode="promise_in_bounds")
        chunk_context, chunk_state = jax.tree.map(take, (context, state))
        chunk_state = run(chunk_context, chunk_state, jnp.minimum(total, size) // 4)
        indices = jnp.where(ranks < total, indices, n)
        put = lambda x, new: x.at[indices].set(new, mode="drop", unique_indices=True)
        return jax.tree.map(put, state, chunk_state)

    return lax.while_loop(lambda state: count(context, state) > 0, run_chunk, state)


def prefix_sum(x: Int[Array, " n"]) -> Int[Array, " n"]:
    """Returns the inclusive prefix sums of an integer array.

    log2(n) passes of one small loop: as fast as `jnp.cumsum` on the CPU, which compiles a separate
    loop for each pass (0.36 s).
    """
    n = x.size

    def add(k: Index, sums: Int[Array, " n"]) -> Int[Array, " n"]:
        before = jnp.concatenate([jnp.zeros_like(sums), sums])
        return sums + lax.dynamic_slice_in_dim(before, n - (1 << k), n)

    return lax.fori_loop(0, max(n - 1, 0).bit_length(), add, x)
