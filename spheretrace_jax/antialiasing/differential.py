"""`Varying`: a quantity at a pixel's centre and how it varies across the pixel.

A beam is a varying ray: what Igehy ("Tracing Ray Differentials", SIGGRAPH 1999) calls a ray with
its differentials. They pass through hits and reflections by the chain rule, which is jax's job.
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
    """`value`, a pytree of planes, and its derivatives by the position in pixels.

    `dx` is the derivative to the right, `dy` the one down.
    """

    value: T
    dx: T
    dy: T

    def map(self, function: Callable[[T], S]) -> "Differential[S]":
        """`function` of the quantity, by the chain rule."""
        value, slope = jax.linearize(function, self.value)
        dx, dy = slope(self.dx), slope(self.dy)
        # the three share most of their work, which would be done again for each of their users
        return barrier(Differential(value, dx, dy))

    def beside(self, other: "Differential[S]") -> "Differential[tuple[T, S]]":
        """Two quantities as one."""
        return Differential((self.value, other.value), (self.dx, other.dx), (self.dy, other.dy))

    def at(self, x: PixelArray, y: PixelArray) -> "Differential[T]":
        """The same seen from elsewhere in the pixel: x pixels to the right and y down."""
        wide = lambda v: jnp.broadcast_to(v, jnp.broadcast_shapes(v.shape, x.shape))
        value, dx, dy = (jax.tree.map(wide, v) for v in (self.value, self.dx, self.dy))
        move = lambda v, dx, dy: v + x * dx + y * dy
        return Differential(barrier(jax.tree.map(move, value, dx, dy)), dx, dy)


def pixel_differentials(
    camera: Camera,
    columns: PixelArray,
    rows: PixelArray,
    size: tuple[int, int],
    side: Scalar | float,
) -> Differential[Ray]:
    """The rays of `pixel_rays` with their differentials.

    **Arguments:** `side`: of the pixel in whole pixels, 1/k for one of k x k samples.
    """
    zero, step = jnp.zeros_like(columns), jnp.full_like(columns, side)
    toward = lambda at: unnormalized_rays(camera, at[0], at[1], size)
    return Differential((columns, rows), (step, zero), (zero, step)).map(toward).map(unit_ray)
