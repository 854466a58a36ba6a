"""Safe mathematics: square roots and extrema whose derivatives are never NaN nor lost."""

import jax.numpy as jnp

from .types import PixelArray


def safe_sqrt(square: PixelArray) -> PixelArray:
    """`sqrt(max(square, 0))`, with derivative 0 where `square <= 0`."""
    some = square > 0
    return jnp.where(some, jnp.sqrt(jnp.where(some, square, 1)), 0)


def larger(a: PixelArray, b: PixelArray | float | int) -> PixelArray:
    """max(a, b), with the derivative of the larger one, of `b` where they are equal.

    `maximum` of jax 0.10 gives its derivative to what equals the maximum. XLA computes numbers
    again where they are used, and rounds them otherwise where it joins multiplications with
    additions: then neither is equal, and the derivative vanishes, in some pixels, without a word.
    """
    return jnp.where(a > b, a, b)


def smaller(a: PixelArray, b: PixelArray | float | int) -> PixelArray:
    """min(a, b), with the derivative of the smaller one, of `a` where equal; see `larger`."""
    return jnp.where(a > b, b, a)


def clamp(
    x: PixelArray, low: PixelArray | float | int, high: PixelArray | float | int
) -> PixelArray:
    """`x` within bounds, with derivative 0 beyond them; see `larger`."""
    return smaller(larger(x, low), high)
