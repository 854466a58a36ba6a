"""The edge mask: pixels through which an edge may run.

Edges are silhouettes, horizons, lines where objects cross, the ends of shadows, and highlights that
N.L = 0 cuts off; they are looked for at the first two hits of a path. Only these pixels are
composited from layers (`compositing.py`); all others are what their one ray sees. A ray cone bounds
how wide a pixel is where its ray meets something. The mask may be set too often, which costs time,
but is never clear where there is such an edge. Everything here is discrete and runs under
`stop_gradient`.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp

from ..acceleration.sphere_blocks import PixelCone
from ..base.safe_math import safe_sqrt
from ..base.types import Ids, Index, Mask, PixelArray
from ..base.vec import dot, norm
from ..scene.camera import Ray
from ..scene.light import Light, light_of
from ..scene.lights import Lights
from ..tracing.candidates import cone_candidates, shadow_candidates, shadow_cone
from ..tracing.cone import LEAST_COS_VIEW, RayCone
from ..tracing.context import TraceContext
from ..tracing.hit import Hit, PixelHit, ShadowSegment, Surface, shadow_segment
from ..tracing.queries import shadow_scale
from ..tracing.shading import HIGHLIGHTS
from ..tracing.shapes.plane import Plane
from ..tracing.shapes.sphere import Sphere
from ..tracing.surface import surface_at
from ..xla.loops import loop


class _Footprint(eqx.Module):
    """The hit of a pixel's ray, and the size of the pixel there."""

    surface: Surface
    t: PixelArray  #: the distance to the hit, infinite where there is none
    cone_radius: PixelArray  #: the radius of the ray's cone at the hit
    radius: PixelArray  #: the radius of the pixel's footprint on the surface


class _Pixels(eqx.Module):
    """What objects are told of pixels whose edges are looked for."""

    ray: Ray
    cone: RayCone
    t: PixelArray  #: the distance to the hit, infinite where there is none
    cone_radius: PixelArray  #: the radius of the ray's cone at the hit
    steep: PixelArray  #: how much the depth of the surface hit varies across the pixel
    id: Ids  #: of the object hit
    is_sphere: Mask  #: true where a sphere is hit
    source: Ids | None  #: the number of the object that the ray starts from; None for the eye


def edge_mask(
    context: TraceContext,
    ray: Ray,
    cone: RayCone,
    hit: Hit,
    source_hit: Hit | None = None,
    alive: Mask | None = None,
) -> Mask:
    """Tests whether any edge may run through the pixels of rays.

    **Arguments:** `hit`: what the rays meet. `source_hit`: the hit that the rays start from, None
    for rays from the eye. `alive`: the pixels that have rays, None for all; others have no edges.
    """
    needs = context.needs
    context, ray, cone, hit = jax.lax.stop_gradient((context, ray, cone, hit))
    lights = context.scene.lights
    alive = jnp.full(hit.id.shape, True) if alive is None else alive
    edge = context.compute_once(lambda: _object_edges(context, ray, cone, hit, source_hit, alive))
    if not needs.shadows and not needs.highlights:
        return edge

    def add_light(directional: bool, k: Index, edge: Mask) -> Mask:
        number = _number_of(lights, directional, k)
        light, shadows = light_of(lights, number, directional, False), needs.shadows_of(number)
        look = alive & (hit.id >= 0)
        return edge | look & context.compute_once(
            lambda: _light_edges(context, ray, cone, hit, light, shadows, look & ~edge)
        )

    for directional in (False, True):
        count = len(lights.numbers(directional))
        edge = loop(count, partial(add_light, directional), edge)
    return edge


def _number_of(lights: Lights, directional: bool, k: Index) -> Index:
    """Returns the number of a light, from its number among the lights of its kind."""
    numbers = lights.numbers(directional)
    if len(numbers) == len(lights):
        return k
    return numbers[k] if isinstance(k, int) else jnp.asarray(numbers, jnp.int32)[k]


