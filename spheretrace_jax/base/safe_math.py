"""Safe mathematics: roots and extrema whose derivatives are never NaN nor lost, exact scaling."""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .types import PixelArray, Scalar


def safe_sqrt(square: PixelArray) -> PixelArray:
    """Returns `sqrt(max(square, 0))`, with derivative 0 where `square <= 0`."""
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1)), 0)


def larger(a: PixelArray, b: PixelArray | float | int) -> PixelArray:
    """Returns max(a, b), with the derivative of the larger argument, of `b` in a tie.

    The derivative of `jnp.maximum` in jax 0.10 compares each argument with the result. XLA
    recomputes values where they are used, and rounds differently where it fuses multiplications
    with additions. Then neither argument equals the result, and the derivative silently vanishes
    in some pixels.
    """
    return jnp.where(a > b, a, b)


def smaller(a: PixelArray, b: PixelArray | float | int) -> PixelArray:
    """Returns min(a, b), with the derivative of the smaller argument, of `a` in a tie.

    See `larger` for the reason.
    """
    return jnp.where(a > b, b, a)


def clamp(
    x: PixelArray, low: PixelArray | float | int, high: PixelArray | float | int
) -> PixelArray:
    """Clamps `x` to [low, high], with derivative 0 outside of the bounds; see `larger`."""
    return smaller(larger(x, low), high)


def to_order_one(*lengths: Float[Array, "..."]) -> Scalar:
    """Returns the power of two that scales the largest of the lengths to order one.

    Scaling by a power of two is exact. Squares of lengths overflow in float32 above 1.8e19 and
    vanish below 1e-19. The factor is a constant: it has no derivative.
    """
    maxima = (jnp.max(jnp.abs(x), initial=0) for x in jax.lax.stop_gradient(lengths))
    largest = functools.reduce(jnp.maximum, maxima)
    exponent = jnp.where(largest > 0, jnp.floor(jnp.log2(jnp.where(largest > 0, largest, 1))), 0)
    return jnp.exp2(-exponent)
