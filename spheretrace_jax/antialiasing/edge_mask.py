"""Which pixels an edge may run through: silhouettes, shadow edges, lines where surfaces meet.

Only these pixels are composed of layers (`layers.py`); all others are what their one ray sees. A
ray cone (Amanatides, "Ray Tracing with Cones", SIGGRAPH 1984) bounds how wide a pixel is where its
ray meets something. The answer may be yes too often, which costs time, but not no where it matters.
Everything here is discrete and runs under `stop_gradient`.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..base.safe_math import safe_sqrt
from ..base.types import Index, Mask, PixelArray
from ..base.vec import Vec, cross, dot, norm, vec
from ..scene.camera import Camera, Ray, view_frame
from ..scene.settings import RenderSettings
from ..tracing.intersect import perpendicular, ray_plane
from ..tracing.queries import shadow_scale, table_row
from ..tracing.shading import ends_abruptly
from ..tracing.tables import Hit, SceneTables, Surface, surface_at
from ..xla.barriers import compute_once
from ..xla.loops import loop

# In pixels: half the diagonal, and a little, as shading near a rim is averaged too.
_REACH = 0.75

# Facing, N.V, at which a pixel's footprint on a surface is no longer stretched further.
_LEAST_FACING = 1e-3


class RayCone(eqx.Module):
    """How wide a pixel is along its ray: a radius where the ray starts, and its growth."""

    radius: PixelArray  #: world units
    spread: PixelArray  #: per unit length

    def at(self, t: PixelArray) -> PixelArray:
        """The radius at a distance along the ray."""
        return self.radius + self.spread * jnp.maximum(t, 0)


def pixel_cones(camera: Camera, ray: Ray, side: PixelArray) -> RayCone:
    """The cones around pixels' rays. **Arguments:** `side`: of a pixel on the view plane."""
    straight = dot(ray.direction, view_frame(camera).forward)
    spread = _REACH * side / camera.distance * straight
    return RayCone(jnp.zeros_like(spread), spread)


def next_cone(
    cone: RayCone, world: SceneTables, ray: Ray, hit: Hit, surface: Surface, mirrored: Mask
) -> RayCone:
    """The cone after a hit: a sphere spreads what it mirrors."""
    width = cone.at(dot(surface.point - ray.origin, ray.direction))
    bend = 2 * width * _curvature(world, hit) / jnp.maximum(surface.facing, _LEAST_FACING)
    return RayCone(width, cone.spread + jnp.where(mirrored, bend, 0))


def _curvature(world: SceneTables, hit: Hit) -> PixelArray:
    """1/R of the object that is hit, 0 for a plane."""
    ball = (hit.id >= 0) & (hit.id < world.spheres)
    return jnp.where(ball, world.curvature(hit.id), 0)


def edge_mask(
    world: SceneTables,
    lights: Float[Array, "m 3"],
    ray: Ray,
    cone: RayCone,
    hit: Hit,
    leaving: Hit | None,
    settings: RenderSettings,
) -> Mask:
    """Whether any edge may run through the pixel at this hit.

    **Arguments:** `lights`: their positions. `leaving`: the hit that the rays start from, None for
    rays from the eye.
    """
    needs = settings.needs
    world, lights, ray, cone, hit = jax.lax.stop_gradient((world, lights, ray, cone, hit))
    hits = hit.id >= 0

    def met() -> tuple[Surface, PixelArray, PixelArray, PixelArray]:
        """What is hit and how far away, how wide the pixel is there, and on the surface."""
        surface = surface_at(world, ray, hit, needs)
        t = jnp.where(hits, dot(surface.point - ray.origin, ray.direction), jnp.inf)
        width = cone.at(jnp.where(hits, t, 0))
        return surface, t, width, width / jnp.maximum(surface.facing, _LEAST_FACING)

    def outline() -> Mask:
        _, t, width, footprint = met()
        rim = lambda i, edge: edge | _rim(world, i, ray, cone, hit, t, leaving)
        edge = loop(world.spheres, rim, jnp.full(t.shape, False))
        if needs.planes:
            edge = loop(world.planes, lambda i, e: e | _horizon(world, i, ray, cone, hit), edge)
        if needs.crossings:
            steep = safe_sqrt(footprint * footprint - width * width)
            meets = lambda i, e: e | _meets_ball(world, i, ray, width, steep, hit, t)
            edge = loop(world.spheres, meets, edge)
            if needs.planes:
                meets = lambda i, e: e | _meets_plane(world, i, ray, width, steep, hit, t)
                edge = loop(world.planes, meets, edge)
        return edge

    edge = compute_once(outline, world.window)
    if not needs.shadows and not needs.highlights:
        return edge

    def light_edge(k: Index, edge: Mask) -> Mask:
        def phase() -> Mask:
            surface, _, _, footprint = met()
            light, shadows = vec(lights[k]), needs.shadows_of(k)
            return _edge_of_light(world, ray, footprint, hit, surface, light, shadows, settings)

        return edge | hits & compute_once(phase, world.window)

    return loop(len(lights), light_edge, edge)


