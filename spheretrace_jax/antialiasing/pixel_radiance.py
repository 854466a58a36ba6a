"""Pixel radiance: what pixels see with all of their area, from the eye and in what they see first.

Edges are covered at the first hit and as they are seen in the first reflection or behind the first
bubble; what is seen after a second one is point-sampled.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool

from ..base.types import Index, Mask, PixelArray
from ..base.vec import Vec, spread, where, zeros
from ..scene.camera import Ray
from ..tracing.context import TraceContext
from ..tracing.differential import Differential
from ..tracing.hit import Hit, Surface
from ..tracing.path import Path, continues, first_path
from ..xla.rematerialization import remat
from .compositing import Layers, composite_layers, secondary_path
from .depth_peeling import most_layers
from .silhouette import mean_surface, silhouette_distance


def pixel_radiance(context: TraceContext, ray: Differential[Ray], alive: Mask) -> Vec:
    """Returns the mean colour that pixels see.

    **Arguments:** `ray`: through the pixel's centre, with its differentials. `alive`: true where
    there is a pixel; others are 0.
    """
    if not context.settings.bounces:
        return composite_layers(context, ray, alive)[0]
    shape, ways = alive.shape, 2 if context.needs.branching else 1
    nothing = Hit(jnp.full(shape, -1, context.tables.id_type), jnp.full(shape, False))
    zero = jnp.zeros(shape, context.dtype)
    row = Layers(nothing, jnp.full(shape, False), zero)
    most = most_layers(context)
    none = jax.tree.map(lambda x: jnp.broadcast_to(x, (most, *shape)), row)
    looks = _Looks(context, ray, alive, nothing, none, ways)
    # one loop over the ray from the eye, number 0, and those on from the layers that it meets:
    # what rays see is compiled once (first calls of 5.2 and 8.8 s with a bounce, without and with
    # shadows, where two copies take 6.0 and 11; gradients take a tenth longer for it)
    numbers = jnp.arange(1 + most * ways, dtype=jnp.int32)
    # no bound method: `scan` hashes its function, and a module of arrays has no hash
    add = lambda state, number: looks.add(state, number)
    return lax.scan(add, (zeros(shape, context.dtype), none), numbers)[0][0]


class _Looks(eqx.Module):
    """The looks from the eye and from the layers that its rays meet."""

    context: TraceContext
    ray: Differential[Ray]  #: from the eye
    alive: Mask
    nothing: Hit
    none: Layers  #: no layers
    ways: int = eqx.field(static=True)  #: 2 where paths branch, else 1

    def add(self, state: tuple[Vec, Layers], number: Index) -> tuple[tuple[Vec, Layers], None]:
        """Adds the colours that look `number` sees, 0 being that from the eye."""
        color, seen = state
        first, behind = jnp.asarray(number == 0), jnp.maximum(number - 1, 0)
        layer, choice = seen.layer(behind // self.ways), behind % self.ways
        path = first_path(self.ray.value, layer.hit, layer.shown)
        alive = jnp.where(first, self.alive, continues(self.context, path, choice))

        @remat
        def see(color: Vec, layer: Layers) -> tuple[Vec, Layers]:
            return self._see(color, layer, first, choice, alive)

        stop = lambda color, _: (color, self.none)
        color, layers = lax.cond(jnp.any(alive), see, stop, color, layer)
        return (color, where(first, layers, seen)), None

    def _see(
        self, color: Vec, layer: Layers, first: Bool[Array, ""], choice: Index, alive: Mask
    ) -> tuple[Vec, Layers]:
        bounces = self.context.settings.bounces
        ray, source_hit, weight = lax.cond(
            first, lambda: self._from_eye(), lambda: self._from_layer(layer, choice)
        )
        follow = ~first if bounces > 1 else None
        context = self.context.with_settings(bounces=max(bounces - 2, 0))
        new, layers = composite_layers(context, ray, alive, source_hit, follow)
        return color + new * weight, layers

    def _from_eye(self) -> tuple[Differential[Ray], Hit, PixelArray]:
        shape = self.alive.shape
        ray = spread(self.ray, shape)
        return ray, self.nothing, jnp.ones(shape, self.context.dtype)

    def _from_layer(
        self, layer: Layers, choice: Index
    ) -> tuple[Differential[Ray], Hit, PixelArray]:
        """Returns the ray on from a layer, the hit that it starts from, and its weight."""
        ray, path = secondary_differential(self.context, self.ray, layer.hit, layer.shown, choice)
        return ray, path.hit, path.weight * layer.area


def secondary_differential(
    context: TraceContext, ray: Differential[Ray], hit: Hit, alive: Mask, choice: Index
) -> tuple[Differential[Ray], Path]:
    """Returns the rays on from a layer with their differentials, and the path at their centre."""

    def secondary(both: tuple[Ray, Surface]) -> Path:
        return secondary_path(context, *both, hit, alive, choice)

    distance = silhouette_distance(context, ray, hit)
    both = ray.paired_with(mean_surface(context, ray, hit, distance))
    return both.map(lambda both: secondary(both).ray), secondary(both.value)
