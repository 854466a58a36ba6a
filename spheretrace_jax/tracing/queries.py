"""Ray queries, the discrete half of a picture: closest hits, and which lights a point sees.

Integers and booleans only: nothing here has a derivative, and everything runs under
`stop_gradient`. No epsilon: a ray that leaves a sphere never meets it from outside again (spheres
are convex) and skips it by its number.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex

from ..acceleration.accelerator import Accelerator
from ..acceleration.light_buffer import LightBuffer
from ..base.safe_math import to_order_one
from ..base.types import Ids, Index, Mask, PixelArray, Scalar
from ..base.vec import Vec, components
from ..scene.camera import Ray
from ..xla.gather import gather_rows
from ..xla.rematerialization import save_residuals
from .context import TraceContext
from .hit import Hit, ShadowSegment, shadow_segment
from .plane import Plane
from .sphere import Sphere

Best = tuple[PixelArray, Ids]
"""The distance of the closest object so far, and its number."""

Packed = Complex[Array, "*#pixels"]
"""The same two as one complex number."""


def closest_hit(context: TraceContext, ray: Ray, source_hit: Hit | None = None) -> Hit:
    """Finds the closest object in front of each ray's origin.

    **Arguments:** `source_hit`: the hit that the rays start from, None for rays from the eye. Rays
    that leave the object outwards, or go straight on through it, skip it; rays that were mirrored
    on the inside of a sphere may meet that sphere again, from inside. Only the object just left is
    skipped: what reflects light inside a bubble sees the bubble's wall from inside.

    **Returns:** per pixel the number of the object, -1 for none. Of objects equally near, the
    first.
    """
    context, ray, source_hit = jax.lax.stop_gradient((context, ray, source_hit))
    number = save_residuals(context.compute_once(lambda: _closest_object(context, ray, source_hit)))
    return known_hit(context, ray, number, source_hit)


def _closest_object(context: TraceContext, ray: Ray, source_hit: Hit | None) -> Ids:
    """Finds the numbers of the closest objects."""
    inside, found = context.needs.inside, context.accelerator
    shape = ray.direction.x.shape
    best = jnp.full(shape, jnp.inf, context.dtype), jnp.full(shape, -1, jnp.int32)

    def meet(object_: Sphere | Plane, number: Index, best: Best) -> Best:
        return _closer(best, *_meet(object_, ray, source_hit, number, inside), number)

    in_strip = found is not None and source_hit is None and found.screen_tiles.row is not None
    if found is None or (not in_strip and found.uniform_grid is None):
        best = context.fold(meet, best)
    else:
        best = _closest_listed_sphere(context, found, ray, source_hit, best)
        best = context.fold(meet, best, spheres=False)
    return best[1].astype(context.tables.id_type)


def _closest_listed_sphere(
    context: TraceContext, found: Accelerator, ray: Ray, source_hit: Hit | None, best: Best
) -> Best:
    """Finds the closest spheres: from the eye by screen tiles, from elsewhere by the grid."""
    shape, inside = ray.direction.x.shape, context.needs.inside
    if source_hit is not None:
        source_hit = Hit(source_hit.id.astype(jnp.int32), source_hit.inside)

    # the state packed: each array of it is computed by a loop of its own (4.5 against 2.2 ms)
    def visit(rays: tuple, center: Vec, radius: PixelArray, number: Ids, best: Packed) -> Packed:
        direction, origin, source_hit = rays
        ray_ = Ray(ray.origin if origin is None else origin, direction)
        t, skip = _meet(Sphere(center, radius), ray_, source_hit, number, inside)
        now = best.real, best.imag.astype(jnp.int32)
        return _pack(_closer(now, t, skip, number, in_order=False))

    packed = _pack(best)
    if found.uniform_grid is None or (source_hit is None and found.screen_tiles.row is not None):
        never = lambda best: jnp.full(best.shape, False)
        packed = found.screen_tiles.visit((ray.direction, None, None), visit, packed, never)
    else:
        to_pixels = lambda x: jnp.broadcast_to(x, shape)
        rays = ray.direction, jax.tree.map(to_pixels, ray.origin), source_hit
        alive = jnp.full(shape, True) if source_hit is None else source_hit.id >= 0
        packed = found.uniform_grid.visit(ray, alive, visit, rays, packed, lambda best: best.real)
    return packed.real, packed.imag.astype(jnp.int32)


def _meet(
    object_: Sphere | Plane,
    ray: Ray,
    source_hit: Hit | None,
    number: Ids | Index,
    may_be_inside: bool,
) -> tuple[PixelArray, Mask | None]:
    """Returns the distance to an object's visible hit, and which rays skip the object."""
    if source_hit is None:
        return object_.closest_hit(ray, None, None, may_be_inside)
    is_source = source_hit.id == number
    return object_.closest_hit(ray, is_source, source_hit.inside, may_be_inside)


