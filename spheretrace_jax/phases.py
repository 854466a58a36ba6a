"""What XLA needs to be told, in one place, so that the other files read like the lecture.

Every trick here has its measured reason beside it (2 cores, AVX-512, 1024 x 1024 float32).
"""

from collections.abc import Callable
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
from jax import lax
from jax.ad_checkpoint import checkpoint_name
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float, Int

from ._types import Ids, Index, Plane, Scalar

P = ParamSpec("P")
T = TypeVar("T")

# Loops over at most this many objects are written out: XLA then keeps the whole loop in registers.
UNROLL = 16

# For at most this many pixels rows of short tables are fetched one by one, too: selects are faster
# for many, but there are a dozen of them for each number, and a third of what there is to compile
# of covered edges was these.
MOST_GATHERED = 1 << 13

# In a strip of this many pixels the temporaries stay below 32 MB, above which the allocator maps
# and unmaps memory at every call (20.7 against 11.8 ms); much smaller strips lose to overheads.
STRIP_PIXELS = 1 << 17

# Sums over pixels are spread over this many bins per object before they are added up: neighbours
# then do not wait for one another, and float32 keeps its digits.
SUB_BINS = 16


@cache
def compiler_options() -> dict[str, int]:
    """What XLA is told of the processor: to use vectors as wide as it has.

    By default it uses half of those of AVX-512: the picture takes 8 ms then and not 5.5, its
    gradient 21 and not 17. Only the outermost compiled function may say so.
    """
    wide = {"xla_cpu_prefer_vector_width": 512}
    try:
        jax.jit(lambda x: x, compiler_options=wide).lower(0).compile()
    except Exception:  # no such option any more, or on this device
        return {}
    return wide


def compiled(function: Callable[P, T]) -> Callable[P, T]:
    """`equinox.filter_jit` with the `compiler_options`, if no function around it is compiled."""
    jit: Any = eqx.filter_jit
    inner = jit(function)

    @cache
    def outermost() -> Callable[P, T]:
        return jit(function, compiler_options=compiler_options())

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        # while a function is compiled, new arrays are tracers, too
        arrays = jax.tree.leaves((args, kwargs, jnp.zeros(())))
        traced = any(isinstance(x, jax.core.Tracer) for x in arrays)
        return (inner if traced else outermost())(*args, **kwargs)

    return call


def large(number: Int[Array, ""]) -> Int[Array, ""]:
    """The same number, at least 0, for a loop that is not to be taken for small.

    XLA makes one function, for one thread, of a loop that it takes for small, as that of jax 0.12
    does of a picture's strips (9.0 ms, not 5.3; of a gradient's 20, not 16), but of none that calls
    another library.
    """
    if jax.default_backend() != "cpu":
        return number
    root = lax.linalg.cholesky(jnp.ones((1, 1), jnp.float32) + number.astype(jnp.float32))
    return number + (root[0, 0] < 0).astype(number.dtype)


def materialise(phase: Callable[[], T], witness: Scalar) -> T:
    """The value of `phase()`, computed once and kept, not fused into each of its users.

    XLA fuses everything into one loop and then recomputes the whole chain for every output: 42 ms
    for a picture instead of 9.4. What a phase takes from outside is kept in memory, too: to find
    a ray's hit point again in each phase is faster than to read it (13 against 17 ms). So is to
    compute a phase again in the reverse pass (140 against 190 ms for a gradient).

    **Arguments:** `witness`: a number of the scene that is greater than -1, known only at run time.
    """
    if jax.default_backend() != "cpu":
        return lax.optimization_barrier(phase())
    # On the CPU jax 0.10, the newest for Python 3.11, drops the barrier. A branch on data is kept
    # there, and in 0.12 it is as fast as the barrier, in a fit faster (2.0 against 2.7 s a step).
    # jitted, it is traced once and not for each of its two uses
    phase = jax.jit(phase, inline=True)
    zeros = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(phase))
    return lax.cond(witness > -1, jax.checkpoint(phase), lambda: zeros)


