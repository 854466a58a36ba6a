"""Depth peeling: which objects show in a pixel, from front to back.

The discrete half of covered edges (Everitt, "Interactive Order-Independent Transparency", 2001,
peels layers off with a depth test in the same way; here each layer is an object).
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from ..acceleration.sphere_blocks import PixelCone
from ..base.types import Ids, Index, Mask, PixelArray
from ..base.vec import norm, where
from ..scene.camera import Ray
from ..tracing.candidates import nearest_in_cone
from ..tracing.context import TraceContext
from ..tracing.differential import Differential
from ..tracing.hit import Hit
from ..tracing.shapes.plane import Plane
from ..tracing.shapes.sphere import Sphere
from ..xla.barriers import barrier
from .polygon import contain_pixel
from .silhouette import mean_surface, silhouette_distance, surface_crossing

#: Layers of one pixel; the last one is taken to cover all that is left of the pixel.
MOST_LAYERS = 8


class Layer(eqx.Module):
    """One object that shows in a pixel, without derivatives."""

    hit: Hit
    behind: Hit | None  #: the layer behind it, where surfaces may cut one another


class Candidate(eqx.Module):
    """An object that covers some of a pixel."""

    hit: Hit
    t: PixelArray  #: how deep it lies
    covers_all: Mask


class _State(NamedTuple):
    """The last layer that was peeled, and the pixels in which more may show."""

    last: Candidate
    alive: Mask


def peel_layers(
    context: TraceContext, ray: Differential[Ray], alive: Mask, source_hit: Hit | None
) -> tuple[Layer, Mask]:
    """Peels layers from front to back; returns them stacked, and which pixels have them.

    **Arguments:** `alive`: true where there is a pixel. `source_hit`: the hit that the rays start
    from, None for the eye.
    """
    context, ray = lax.stop_gradient((context, ray))
    nowhere = jnp.full(alive.shape, False)
    nothing = Hit(jnp.full(alive.shape, -1, context.tables.id_type), nowhere)
    start = _State(Candidate(nothing, jnp.zeros(alive.shape, context.dtype), nowhere), alive)

    def stop(state: _State) -> tuple:
        layer = Layer(nothing, nothing if context.needs.crossings else None)
        layers = jax.tree.map(lambda x: jnp.stack([x, x]), layer)
        return state, (layers, jnp.stack([nowhere, nowhere]))

    def two_more(state: _State, _: None) -> tuple:
        peel = lambda state: _peel_two(context, ray, source_hit, state)
        return lax.cond(jnp.any(state.alive), peel, stop, state)

    layers = lax.scan(two_more, start, None, length=most_layers(context) // 2)[1]
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), layers)


def _peel_two(
    context: TraceContext, ray: Differential[Ray], source_hit: Hit | None, state: _State
) -> tuple[_State, tuple[Layer, Mask]]:
    """Peels the next two layers."""
    found = next_layers(context, ray, state, source_hit)
    layers, shown, alive = [], [], state.alive
    for k in range(2):
        behind = found[k + 1].hit if context.needs.crossings else None
        layers.append(Layer(found[k].hit, behind))
        shown.append(alive & (found[k].hit.id >= 0))
        alive = shown[k] & ~found[k].covers_all
        if context.needs.crossings:
            distance = silhouette_distance(context, ray, found[k].hit)
            surface = mean_surface(context, ray, found[k].hit, distance)
            cut = surface_crossing(context, ray, surface, found[k + 1].hit)
            alive = alive | shown[k] & ~contain_pixel((cut.ahead,))
    stacked = jax.tree.map(lambda a, b: jnp.stack([a, b]), *layers)
    return _State(found[1], alive), (stacked, jnp.stack(shown))


def most_layers(context: TraceContext) -> int:
    """Returns how many layers are looked for: an even number, as two are found at once."""
    most = min(MOST_LAYERS, context.tables.object_count + 1)
    return most + most % 2


def next_layers(
    context: TraceContext, ray: Differential[Ray], state: _State, source_hit: Hit | None
) -> list[Candidate]:
    """Finds the closest two objects, three where they may cut one another, behind the last one."""
    last, alive = state
    shape, tables = last.t.shape, context.tables

    def candidate(number: Ids | Index, inside: Mask, t: PixelArray, covers_all: Mask) -> Candidate:
        number = jnp.broadcast_to(number, t.shape).astype(tables.id_type)
        return Candidate(Hit(number, inside), t, covers_all)

    def insert(
        pixels: tuple, object_: Sphere | Plane, number: Ids | Index, best: list[Candidate]
    ) -> list[Candidate]:
        ray, last, source_hit = pixels
        is_source = jnp.full(last.t.shape, False) if source_hit is None else source_hit.id == number
        source_inside = None if source_hit is None else source_hit.inside
        covers = object_.pixel_coverage(ray, is_source, source_inside, context.needs.inside)
        new = candidate(number, covers.inside, covers.t, covers.all)
        return _insert(best, last, new, covers.some)

    nowhere = jnp.full(shape, False)
    nothing = candidate(-1, nowhere, jnp.full(shape, jnp.inf, context.dtype), nowhere)
    best = [nothing] * (3 if context.needs.crossings else 2)
    width = (norm(ray.dx.origin) + norm(ray.dy.origin)) / 2
    spread = (norm(ray.dx.direction) + norm(ray.dy.direction)) / 2
    cone = PixelCone(ray.value, width, spread, alive, last.t)
    seen = nearest_in_cone(context, cone, source_hit, _last_depth)
    return context.fold(insert, (ray, last, source_hit), best, candidates=seen, unroll=0)


def _last_depth(best: list[Candidate]) -> PixelArray:
    """Returns how deep the last of the closest objects lies, infinite where there are fewer."""
    return best[-1].t


def _insert(
    best: list[Candidate], last: Candidate, new: Candidate, covers: Mask
) -> list[Candidate]:
    """Inserts an object where it is closer than others, and behind the last layer."""
    after = (new.t > last.t) | (new.t == last.t) & (new.hit.id > last.hit.id)
    # a barrier, or all of it is found again for each part of what is carried
    new, covers = barrier((new, covers & after & (new.t > 0)))
    nearer = lambda old: (new.t < old.t) | (new.t == old.t) & (new.hit.id < old.hit.id)
    closer = [covers & nearer(old) for old in best]
    here = [where(sooner, new, old) for sooner, old in zip(closer, best, strict=True)]
    moved = zip(closer, best, here[1:], strict=False)
    return [here[0], *(where(sooner, old, next_) for sooner, old, next_ in moved)]
