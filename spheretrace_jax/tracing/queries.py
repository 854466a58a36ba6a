"""Ray queries, the discrete half of a picture: closest hits, and which lights a point sees.

Integers and booleans only: nothing here has a derivative, and everything runs under
`stop_gradient`. No epsilon: a ray that leaves a sphere never meets it from outside again (spheres
are convex) and skips it by its number.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex

from ..acceleration.binning import Visitor
from ..acceleration.screen_tiles import ScreenTiles
from ..acceleration.uniform_grid import UniformGrid
from ..base.safe_math import to_order_one
from ..base.types import Ids, Index, Mask, PixelArray, Scalar
from ..base.vec import Vec, components
from ..scene.camera import Ray
from ..scene.light import Light
from ..xla.gather import gather_rows
from ..xla.rematerialization import save_residuals
from .context import TraceContext
from .hit import Hit, ShadowSegment, shadow_segment
from .shapes.plane import Plane
from .shapes.sphere import Sphere

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
    may_be_inside, accelerator = context.needs.inside, context.accelerator
    shape = ray.direction.x.shape
    best = jnp.full(shape, jnp.inf, context.dtype), jnp.full(shape, -1, jnp.int32)

    def meet(ray: Ray, object_: Sphere | Plane, number: Ids | Index, best: Best) -> Best:
        return _closer(best, *_meet(object_, ray, source_hit, number, may_be_inside), number)

    visitor, all_spheres = partial(_visit, ray, may_be_inside), False
    if accelerator is not None and source_hit is None and accelerator.screen_tiles.row is not None:
        best = _unpack(_visit_tiles(accelerator.screen_tiles, ray, visitor, _pack(best)))
    elif accelerator is not None and accelerator.uniform_grid is not None:
        best = _unpack(_visit_grid(accelerator.uniform_grid, ray, source_hit, visitor, _pack(best)))
    else:
        all_spheres = True
    best = context.fold(meet, ray, best, spheres=all_spheres)
    return best[1].astype(context.tables.id_type)


def _visit_tiles(tiles: ScreenTiles, ray: Ray, visitor: Visitor, best: Packed) -> Packed:
    """Finds the closest spheres of rays from the eye, with the spheres of their tiles."""
    origin = ray.origin if jnp.ndim(ray.origin.x) else None  # one for all, but of parallel rays
    return tiles.visit(visitor, (ray.direction, origin, None), best)


def _visit_grid(
    grid: UniformGrid, ray: Ray, source_hit: Hit | None, visitor: Visitor, best: Packed
) -> Packed:
    """Finds the closest spheres of any rays, with the spheres of the boxes along them."""
    shape = ray.direction.x.shape
    alive = jnp.full(shape, True) if source_hit is None else source_hit.id >= 0
    if source_hit is not None:
        source_hit = Hit(source_hit.id.astype(jnp.int32), source_hit.inside)
    to_pixels = lambda x: jnp.broadcast_to(x, shape)
    rays = ray.direction, jax.tree.map(to_pixels, ray.origin), source_hit
    return grid.visit(ray, alive, visitor, rays, best, lambda best: best.real)


def _visit(
    eye_ray: Ray,
    may_be_inside: bool,
    rays: tuple[Vec, Vec | None, Hit | None],
    center: Vec,
    radius: PixelArray,
    number: Ids,
    best: Packed,
) -> Packed:
    """Updates the closest spheres with one more sphere for each ray.

    **Arguments:** `eye_ray`: whose origin rays have that bring none. `rays`: their direction,
    origin and source hit.
    """
    direction, origin, source_hit = rays
    ray = Ray(eye_ray.origin if origin is None else origin, direction)
    t, skip = _meet(Sphere(center, radius), ray, source_hit, number, may_be_inside)
    return _pack(_closer(_unpack(best), t, skip, number, in_order=False))


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
    """Packs the state in one array: each array of it is computed by a loop of its own.

    Two arrays take 4.5 ms, one 2.2.
    """
    return jax.lax.complex(best[0], best[1].astype(best[0].dtype))


def _unpack(best: Packed) -> Best:
    return best.real, best.imag.astype(jnp.int32)


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


def light_visible(context: TraceContext, point: Vec, hit: Hit, light: Light) -> Mask:
    """Tests for shadows: whether the open segment from each point to the light meets no object.

    An occluder beyond the light casts no shadow. Points on the outside of a sphere are not
    shadowed by it here (where N.L <= 0 they are unlit anyway); on its inside they are if the light
    is outside. Of points that lie on no object, -1, nothing is said.

    **Arguments:** `point`: surface points, with `hit` the objects they lie on.
    """
    context, point, hit, light = jax.lax.stop_gradient((context, point, hit, light))
    scale, accelerator = shadow_scale(context, light), context.accelerator
    segment = shadow_segment(point * scale, light.scaled(scale))
    none = jnp.full(hit.id.shape, False)

    def occlude(
        pixels: tuple[ShadowSegment, Hit],
        object_: Sphere | Plane,
        number: Ids | Index,
        occluded: Mask,
    ) -> Mask:
        segment, hit = pixels
        is_own = hit.id == number
        return occluded | object_.occludes(segment, is_own, hit.inside, context.needs.inside)

    visit = None
    if accelerator is not None and accelerator.light_buffers is not None:
        light_buffer, done = accelerator.light_buffer(light), lambda occluded: occluded
        visit = partial(light_buffer.visit, point, hit.id >= 0, done)
    return ~context.fold(occlude, (segment, hit), none, candidates=visit, scale=scale)


def shadow_scale(context: TraceContext, light: Light) -> Scalar:
    """Returns a power of two that scales the spheres' largest length to a thousand, exactly.

    The shadow test multiplies four lengths: in float32 it would overflow where a radius times the
    light's distance exceeds 1.8e19, and shadows would be lost (planets, in metres). A thousand and
    not one, as small spheres and near lights beside a planet are more than points so far away.
    """
    spheres = context.tables.spheres
    places = () if light.directional else components(light.place)
    return 1024 * to_order_one(spheres.radius, *components(spheres.center), *places)
