"""Ray differentials: quantities at a pixel's centre with their derivatives across the pixel.

A `Differential[Ray]` is what Igehy ("Tracing Ray Differentials", SIGGRAPH 1999) calls a ray with
its differentials. The chain rule, left to jax, carries them through hits and reflections.
"""

from collections.abc import Callable
from typing import Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Scalar

from ..base.types import PixelArray
from ..scene.camera import Camera, Ray, unit_ray, unnormalized_rays
from ..xla.barriers import barrier

T = TypeVar("T")
S = TypeVar("S")


class Differential(eqx.Module, Generic[T]):
    """A quantity, a pytree of pixel arrays, and its derivatives by the position in pixels.

    `dx` is the derivative to the right, `dy` the derivative down.
    """

    value: T
    dx: T
    dy: T

    def map(self, function: Callable[[T], S]) -> "Differential[S]":
        """Applies `function` to the value, and the chain rule to the derivatives."""
        value, slope = jax.linearize(function, self.value)
        dx, dy = slope(self.dx), slope(self.dy)
        # value and derivatives share most of their work, which XLA would repeat for each user
        return barrier(Differential(value, dx, dy))

    def paired_with(self, other: "Differential[S]") -> "Differential[tuple[T, S]]":
        """Pairs two quantities into one."""
        return Differential((self.value, other.value), (self.dx, other.dx), (self.dy, other.dy))

    def at(self, x: PixelArray, y: PixelArray) -> "Differential[T]":
        """Moves the expansion point by x pixels to the right and y down (first order)."""
        broadcast = lambda v: jnp.broadcast_to(v, jnp.broadcast_shapes(v.shape, x.shape))
        value, dx, dy = (jax.tree.map(broadcast, v) for v in (self.value, self.dx, self.dy))
        move = lambda v, dx, dy: v + x * dx + y * dy
        return Differential(barrier(jax.tree.map(move, value, dx, dy)), dx, dy)


def pixel_differentials(
    camera: Camera,
    columns: PixelArray,
    rows: PixelArray,
    size: tuple[int, int],
    side: Scalar | float,
) -> Differential[Ray]:
    """Computes the rays of `pixel_rays` with their differentials.

    **Arguments:** as for `pixel_rays`, and `side`: the side of a sample's box in pixels, 1/k for
    one of k x k samples.
    """
    zero, step = jnp.zeros_like(columns), jnp.full_like(columns, side)
    rays_at = lambda position: unnormalized_rays(camera, position[0], position[1], size)
    return Differential((columns, rows), (step, zero), (zero, step)).map(rays_at).map(unit_ray)
