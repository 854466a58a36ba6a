"""Loops over objects and strips of pixels, in the form that XLA runs fastest."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.core
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from ..base.types import Index

T = TypeVar("T")

# Loops over at most this many objects are written out: XLA then keeps the whole loop in registers.
UNROLL = 16

# In a strip of this many pixels the temporaries stay below 32 MB, above which the allocator maps
# and unmaps memory at every call (20.7 against 11.8 ms); much smaller strips lose to overheads.
STRIP_PIXELS = 1 << 17


def keep_loop_parallel(number: Int[Array, ""]) -> Int[Array, ""]:
    """The same number, at least 0, for a loop that is not to be taken for small.

    XLA makes one function, for one thread, of a loop that it takes for small, as that of jax 0.12
    does of a picture's strips (9.0 ms, not 5.3; of a gradient's 20, not 16), but of none that calls
    another library.
    """
    if jax.default_backend() != "cpu":
        return number
    root = lax.linalg.cholesky(jnp.ones((1, 1), jnp.float32) + number.astype(jnp.float32))
    return number + (root[0, 0] < 0).astype(number.dtype)


def loop(count: int, body: Callable[[Index, T], T], start: T, unroll: int = UNROLL) -> T:
    """`body(count - 1, ... body(1, body(0, start)))`: written out if short, a loop if long."""
    if count <= unroll:
        for i in range(count):
            start = body(i, start)
        return start
    return lax.fori_loop(0, count, body, start)