def _rim(
    world: SceneTables,
    i: Index,
    ray: Ray,
    cone: RayCone,
    hit: Hit,
    t: PixelArray,
    leaving: Hit | None,
) -> Mask:
    """A sphere's silhouette; none shows of the sphere that the ray just left."""
    ball = table_row(world.balls, i)
    along, q = perpendicular(ray.origin, ray.direction, ball.center)
    near = _between(dot(q, q), ball.radius, cone.at(along), 1) & (along > 0)
    hidden = (hit.id != i) & (t < along)
    return near & ~hidden if leaving is None else near & ~hidden & (leaving.id != i)


def _between(
    square: PixelArray, radius: PixelArray, width: PixelArray, scale: PixelArray | int
) -> Mask:
    """Whether a distance, given by its square over `scale`, is within `width` of a radius."""
    inner, outer = radius - width, radius + width
    return (square < outer * outer * scale) & ((inner < 0) | (square > inner * inner * scale))


def _horizon(world: SceneTables, i: Index, ray: Ray, cone: RayCone, hit: Hit) -> Mask:
    """Where a plane is seen edge-on, unless a sphere hides it."""
    level = jnp.abs(dot(ray.direction, table_row(world.flats, i).normal)) < cone.spread
    return level & ((hit.id < 0) | (hit.id >= world.spheres))


def _meets_ball(
    world: SceneTables,
    i: Index,
    ray: Ray,
    width: PixelArray,
    steep: PixelArray,
    hit: Hit,
    t: PixelArray,
) -> Mask:
    """Whether a sphere cuts the surface hit: both are equally deep somewhere in the pixel.

    **Arguments:** `steep`: how much the depth of the surface hit varies across the pixel.
    """
    ball = table_row(world.balls, i)
    along, q = perpendicular(ray.origin, ray.direction, ball.center)
    half = jnp.sqrt(ball.radius * ball.radius - dot(q, q))  # nan = miss
    apart = jnp.minimum(jnp.abs(along - half - t), jnp.abs(along + half - t))
    return (apart * half < steep * half + width * norm(q)) & (hit.id != i)


def _meets_plane(
    world: SceneTables,
    i: Index,
    ray: Ray,
    width: PixelArray,
    steep: PixelArray,
    hit: Hit,
    t: PixelArray,
) -> Mask:
    flat = table_row(world.flats, i)
    slope = jnp.abs(dot(ray.direction, flat.normal))
    apart = jnp.abs(ray_plane(ray.origin, ray.direction, flat.point, flat.normal) - t)
    return (apart * slope < steep * slope + width) & (hit.id != i + world.spheres)


def _edge_of_light(
    world: SceneTables,
    ray: Ray,
    width: PixelArray,
    hit: Hit,
    surface: Surface,
    light: Vec,
    shadows: bool,
    settings: RenderSettings,
) -> Mask:
    """Where a light's shadow ends, or its highlight where N.L = 0 cuts it off.

    **Arguments:** `width`: of the pixel on the surface. `shadows`: whether objects may stand in
    the light's way.
    """
    needs = settings.needs
    scale = shadow_scale(world, light)
    light, point, width = light * scale, surface.point * scale, width * scale
    to_light = light - point
    square = dot(to_light, to_light)
    cosine = dot(surface.normal, to_light)

    def shadow(i: Index, edge: Mask) -> Mask:
        ball = table_row(world.balls, i)
        to_center = ball.center * scale - point
        off = cross(to_center, to_light)
        along = dot(to_center, to_light)
        near = _between(dot(off, off), ball.radius * scale, width, square)
        return edge | near & (along > 0) & (along < square) & (hit.id != i)

    def foot(i: Index, edge: Mask) -> Mask:
        flat = table_row(world.flats, i)
        near = jnp.abs(dot(point - flat.point * scale, flat.normal)) < width
        return edge | near & (hit.id != i + world.spheres)

    edge = jnp.full(cosine.shape, False)
    if shadows:
        edge = loop(world.spheres, shadow, edge)
        if needs.planes:
            edge = loop(world.planes, foot, edge)
        edge = edge & (cosine > 0)
    if needs.highlights:
        curved = norm(to_light) * _curvature(world, hit) / scale + 1
        ends = jnp.abs(cosine) < width * curved
        edge = edge | ends & ends_abruptly(settings.highlight, to_light, ray.direction)
    return edge