def materialise_pair(
    phase: Callable[[], tuple[Plane, Plane]], witness: Scalar
) -> tuple[Plane, Plane]:
    """`materialise` for two planes, packed as one complex plane.

    Each output of a phase is computed by a loop of its own: packed, two cost what one costs (7.95
    against 16.2 ms).
    """
    packed = materialise(lambda: lax.complex(*phase()), witness)
    return packed.real, packed.imag


def remember(values: T) -> T:
    """The same values, which `retrace` remembers: small ones that took long to find."""
    return jax.tree.map(lambda value: checkpoint_name(value, _REMEMBERED), values)


def retrace(function: Callable[..., T]) -> Callable[..., T]:
    """The same function, computed again in the reverse pass but for what it remembers."""
    policy = jax.checkpoint_policies.save_only_these_names(_REMEMBERED)
    return jax.checkpoint(function, policy=policy)


_REMEMBERED = "remembered"


def keep(values: T) -> T:
    """The same values, computed once and kept, not computed again for each of their uses.

    `materialise` for small loops, of edge pixels: without it their fused loops compute the same
    things thousands of times over (947 against 1.6 ms for 2048 pixels).
    """
    if jax.default_backend() != "cpu" or jax.__version_info__ >= (0, 12):
        return lax.optimization_barrier(values)
    # dropped there, as `materialise` says; a function that is not inlined is not
    from jax.experimental.compute_on import compute_on2

    here = jax.memory.Space.Device
    same: Any = compute_on2(lambda v: v, compute_type="device", out_memory_spaces=here)
    return same(values)


def over(count: int, body: Callable[[Index, T], T], start: T, unroll: int = UNROLL) -> T:
    """`body(count - 1, ... body(1, body(0, start)))`: written out if short, a loop if long."""
    if count <= unroll:
        for i in range(count):
            start = body(i, start)
        return start
    return lax.fori_loop(0, count, body, start)


def fetch(table: T, ids: Ids) -> T:
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
def _fetch(columns: list[Float[Array, " objects"]], ids: Ids) -> list[Plane]:
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


def fetch_own(table: T, ids: Ids) -> T:
    """`fetch` from tables of each pixel's own, of shape `(objects, *pixels)`; not forwards.

    A table of one row gives that row, whatever the number.
    """
    columns, shape = jax.tree.flatten(table)
    return jax.tree.unflatten(shape, _fetch_own(columns, ids))


@jax.custom_vjp
def _fetch_own(columns: list[Float[Array, "rows *#pixels"]], ids: Ids) -> list[Plane]:
    if columns[0].shape[0] <= UNROLL:
        return _select(columns, ids)
    row = _within(ids, columns[0].shape[0])[None]
    take = lambda column: jnp.take_along_axis(column, row, axis=0, mode="promise_in_bounds")[0]
    return [take(column) for column in columns]


def _fetch_own_forward(columns: list, ids: Ids) -> tuple[list[Plane], tuple]:
    return _fetch_own(columns, ids), (ids, columns[0].shape[0])


def _fetch_own_backward(kept: tuple, slopes: list[Plane]) -> tuple[list, None]:
    ids, count = kept
    if count == 1:
        return [slope[None] for slope in slopes], None
    # kept, or what leads to them is computed again for each row
    slopes = keep(slopes)
    rows = jnp.arange(count, dtype=jnp.int32).reshape(-1, *[1] * ids.ndim)
    mine = _within(ids, count)[None] == rows
    return [jnp.where(mine, slope[None], 0) for slope in slopes], None


_fetch_own.defvjp(_fetch_own_forward, _fetch_own_backward)


def _within(ids: Ids, count: int) -> Ids:
    return jnp.clip(ids, 0, count - 1).astype(jnp.int32)


def _select(columns: list[Array], ids: Ids) -> list[Plane]:
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
