"""Loops over objects and strips of pixels, in the form that XLA runs fastest."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from ..base.types import Index

T = TypeVar("T")

# Number of iterations up to which loops over objects are unrolled: XLA then keeps the loop state
# in registers. More iterations make the program longer to compile.
UNROLL = 16

# Pixels per strip of a picture. In strips of this size the temporaries stay below 32 MB. Above
# that the allocator maps and unmaps memory at every call (20.7 against 11.8 ms); much smaller
# strips lose to overheads.
STRIP_PIXELS = 1 << 17


def keep_loop_parallel(number: Int[Array, ""]) -> Int[Array, ""]:
    """Returns the same number, at least 0, and keeps XLA from running its loop on one thread.

    XLA compiles a loop that it takes for small into one single-threaded function. In jax 0.12 the
    loop over a picture's strips is one (9.0 ms, not 5.3; for a gradient 20, not 16). XLA never
    does so with a loop that calls another library: hence the Cholesky factor.
    """
    if jax.default_backend() != "cpu":
        return number
    root = lax.linalg.cholesky(jnp.ones((1, 1), jnp.float32) + number.astype(jnp.float32))
    return number + (root[0, 0] < 0).astype(number.dtype)


def loop(count: int, body: Callable[[Index, T], T], start: T, unroll: int = UNROLL) -> T:
    """Computes `body(count - 1, ... body(1, body(0, start)))`.

    Loops of at most `unroll` iterations are unrolled, longer ones become a `fori_loop`.
    """
    if count <= unroll:
        for i in range(count):
            start = body(i, start)
        return start
    return lax.fori_loop(0, count, body, start)
