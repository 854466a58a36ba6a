"""The edge mask: pixels through which an edge may run.

Edges are silhouettes, horizons, lines where objects cross, the ends of shadows, and highlights that
N.L = 0 cuts off; they are looked for at the first two hits of a path. Only these pixels are
composited from layers (`compositing.py`); all others are what their one ray sees. A ray cone bounds
how wide a pixel is where its ray meets something. The mask may be set too often, which costs time,
but is never clear where there is such an edge. Everything here is discrete and runs under
`stop_gradient`.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from ..base.safe_math import safe_sqrt
from ..base.types import Index, Mask, PixelArray
from ..base.vec import Vec, dot, norm, vec
from ..scene.camera import Ray
from ..tracing.cone import LEAST_COS_VIEW, RayCone
from ..tracing.context import TraceContext
from ..tracing.hit import Hit, PixelHit, Surface, shadow_segment
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


def edge_mask(
    context: TraceContext, ray: Ray, cone: RayCone, hit: Hit, source_hit: Hit | None = None
) -> Mask:
    """Tests whether any edge may run through the pixels of rays.

    **Arguments:** `hit`: what the rays meet. `source_hit`: the hit that the rays start from, None
    for rays from the eye.
    """
    needs, lights = context.needs, context.scene.lights.position
    context, lights, ray, cone, hit = jax.lax.stop_gradient((context, lights, ray, cone, hit))
    edge = context.compute_once(lambda: _object_edges(context, ray, cone, hit, source_hit))
    if not needs.shadows and not needs.highlights:
        return edge

    def add_light(k: Index, edge: Mask) -> Mask:
        light, shadows = vec(lights[k]), needs.shadows_of(k)
        return edge | (hit.id >= 0) & context.compute_once(
            lambda: _light_edges(context, ray, cone, hit, light, shadows)
        )

    return loop(len(lights), add_light, edge)


def _footprint(context: TraceContext, ray: Ray, cone: RayCone, hit: Hit) -> _Footprint:
    surface = surface_at(context, ray, hit)
    hits = hit.id >= 0
    t = jnp.where(hits, dot(surface.point - ray.origin, ray.direction), jnp.inf)
    radius = cone.radius_at(jnp.where(hits, t, 0))
    return _Footprint(surface, t, radius, radius / jnp.maximum(surface.cos_view, LEAST_COS_VIEW))


def _object_edges(
    context: TraceContext, ray: Ray, cone: RayCone, hit: Hit, source_hit: Hit | None
) -> Mask:
    """Tests for silhouettes, horizons, and lines where objects cut the surface that is hit."""
    pixel = _footprint(context, ray, cone, hit)
    is_sphere = context.tables.is_sphere(hit.id)

    def add_silhouette(object_: Sphere | Plane, number: Index, edge: Mask) -> Mask:
        is_source = None if source_hit is None else source_hit.id == number
        seen = PixelHit(pixel.t, hit.id != number, is_sphere, is_source)
        return edge | object_.near_silhouette(ray, cone, seen)

    edge = context.fold(add_silhouette, jnp.full(pixel.t.shape, False))
    if not context.needs.crossings:
        return edge
    steep = safe_sqrt(pixel.radius * pixel.radius - pixel.cone_radius * pixel.cone_radius)

    def add_crossing(object_: Sphere | Plane, number: Index, edge: Mask) -> Mask:
        return edge | object_.near_crossing(ray, pixel.cone_radius, steep, pixel.t) & (
            hit.id != number
        )

    return context.fold(add_crossing, edge)


def _light_edges(
    context: TraceContext, ray: Ray, cone: RayCone, hit: Hit, light: Vec, shadows: bool
) -> Mask:
    """Tests whether a light's shadow ends, or N.L = 0 cuts its highlight off.

    **Arguments:** `shadows`: false where no object can stand in the light's way.
    """
    pixel, needs = _footprint(context, ray, cone, hit), context.needs
    scale = shadow_scale(context, light)
    radius = pixel.radius * scale
    segment = shadow_segment(pixel.surface.point * scale, light * scale)
    facing = dot(pixel.surface.normal, segment.to_light)  # N.L times the light's distance

    def add_shadow(object_: Sphere | Plane, number: Index, edge: Mask) -> Mask:
        return edge | object_.near_shadow_edge(segment, radius) & (hit.id != number)

    edge = jnp.full(facing.shape, False)
    if shadows:
        edge = context.fold(add_shadow, edge, scale=scale) & (facing > 0)
    if needs.highlights:
        # across the footprint it changes by at most its radius times this
        change = norm(segment.to_light) * context.curvature_of_hit(hit) / scale + 1
        ends = jnp.abs(facing) < radius * change
        model = HIGHLIGHTS[context.settings.highlight]
        abrupt = model.ends_abruptly(segment.to_light, ray.direction)
        edge = edge | ends & abrupt
    return edge
