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
from ..base.vec import packed
from ..scene.camera import Camera, Ray, unit_ray, unnormalized_rays
from ..xla.barriers import barrier

T = TypeVar("T")
S = TypeVar("S")


class Differential(eqx.Module, Generic[T]):
    """A quantity, a pytree of pixel arrays, and its derivatives by the position in pixels."""

    value: T
    slopes: T  #: arrays with one more axis in front: the derivative to the right, and that down

    @property
    def dx(self) -> T:
        """Returns the derivative to the right."""
        return jax.tree.map(lambda s: s[0], self.slopes)

    @property
    def dy(self) -> T:
        """Returns the derivative down."""
        return jax.tree.map(lambda s: s[1], self.slopes)

    def map(self, function: Callable[[T], S]) -> "Differential[S]":
        """Applies `function` to the value, and the chain rule to the derivatives."""
        value, slope = jax.linearize(function, self.value)
        # both derivatives at once: half as much to compile. Value and derivatives share most of
        # their work, which XLA would repeat for each user
        return barrier(Differential(value, jax.vmap(slope)(self.slopes)))

    def paired_with(self, other: "Differential[S]") -> "Differential[tuple[T, S]]":
        """Pairs two quantities into one."""
        return Differential((self.value, other.value), (self.slopes, other.slopes))

    def at(self, x: PixelArray, y: PixelArray) -> "Differential[T]":
        """Moves the expansion point by x pixels to the right and y down (first order)."""
        lift = lambda p, v: p[None] if jnp.ndim(v) > jnp.ndim(p) else p
        move = lambda v, s: v + lift(x, v) * s[0] + lift(y, v) * s[1]
        moved = jax.tree.map(move, self.value, self.slopes)
        whole = lambda s, v: jnp.broadcast_to(s, (2, *v.shape))
        return Differential(barrier(moved), jax.tree.map(whole, self.slopes, moved))


def differential(value: T, dx: T, dy: T) -> Differential[T]:
    """Returns a quantity with its derivatives to the right and down."""
    return Differential(value, jax.tree.map(lambda a, b: jnp.stack([a, b]), dx, dy))


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
    rays = differential((columns, rows), (step, zero), (zero, step)).map(rays_at)
    return rays.map(lambda ray: packed(unit_ray(ray)))
