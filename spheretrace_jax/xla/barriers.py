"""Optimization barriers: values that XLA computes once, not again in each of their users."""

from collections.abc import Callable
from typing import TypeVar

import jax
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
    """Computes `phase()` once and stores the result, so that XLA does not fuse it into its users.

    XLA fuses everything into one loop and then recomputes the whole chain for every output: 42 ms
    for a picture instead of 9.4. The captured inputs of a phase are stored in memory, too.
    Recomputing a ray's hit point in each phase is faster than reading it (13 against 17 ms).
    Recomputing a phase in the reverse pass is faster, too (140 against 190 ms for a gradient).

    **Arguments:** `witness`: a number greater than -1 that XLA does not know, as `unknown_one` is.
    """
    if jax.default_backend() != "cpu":
        return lax.optimization_barrier(phase())
    # On the CPU jax 0.10, the newest for Python 3.11, drops the barrier, but keeps a branch on
    # data. In 0.12 the branch is as fast as the barrier, in a fit faster (2.0 against 2.7 s a
    # step). The inlined jit traces `phase` once for its two uses.
    phase = jax.jit(phase, inline=True)
    zeros = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(phase))
    return lax.cond(witness > -1, jax.checkpoint(phase), lambda: zeros)


def compute_pair_once(
    phase: Callable[[], tuple[PixelArray, PixelArray]], witness: Scalar
) -> tuple[PixelArray, PixelArray]:
    """Computes two arrays once, packed as one complex array; see `compute_once`.

    XLA computes each output of a phase in a separate loop. Packed as one output, two arrays cost
    what one costs (7.95 against 16.2 ms).
    """
    packed = compute_once(lambda: lax.complex(*phase()), witness)
    return packed.real, packed.imag


def barrier(values: T) -> T:
    """Returns the same values, computed once and stored: `compute_once` for small loops.

    Small loops are those over edge pixels. Without the barrier their fused loops compute the same
    values thousands of times (947 against 1.6 ms for 2048 pixels).
    """
    if jax.default_backend() != "cpu" or jax.__version_info__ >= (0, 12):
        return lax.optimization_barrier(values)
    # jax 0.10 drops the barrier here, as in `compute_once`, but keeps a function not inlined.
    # (`compute_on2` would keep it too, and commit the results to a device: what is computed from
    # them would be compiled again.)
    from jax.experimental.xla_metadata import set_xla_metadata

    with set_xla_metadata(inlineable="false"):
        return _identity(values)


@jax.jit
def _identity(values: T) -> T:
    return values