def _pack(best: Best) -> Packed:
    return jax.lax.complex(best[0], best[1].astype(best[0].dtype))


def _closer(
    best: Best, t: PixelArray, skip: Mask | None, number: Ids | Index, in_order: bool = True
) -> Best:
    """Returns the closer of the closest object so far and another one.

    **Arguments:** `in_order`: true where all objects so far have smaller numbers.
    """
    closer = t < best[0]
    if not in_order:
        closer = closer | (t == best[0]) & (number < best[1])
    closer = closer & (t > 0)
    if skip is not None:
        closer = closer & ~skip
    return jnp.where(closer, t, best[0]), jnp.where(closer, number, best[1])


def known_hit(context: TraceContext, ray: Ray, number: Ids, source_hit: Hit | None = None) -> Hit:
    """Returns the hits of rays that are known to meet some objects first.

    **Arguments:** `number`: of these objects, -1 for none. `source_hit`: as for `closest_hit`.
    """
    if not context.needs.inside:
        return Hit(number, jnp.full(number.shape, False))
    context, ray, source_hit = jax.lax.stop_gradient((context, ray, source_hit))

    def from_inside() -> Mask:
        inside = gather_rows(context.tables.spheres, number).seen_from_inside(ray)
        if source_hit is not None:
            inside = inside | (source_hit.id == number) & source_hit.inside
        return inside & context.tables.is_sphere(number)

    return Hit(number, context.compute_once(from_inside))


def light_visible(context: TraceContext, point: Vec, hit: Hit, light: Vec) -> Mask:
    """Tests for shadows: whether the open segment from each point to the light meets no object.

    An occluder beyond the light casts no shadow. Points on the outside of a sphere are not
    shadowed by it here (where N.L <= 0 they are unlit anyway); on its inside they are if the light
    is outside. Of points that lie on no object, -1, nothing is said.

    **Arguments:** `point`: surface points, with `hit` the objects they lie on. `light`: the
    light's position, a `Vec` of scalars.
    """
    context, point, hit, light = jax.lax.stop_gradient((context, point, hit, light))
    scale, found = shadow_scale(context, light), context.accelerator
    segment = shadow_segment(point * scale, light * scale)
    none = jnp.full(segment.square.shape, False)

    def occlude(object_: Sphere | Plane, number: Ids | Index, occluded: Mask) -> Mask:
        return occluded | _occludes(context, object_, segment, hit, number)

    if found is None or found.light_buffers is None:
        return ~context.fold(occlude, none, scale=scale)
    known, light_buffer = found.light_buffer(light)
    occluded = jax.lax.cond(
        known,
        lambda buffer: _occluded_by_listed(context, buffer, point, segment, hit, scale),
        lambda _: context.fold(occlude, none, planes=False, scale=scale),
        light_buffer,
    )
    return ~context.fold(occlude, occluded, spheres=False, scale=scale)


def _occludes(
    context: TraceContext,
    object_: Sphere | Plane,
    segment: ShadowSegment,
    hit: Hit,
    number: Ids | Index,
) -> Mask:
    is_own = hit.id == number
    return object_.occludes(segment, is_own, hit.inside, context.needs.inside)


def _occluded_by_listed(
    context: TraceContext,
    light_buffer: LightBuffer,
    point: Vec,
    segment: ShadowSegment,
    hit: Hit,
    scale: Scalar,
) -> Mask:
    """Tests segments against the spheres that the light buffer lists for their points."""

    def visit(rays: tuple, center: Vec, radius: PixelArray, number: Ids, occluded: Mask) -> Mask:
        segment_, hit_ = rays
        segment_ = ShadowSegment(segment_[0], segment.light, segment_[1], segment_[2])
        sphere = Sphere(center, radius).scaled(scale)
        return occluded | _occludes(context, sphere, segment_, hit_, number)

    hit = Hit(hit.id.astype(jnp.int32), hit.inside)
    rays = (segment.point, segment.to_light, segment.square), hit
    none = jnp.full(segment.square.shape, False)
    done = lambda occluded: occluded
    return light_buffer.visit(point, hit.id >= 0, visit, rays, none, done)


def shadow_scale(context: TraceContext, light: Vec) -> Scalar:
    """Returns a power of two that scales the largest length to a thousand, which is exact.

    The shadow test multiplies four lengths: in float32 it would overflow where a radius times the
    light's distance exceeds 1.8e19, and shadows would be lost (planets, in metres). A thousand and
    not one, as small spheres and near lights beside a planet are more than points so far away.
    """
    spheres = context.tables.spheres
    return 1024 * to_order_one(spheres.radius, *components(spheres.center), *components(light))
