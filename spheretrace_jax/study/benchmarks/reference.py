"""Reference pictures and derivatives, by a method that no diagram shows: lattices of single rays.

A grid of k x k rays meets an edge that runs along it k at a time; the points of a Fibonacci lattice
never line up, so that its mean comes nearer to a pixel's with as many rays (Niederreiter, Random
Number Generation and Quasi-Monte Carlo Methods, 1992, chapter 5).
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ...base.types import Picture
from ...rendering.samples import point_radiance
from ...scene.scene import Scene
from ...scene.settings import RenderSettings
from ...tracing.context import build_context


def fibonacci(least: int) -> tuple[int, int]:
    """The first Fibonacci number from `least` on, and the one before it."""
    before, number = 1, 2
    while number < least:
        before, number = number, before + number
    return number, before


def lattice(count: int, step: int) -> Float[Array, "count 2"]:
    """The points of a rank-1 lattice in the unit square, none of them on its sides."""
    i = np.arange(count)
    return jnp.asarray(np.stack([(i + 0.5) / count, (i * step % count + 0.5) / count], axis=1))


def reference_picture(settings: RenderSettings, rays: int) -> Callable[[Scene], Picture]:
    """Each pixel's mean of at least so many single rays.

    **Arguments:** `settings`: of the picture; its samples do not count.

    **Returns:** a compiled function of the scene, whose antialias flag does not count.
    """
    places = lattice(*fibonacci(rays))
    pixels = jnp.arange(settings.width * settings.height, dtype=jnp.int32)

    @jax.jit
    def picture(scene: Scene) -> Picture:
        scene = scene.with_antialias(0)
        context = build_context(scene, settings, accelerated=False)

        def add(total: Array, place: Array) -> tuple[Array, None]:
            left, top = place.astype(scene.dtype)
            seen = point_radiance(context, pixels, left, top)
            return total + jnp.stack([seen.x, seen.y, seen.z]), None

        total, _ = lax.scan(add, jnp.zeros((3, pixels.size), scene.dtype), places)
        return (total / len(places)).T.reshape(settings.height, settings.width, 3)

    return picture
