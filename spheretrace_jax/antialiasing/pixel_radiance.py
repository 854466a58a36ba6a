"""What pixels see with all of their area, from the eye and in what they see first.

Edges are covered at the first hit and as they are seen in the first reflection or behind the first
bubble; what is seen after a second one is point-sampled.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jax import lax

from ..base.types import Index, Mask, PixelArray
from ..base.vec import Vec, where, zeros
from ..scene.camera import Ray
from ..scene.scene import Scene
from ..scene.settings import RenderSettings
from ..tracing.path import Path, continues
from ..tracing.tables import Hit, SceneTables, Surface
from ..xla.rematerialization import remat
from .compositing import Layers, composite_layers, secondary_path
from .depth_peeling import most_layers
from .differential import Differential
from .silhouette import mean_surface, silhouette_distance


def pixel_radiance(
    scene: Scene, world: SceneTables, beam: Differential[Ray], settings: RenderSettings, alive: Mask
) -> Vec:
    """The mean colour that pixels see.

    **Arguments:** `beam`: the ray through the pixel's centre and how it varies. `alive`: which
    pixels there are; others are 0.
    """
    if not settings.bounces:
        return composite_layers(scene, world, beam, settings, alive)[0]
    shape, needs, ways = alive.shape, settings.needs, 2 if settings.needs.branching else 1
    later = dataclasses.replace(settings, bounces=max(settings.bounces - 2, 0))
    one, zero = jnp.ones(shape, scene.dtype), jnp.zeros(shape, scene.dtype)
    no_hit = Hit(jnp.full(shape, -1, world.id_type), jnp.full(shape, False))

    def further(layer: Layers, choice: Index) -> tuple[Differential[Ray], Hit, PixelArray]:
        """The beam on from a layer, the hit that it starts from, and what its colour counts."""

        def on(both: tuple[Ray, Surface]) -> Path:
            return secondary_path(world, *both, layer.hit, layer.shown, needs, choice)

        rim = silhouette_distance(world, beam, layer.hit, needs)
        both = beam.beside(mean_surface(world, beam, layer.hit, rim, needs))
        path = on(both.value)
        return both.map(lambda both: on(both).ray), path.hit, path.weight * layer.part

    def eye() -> tuple[Differential[Ray], Hit, PixelArray]:
        return jax.tree.map(lambda x: jnp.broadcast_to(x, shape), beam), no_hit, one

    # one loop over the beam from the eye, number 0, and those on from the layers that it meets:
    # what beams see is compiled once (first calls of 5.2 and 8.8 s with a bounce, without and with
    # shadows, where two copies take 6.0 and 11; gradients take a tenth longer for it)
    def look(state: tuple[Vec, Layers], number: Index) -> tuple[tuple[Vec, Layers], None]:
        color, seen = state
        first, behind = jnp.asarray(number == 0), jnp.maximum(number - 1, 0)
        layer, choice = seen.layer(behind // ways), behind % ways
        path = Path(beam.value, layer.hit, one, layer.shown, None)
        on = jnp.where(first, alive, continues(world, path, needs, choice))

        @remat
        def see(color: Vec, layer: Layers) -> tuple[Vec, Layers]:
            this, leaving, weight = lax.cond(first, eye, lambda: further(layer, choice))
            follow = ~first if settings.bounces > 1 else None
            new, layers = composite_layers(scene, world, this, later, on, leaving, follow)
            return color + new * weight, layers

        color, layers = lax.cond(jnp.any(on), see, lambda color, _: (color, none), color, layer)
        return (color, where(first, layers, seen)), None

    most = most_layers(world)
    row = Layers(no_hit, jnp.full(shape, False), zero)
    none = jax.tree.map(lambda x: jnp.broadcast_to(x, (most, *shape)), row)
    numbers = jnp.arange(1 + most * ways, dtype=jnp.int32)
    return lax.scan(look, (zeros(shape, scene.dtype), none), numbers)[0][0]
