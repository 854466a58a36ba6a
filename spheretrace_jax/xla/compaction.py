"""The marked ones of many: where they are, and work for them alone, chunk by chunk."""

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

# Of more chunks than these it is found out group by group that there is nothing to do: each takes
# some 2 us for every array that the reverse pass remembers (of 512 half a gradient's time).
MOST_SKIPPED = 16

# Rays that take different numbers of steps go on in chunks of a part of them, but of no fewer than
# these.
CHUNKS, LEAST_CHUNK = 4, 1 << 10


def nth_set(
    marked: Bool[Array, " n"],
) -> tuple[Int[Array, ""], Callable[[Int[Array, " k"]], Int[Array, " k"]]]:
    """Where the yeses are in a long list of yes and no.

    **Returns:** how many there are, and a function from k to the place of the k-th, from 0 on.
    Words of 32 are counted, and only where something is looked up their bits: 1 ms for a million,
    where a running count of all and a scatter take 15.
    """
    bits = jnp.arange(32, dtype=jnp.uint32)
    words = jnp.pad(marked, (0, -marked.size % 32)).reshape(-1, 32).astype(jnp.uint32)
    words = jnp.sum(words << bits[None], axis=1, dtype=jnp.uint32)
    counts = lax.population_count(words).astype(jnp.int32)
    ends = prefix_sum(counts)

    def place(k: Int[Array, " k"]) -> Int[Array, " k"]:
        at = jnp.searchsorted(ends, k, side="right").astype(jnp.int32)
        at = jnp.minimum(at, ends.size - 1)
        word, rest = words[at], k - (ends[at] - counts[at])
        bit = jnp.zeros_like(k)
        for width in (16, 8, 4, 2, 1):
            low = lax.population_count(word & jnp.uint32((1 << width) - 1)).astype(jnp.int32)
            beyond = rest >= low
            rest = jnp.where(beyond, rest - low, rest)
            word = jnp.where(beyond, word >> jnp.uint32(width), word)
            bit = jnp.where(beyond, bit + width, bit)
        return at * 32 + bit

    return ends[-1], place


def replace_where(
    values: T,
    marked: Bool[Array, " n"],
    work: Callable[[Int[Array, " size"], Bool[Array, " size"]], T],
    size: int,
) -> T:
    """The values with those of the marked places replaced by `work`, as `add_where` adds them."""
    # added, not set, so that the reverse pass hands on the values' part untouched: to clear it
    # at every time, it copies all of them (for a gradient 260 ms, not 180)
    values = jax.tree.map(lambda v: jnp.where(marked, 0, v), values)
    return add_where(values, marked, work, size)


def add_where(
    values: T,
    marked: Bool[Array, " n"],
    work: Callable[[Int[Array, " size"], Bool[Array, " size"]], T],
    size: int,
    again: bool = False,
) -> T:
    """The values with those of `work` added at the marked places, only for as many as there are.

    **Arguments:** `values`: a pytree of arrays of shape `(n, ...)`. `work`: from places, and which
    of them count, to their values. `size`: how many places at a time.
    """
    n = marked.size
    total, place = nth_set(marked)
    one_chunk = jnp.arange(size, dtype=jnp.int32)

    def new_at(at: Int[Array, "size 1"]) -> T:
        counts = at[:, 0] < n
        return work(jnp.where(counts, at[:, 0], 0), counts)

    def put(values: T, first: Index) -> T:
        number = first + one_chunk
        at = barrier(jnp.where(number < total, place(number), n)[:, None])

        def add(v: Array, x: Array) -> Array:
            axes = lax.ScatterDimensionNumbers(tuple(range(1, x.ndim)), (0,), (0,))
            return lax.scatter_add(v, at, x, axes, unique_indices=True, mode="drop")

        # traced again, all that is kept is one array, with room for all the chunks there might be
        new = remat(new_at)(at) if again else new_at(at)
        return jax.tree.map(add, values, new)

    def put_some(values: T, firsts: Int[Array, "..."]) -> tuple[T, None]:
        skip = lambda values, _: values
        work = put if firsts.ndim == 0 else lambda v, x: lax.scan(put_some, v, x)[0]
        return lax.cond(firsts.reshape(-1)[0] < total, work, skip, values, firsts), None

    # of many chunks it is found out group by group that there are no places left
    chunks = -(-n // size)
    groups = math.isqrt(chunks)
    shape = (groups, -(-chunks // groups)) if chunks > MOST_SKIPPED else (chunks,)
    firsts = jnp.arange(math.prod(shape), dtype=jnp.int32).reshape(shape) * size
    return lax.scan(put_some, values, firsts)[0]


def while_active(
    step: Callable[[C, T], T],
    alive: Callable[[C, T], Bool[Array, " n"]],
    context: C,
    state: T,
) -> T:
    """Repeats a step for n rays until none of them is alive.

    Rays end after very different numbers of steps, and a loop over all of them takes as many as
    the longest one. So they go on in chunks of those that are alive, each until few of its rays
    are.

    **Arguments:** `step`: from what rays are given and their states to their next states; those of
    rays that are done must not change. `context`, `state`: pytrees of arrays of shape `(n, ...)`.
    """
    n = jax.tree.leaves(state)[0].shape[0]
    count = lambda context, state: jnp.sum(alive(context, state), dtype=jnp.int32)

    def steps(context: C, state: T, few: Index) -> T:
        go_on = lambda state: count(context, state) > few
        return lax.while_loop(go_on, partial(step, context), state)

    if n < CHUNKS * LEAST_CHUNK:
        return steps(context, state, 0)
    size = -(-n // CHUNKS)
    number = jnp.arange(size, dtype=jnp.int32)

    def go_on_with_some(state: T) -> T:
        total, place = nth_set(alive(context, state))
        # what fills up a chunk are more of its last ray: they do what it does
        at = jnp.clip(place(jnp.minimum(number, total - 1)), 0, n - 1)
        take = lambda x: x.at[at].get(mode="promise_in_bounds")
        given, some = jax.tree.map(take, (context, state))
        some = steps(given, some, jnp.minimum(total, size) // 4)
        at = jnp.where(number < total, at, n)
        put = lambda x, new: x.at[at].set(new, mode="drop", unique_indices=True)
        return jax.tree.map(put, state, some)

    return lax.while_loop(lambda state: count(context, state) > 0, go_on_with_some, state)


def prefix_sum(x: Int[Array, " n"]) -> Int[Array, " n"]:
    """The sums of the first one, two, ... of some numbers.

    In log2(n) passes of one small loop: as fast as `jnp.cumsum` on the CPU, which compiles a loop
    for each of these passes (0.36 s).
    """
    n = x.size

    def add(k: Index, sums: Int[Array, " n"]) -> Int[Array, " n"]:
        before = jnp.concatenate([jnp.zeros_like(sums), sums])
        return sums + lax.dynamic_slice_in_dim(before, n - (1 << k), n)

    return lax.fori_loop(0, max(n - 1, 0).bit_length(), add, x)
