"""Pixel radiance: what pixels see with all of their area, from the eye and in what they see first.

Edges are covered at the first hit and as they are seen in the first reflection or behind the first
bubble; what is seen after a second one is point-sampled.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool

from ..base.types import Ids, Index, Mask, PixelArray
from ..base.vec import Vec, spread, where, zeros
from ..scene.camera import Ray
from ..tracing.context import TraceContext
from ..tracing.differential import Differential
from ..tracing.hit import Hit, Surface
from ..tracing.path import Path, continues, first_path
from ..xla.compaction import nth_set
from ..xla.gather import take_pixels
from ..xla.rematerialization import remat
from .compositing import Layers, composite_layers, rows_at, secondary_path
from .depth_peeling import most_layers
from .silhouette import mean_surface, silhouette_distance


def pixel_radiance(context: TraceContext, ray: Differential[Ray], alive: Mask) -> Vec:
    """Returns the mean colour that pixels see.

    **Arguments:** `ray`: through the pixel's centre, with its differentials. `alive`: true where
    there is a pixel; others are 0.
    """
    if not context.settings.bounces:
        return composite_layers(context, ray, alive)[0]
    most, ways = most_layers(context), 2 if context.needs.branching else 1
    shape, count = alive.shape, alive.size
    nothing = Hit(jnp.full(shape, -1, context.tables.id_type), jnp.full(shape, False))
    row = Layers(nothing, jnp.full(shape, False), jnp.zeros(shape, context.dtype))
    none = jax.tree.map(lambda x: jnp.broadcast_to(x, (most, *shape)), row)
    looks = _Looks(context, ray, alive, nothing, none, ways)
    # one loop over the rays from the eye, number 0, and those on from the layers that they meet:
    # what rays see is compiled once (first calls of 5.2 and 8.8 s with a bounce, without and with
    # shadows, where two copies take 6.0 and 11; gradients take a tenth longer for it)
    firsts = jnp.arange(-1, most * ways, dtype=jnp.int32) * count
    # no bound method: `scan` hashes its function, and a module of arrays has no hash
    add = lambda state, first: looks.add(state, first)
    return lax.scan(add, (zeros(shape, context.dtype), none), firsts)[0][0]


class _Look(NamedTuple):
    """Rays that look on, from the eye or from layers."""

    pixel: Ids  #: which of the pixels
    layer: Ids  #: from which of its layers; any for the eye
    choice: Ids  #: 0 to reflect, 1 to go straight on
    alive: Mask


class _Looks(eqx.Module):
    """The looks from the eye and from the layers that its rays meet."""

    context: TraceContext
    ray: Differential[Ray]  #: from the eye
    alive: Mask
    nothing: Hit
    none: Layers  #: no layers
    ways: int = eqx.field(static=True)  #: 2 where paths branch, else 1

    def add(self, state: tuple[Vec, Layers], rank: Index) -> tuple[tuple[Vec, Layers], None]:
        """Adds the colours that some rays see.

        **Arguments:** `rank`: -1 or less for all rays from the eye; else the first one of the rays
        on from the layers.
        """
        color, seen = state
        first = jnp.asarray(rank < 0)
        look = lax.cond(first, lambda _: self._all(), lambda seen: self._next(seen, rank), seen)

        @remat
        def see(color: Vec, seen: Layers) -> tuple[Vec, Layers]:
            return self._see(color, seen, first, look)

        stop = lambda color, _: (color, self.none)
        color, layers = lax.cond(jnp.any(look.alive), see, stop, color, seen)
        return (color, where(first, layers, seen)), None

    def _all(self) -> _Look:
        """Returns the looks of all pixels from the eye."""
        pixel = jnp.arange(self.alive.size, dtype=jnp.int32)
        return _Look(pixel, jnp.zeros_like(pixel), jnp.zeros_like(pixel), self.alive)

    def _next(self, seen: Layers, rank: Index) -> _Look:
        """Returns the looks on from layers, as many as there are pixels, from a rank on."""
        count = self.alive.size
        ray = self.ray.value

        def goes_on(layer: Layers, choice: Index) -> Mask:
            return continues(self.context, first_path(ray, layer.hit, layer.shown), choice)

        alive = [jax.vmap(partial(goes_on, choice=k))(seen) for k in range(self.ways)]
        total, select = nth_set(jnp.stack(alive).reshape(-1))
        ranks = rank + jnp.arange(count, dtype=jnp.int32)
        valid = ranks < total
        place = jnp.where(valid, select(jnp.where(valid, ranks, 0)), 0)
        layer = place // count
        layers = seen.shown.shape[0]
        return _Look(place % count, layer % layers, layer // layers, valid)

    def _see(
        self, color: Vec, seen: Layers, first: Bool[Array, ""], look: _Look
    ) -> tuple[Vec, Layers]:
        bounces, count = self.context.settings.bounces, self.alive.size
        context = self.context.at_pixels(look.pixel)
        from_eye = spread(take_pixels(self.ray, look.pixel, count), look.pixel.shape)
        layer = rows_at(seen, look.layer, look.pixel, count)

        def from_layer() -> tuple[Differential[Ray], Hit, PixelArray]:
            shown = look.alive
            ray, path = secondary_differential(context, from_eye, layer.hit, shown, look.choice)
            return ray, path.hit, path.weight * layer.area

        from_nothing = lambda: (from_eye, self.nothing, jnp.ones(look.alive.shape, context.dtype))
        ray, source_hit, weight = lax.cond(first, from_nothing, from_layer)
        follow = ~first if bounces > 1 else None
        context = context.with_settings(bounces=max(bounces - 2, 0))
        new, layers = composite_layers(context, ray, look.alive, source_hit, follow)
        add = lambda x, new: x.at[look.pixel].add(jnp.where(look.alive, new, 0))
        return jax.tree.map(add, color, new * weight), layers


def secondary_differential(
    context: TraceContext, ray: Differential[Ray], hit: Hit, alive: Mask, choice: Index | Ids
) -> tuple[Differential[Ray], Path]:
    """Returns the rays on from a layer with their differentials, and the path at their centre."""

    def secondary(both: tuple[Ray, Surface]) -> Path:
        return secondary_path(context, *both, hit, alive, choice)

    distance = silhouette_distance(context, ray, hit)
    both = ray.paired_with(mean_surface(context, ray, hit, distance))
    return both.map(lambda both: secondary(both).ray), secondary(both.value)
