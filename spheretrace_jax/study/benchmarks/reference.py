"""Reference pictures and derivatives, by a method that no diagram shows: lattices of single rays.

The rays are those of the plain path tracer, which shares no code with the renderer that is studied.
A grid of k x k rays meets an edge that runs along it k at a time; the points of a Fibonacci lattice
never line up, so that its mean comes nearer to a pixel's with as many rays (Niederreiter, Random
Number Generation and Quasi-Monte Carlo Methods, 1992, chapter 5).
"""

from collections.abc import Callable

import equinox as eqx
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
from ...tracing.plain import plain_radiance, plain_rays

# The plain path tracer writes its loops over objects out, which compiles in proportion to their
# number. Of scenes with more objects the renderer's own single rays are the reference.
_MOST_OBJECTS = 64

_COEFFICIENTS = lambda scene: (scene.spheres.kgr, scene.spheres.kt, scene.planes.kgr)

Trace = Callable[[Scene, Float[Array, " 2"]], Float[Array, "pixels 3"]]
"""From a scene, and a position in every pixel, to the colours that rays see."""


def fibonacci(least: int) -> tuple[int, int]:
    """Returns the first Fibonacci number from `least` on, and the one before it."""
    before, number = 1, 2
    while number < least:
        before, number = number, before + number
    return number, before


def lattice(count: int, step: int) -> Float[Array, "count 2"]:
    """Returns the points of a rank-1 lattice in the unit square, none of them on its sides."""
    i = np.arange(count)
    return jnp.asarray(np.stack([(i + 0.5) / count, (i * step % count + 0.5) / count], axis=1))


def reference_picture(
    scene: Scene, settings: RenderSettings, rays: int
) -> Callable[[Scene], Picture]:
    """Builds the reference: the mean of at least so many single rays in each pixel.

    **Arguments:** `scene`: of concrete numbers, of which kgr and kt say which rays to follow; its
    antialias flag does not count. `settings`: of the picture; its samples do not count.

    **Returns:** a compiled function of scenes that differ from `scene` in other numbers only.
    """
    positions = lattice(*fibonacci(rays))
    coefficients = _COEFFICIENTS(scene)
    trace = _plain_trace(settings) if scene.objects <= _MOST_OBJECTS else _fast_trace(settings)

    @jax.jit
    def picture(scene: Scene) -> Picture:
        scene = eqx.tree_at(_COEFFICIENTS, scene.with_antialias(0), coefficients)
        add = lambda total, position: (total + trace(scene, position.astype(scene.dtype)), None)
        black = jnp.zeros((settings.width * settings.height, 3), scene.dtype)
        total, _ = lax.scan(add, black, positions)
        return (total / len(positions)).reshape(settings.height, settings.width, 3)

    return picture


def _plain_trace(settings: RenderSettings) -> Trace:
    """Returns a function that traces rays with the plain path tracer."""
    size = settings.width, settings.height
    rows, columns = (jnp.asarray(x.ravel()) for x in np.indices(size[::-1]))

    def trace(scene: Scene, position: Float[Array, " 2"]) -> Float[Array, "pixels 3"]:
        right = columns.astype(scene.dtype) + position[0]
        down = rows.astype(scene.dtype) + position[1]
        rays = plain_rays(scene.camera, right, down, size)
        return plain_radiance(scene, *rays, settings.highlight, settings.bounces)

    return trace


def _fast_trace(settings: RenderSettings) -> Trace:
    """Returns a function that traces single rays with the renderer itself."""
    pixels = jnp.arange(settings.width * settings.height, dtype=jnp.int32)

    def trace(scene: Scene, position: Float[Array, " 2"]) -> Float[Array, "pixels 3"]:
        context = build_context(scene, settings, accelerated=False)
        seen = point_radiance(context, pixels, *position)
        return jnp.stack([seen.x, seen.y, seen.z], axis=-1)

    return trace