def _footprint(context: TraceContext, ray: Ray, cone: RayCone, hit: Hit) -> _Footprint:
    surface = surface_at(context, ray, hit)
    hits = hit.id >= 0
    t = jnp.where(hits, dot(surface.point - ray.origin, ray.direction), jnp.inf)
    radius = cone.radius_at(jnp.where(hits, t, 0))
    return _Footprint(surface, t, radius, radius / jnp.maximum(surface.cos_view, LEAST_COS_VIEW))


def _object_edges(
    context: TraceContext,
    ray: Ray,
    cone: RayCone,
    hit: Hit,
    source_hit: Hit | None,
    alive: Mask,
) -> Mask:
    """Tests for silhouettes, horizons, and lines where objects cut the surface that is hit."""
    crossings = context.needs.crossings
    foot = _footprint(context, ray, cone, hit)
    steep = safe_sqrt(foot.radius * foot.radius - foot.cone_radius * foot.cone_radius)
    is_sphere = context.tables.is_sphere(hit.id)
    source = None if source_hit is None else source_hit.id
    pixels = _Pixels(ray, cone, foot.t, foot.cone_radius, steep, hit.id, is_sphere, source)

    def add(pixel: _Pixels, object_: Sphere | Plane, number: Ids | Index, edge: Mask) -> Mask:
        is_source = None if pixel.source is None else pixel.source == number
        is_other = pixel.id != number
        seen = PixelHit(pixel.t, is_other, pixel.is_sphere, is_source)
        edge = edge | object_.near_silhouette(pixel.ray, pixel.cone, seen)
        if not crossings:
            return edge
        return edge | is_other & object_.near_crossing(
            pixel.ray, pixel.cone_radius, pixel.steep, pixel.t
        )

    end = foot.t + steep + foot.cone_radius if crossings else foot.t
    width = PixelCone(ray, cone.radius, cone.spread, alive, end=end)
    seen = cone_candidates(context, width, source_hit)
    return context.fold(add, pixels, jnp.full(alive.shape, False), candidates=seen) & alive


def _light_edges(
    context: TraceContext,
    ray: Ray,
    cone: RayCone,
    hit: Hit,
    light: Light,
    shadows: bool,
    look: Mask,
) -> Mask:
    """Tests whether a light's shadow ends, or N.L = 0 cuts its highlight off.

    **Arguments:** `shadows`: false where no object can stand in the light's way. `look`: the pixels
    to look at; others may be set or not.
    """
    pixel, needs = _footprint(context, ray, cone, hit), context.needs
    scale = shadow_scale(context, light)
    radius = pixel.radius * scale
    segment = shadow_segment(pixel.surface.point * scale, light.scaled(scale))
    facing = dot(pixel.surface.normal, segment.to_light)  # N.L times the light's distance

    def add_shadow(
        pixels: tuple[ShadowSegment, PixelArray, Ids],
        object_: Sphere | Plane,
        number: Ids | Index,
        edge: Mask,
    ) -> Mask:
        segment, radius, own = pixels
        return edge | object_.near_shadow_edge(segment, radius) & (own != number)

    edge = jnp.full(facing.shape, False)
    if shadows:
        look, done = look & (facing > 0), lambda edge: edge
        way = shadow_cone(light, pixel.surface.point, pixel.radius, look)
        near = shadow_candidates(context, light, way, done)
        pixels = segment, radius, hit.id
        edge = context.fold(add_shadow, pixels, edge, candidates=near, scale=scale) & (facing > 0)
    if needs.highlights:
        # across the footprint it changes by at most its radius times this: as N turns, and as the
        # way to a light at a point changes
        change = norm(segment.to_light) * context.curvature_of_hit(hit) / scale
        change = change if light.directional else change + 1
        ends = jnp.abs(facing) < radius * change
        model = HIGHLIGHTS[context.settings.highlight]
        abrupt = model.ends_abruptly(segment.to_light, ray.direction)
        edge = edge | ends & abrupt
    return edge
