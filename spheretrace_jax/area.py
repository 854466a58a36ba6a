"""What pixels see with all of their area, from the eye and in what they see first.

Edges are covered at the first hit and as they are seen in the first reflection or behind the first
bubble; what is seen after a second one is point-sampled.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jax import lax

from ._types import Index, Mask, Plane
from .camera import Ray
from .layers import Seen, layered, onward
from .options import Options
from .outlines import mean_surface, rim_of
from .paths import Path, goes_on
from .peel import most_layers
from .phases import retrace
from .scene import Scene
from .varying import Varying
from .vec import Vec, where, zeros
from .world import Hit, Surface, World


def area_color(
    scene: Scene, world: World, beam: Varying[Ray], options: Options, alive: Mask
) -> Vec:
    """The mean colour that pixels see.

    **Arguments:** `beam`: the ray through the pixel's centre and how it varies. `alive`: which
    pixels there are; others are 0.
    """
    if not options.bounces:
        return layered(scene, world, beam, options, alive)[0]
    shape, needs, ways = alive.shape, options.needs, 2 if options.needs.branching else 1
    later = dataclasses.replace(options, bounces=max(options.bounces - 2, 0))
    one, zero = jnp.ones(shape, scene.dtype), jnp.zeros(shape, scene.dtype)
    no_hit = Hit(jnp.full(shape, -1, world.id_type), jnp.full(shape, False))

    def further(layer: Seen, choice: Index) -> tuple[Varying[Ray], Hit, Plane]:
        """The beam on from a layer, the hit that it starts from, and what its colour counts."""

        def on(both: tuple[Ray, Surface]) -> Path:
            return onward(world, *both, layer.hit, layer.shown, needs, choice)

        rim = rim_of(world, beam, layer.hit, needs)
        both = beam.beside(mean_surface(world, beam, layer.hit, rim, needs))
        path = on(both.value)
        return both.map(lambda both: on(both).ray), path.hit, path.weight * layer.part

    def eye() -> tuple[Varying[Ray], Hit, Plane]:
        return jax.tree.map(lambda x: jnp.broadcast_to(x, shape), beam), no_hit, one

    # one loop over the beam from the eye, number 0, and those on from the layers that it meets:
    # what beams see is compiled once (first calls of 5.2 and 8.8 s with a bounce, without and with
    # shadows, where two copies take 6.0 and 11; gradients take a tenth longer for it)
    def look(state: tuple[Vec, Seen], number: Index) -> tuple[tuple[Vec, Seen], None]:
        color, seen = state
        first, behind = jnp.asarray(number == 0), jnp.maximum(number - 1, 0)
        layer, choice = seen.layer(behind // ways), behind % ways
        path = Path(beam.value, layer.hit, one, layer.shown, None)
        on = jnp.where(first, alive, goes_on(world, path, needs, choice))

        @retrace
        def see(color: Vec, layer: Seen) -> tuple[Vec, Seen]:
            this, leaving, weight = lax.cond(first, eye, lambda: further(layer, choice))
            follow = ~first if options.bounces > 1 else None
            new, layers = layered(scene, world, this, later, on, leaving, follow)
            return color + new * weight, layers

        color, layers = lax.cond(jnp.any(on), see, lambda color, _: (color, none), color, layer)
        return (color, where(first, layers, seen)), None

    most = most_layers(world)
    row = Seen(no_hit, jnp.full(shape, False), zero)
    none = jax.tree.map(lambda x: jnp.broadcast_to(x, (most, *shape)), row)
    numbers = jnp.arange(1 + most * ways, dtype=jnp.int32)
    return lax.scan(look, (zeros(shape, scene.dtype), none), numbers)[0][0]
