"""Barriers: values that XLA computes once, instead of again in each of their users."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.core
import jax.numpy as jnp
from jax import lax

from ..base.types import PixelArray, Scalar

T = TypeVar("T")


def unknown_one() -> Scalar:
    """Returns a 1 that XLA does not know, for `compute_once`: the value of a library call.

    A number of the scene would do as long as the scene is an argument of the compiled function.
    Where the scene is a constant, XLA would know that number and drop the branches made on it.
    """
    one = jnp.ones((1, 1), jnp.float32)
    return one[0, 0] if jax.default_backend() != "cpu" else lax.linalg.cholesky(one)[0, 0]


def compute_once(phase: Callable[[], T], witness: Scalar) -> T:
    """The value of `phase()`, computed once and kept, not fused into each of its users.

    XLA fuses everything into one loop and then recomputes the whole chain for every output: 42 ms
    for a picture instead of 9.4. What a phase takes from outside is kept in memory, too: to find
    a ray's hit point again in each phase is faster than to read it (13 against 17 ms). So is to
    compute a phase again in the reverse pass (140 against 190 ms for a gradient).

    **Arguments:** `witness`: a number greater than -1 that XLA does not know, as `unknown_one` is.
    """
    if jax.default_backend() != "cpu":
        return lax.optimization_barrier(phase())
    # On the CPU jax 0.10, the newest for Python 3.11, drops the barrier. A branch on data is kept
    # there, and in 0.12 it is as fast as the barrier, in a fit faster (2.0 against 2.7 s a step).
    # jitted, it is traced once and not for each of its two uses
    phase = jax.jit(phase, inline=True)
    zeros = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(phase))
    return lax.cond(witness > -1, jax.checkpoint(phase), lambda: zeros)


def compute_pair_once(
    phase: Callable[[], tuple[PixelArray, PixelArray]], witness: Scalar
) -> tuple[PixelArray, PixelArray]:
    """`materialise` for two planes, packed as one complex plane.

    Each output of a phase is computed by a loop of its own: packed, two cost what one costs (7.95
    against 16.2 ms).
    """
    packed = compute_once(lambda: lax.complex(*phase()), witness)
    return packed.real, packed.imag


def barrier(values: T) -> T:
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
