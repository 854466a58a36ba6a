"""Shadow edges: the part of a pixel that a light reaches, covered by area.

The lecture's lights are points, so shadows are sharp; only a pixel can be partly in shadow.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from ..base.derivatives import stop_first_gradient
from ..base.safe_math import clamp, larger, safe_sqrt
from ..base.types import Ids, Index, Mask, PixelArray
from ..base.vec import Vec, dot, norm, where
from ..scene.camera import Ray, unit_ray
from ..scene.light import Light
from ..tracing.candidates import few_shadow_candidates, shadow_cone
from ..tracing.context import TraceContext
from ..tracing.differential import Differential
from ..tracing.hit import Hit, ShadowedPixel
from ..tracing.shapes.plane import Plane
from ..tracing.shapes.sphere import Sphere, from_light
from ..tracing.surface import surface_at
from ..xla.barriers import barrier
from ..xla.compaction import replace_where
from ..xla.gather import smallest_int, take_pixels
from .coverage import disc_region
from .polygon import HalfPlane, Polygon, clipped_area, half_plane_of, whole_pixel

#: Shadow edges of one light in one pixel and layer; of further ones the centre decides.
EDGES = 2

# Shadow edges are looked at in groups of this part of the pixels, since some third of the pixels
# has one and few have two (for 2048 pixels 1.9 ms, where it takes 3.6 to look at all).
GROUPS = 4

# Half the chord that the search for a shadow's edge takes a pixel to have at least, as a part of
# its mean over the pixel: at the rim itself it is 0, and the edge's place would be undefined.
_LEAST_CHORD = 0.3

# A sphere is small where its radius is less than this many pixels of its shadow: the edge is then
# too curved to look for, and the disc's area is taken at the middle of what is visible.
_SMALL = 2


class _Shaded(eqx.Module):
    """The surfaces of pixels that a light may reach in part."""

    ray: Differential[Ray]
    extent: PixelArray  #: as in `SilhouetteDistance`
    middle: tuple[PixelArray, PixelArray]  #: of what is visible, pixels right and down
    hit: Hit


def lit_coverage(
    context: TraceContext,
    ray: Differential[Ray],
    extent: PixelArray,
    visible: Polygon,
    hit: Hit,
    light: Light,
) -> PixelArray:
    """Returns the part of what is visible of an object in a pixel that a light reaches, 0..1.

    Says the same as `queries.light_visible` where no edge runs through the pixel.

    **Arguments:** `hit`: the objects that are lit. `extent`: as in `SilhouetteDistance`. `visible`:
    the part of the pixel in which the object shows.
    """
    shaded = _Shaded(ray, extent, (visible.x, visible.y), hit)
    occluded, edges = _find_occluders(context, shaded, light)
    count, number = extent.size, jnp.concatenate(edges)

    # what few groups have is not worth its place in memory
    @jax.checkpoint
    def outside_shadow(places: Ids, _: Mask) -> HalfPlane:
        at = places % count
        shaded_, light_ = take_pixels((shaded, light), at, count)
        shaded_ = barrier(shaded_)
        return ~_shadow_half_plane(context.at_pixels(at), shaded_, number[places], light_)

    def cut() -> PixelArray:
        anywhere = whole_pixel(jnp.ones_like(number, extent.dtype))
        bright = replace_where(anywhere, number >= 0, outside_shadow, -(-count // GROUPS))
        bright = [jax.tree.map(lambda x, k=k: x[k * count :][:count], bright) for k in range(EDGES)]
        some = (edges[0] >= 0) & (visible.area > jnp.finfo(extent.dtype).eps)
        lit = clipped_area(*visible.sides, *bright)
        return jnp.where(some, lit / jnp.where(some, visible.area, 1), 1)

    part = lax.cond(jnp.any(edges[0] >= 0), cut, lambda: jnp.ones_like(extent))
    return jnp.where(occluded, 0, part)


class _Boundary(eqx.Module):
    """The boundary of one object's shadow, taken to be linear across the pixel."""

    f: Differential[PixelArray]  #: positive in the shadow
    q: Differential[Vec]  #: from the segment to the light to the occluding sphere's centre
    axis: Vec  #: the direction of that segment
    radius: PixelArray  #: the sphere's


def _boundary(
    context: TraceContext,
    shaded: _Shaded,
    place: tuple[PixelArray, PixelArray],
    number: Ids,
    light: Light,
) -> _Boundary:
    """Returns the boundary of an object's shadow, linear around a place in the pixel."""
    x, y = place
    sphere = context.sphere(number)
    radius = jnp.where(sphere.radius > 0, sphere.radius, 1)
    point = shaded.ray.at(x, y).map(
        lambda ray: surface_at(context, unit_ray(ray), shaded.hit).point
    )
    q = point.map(lambda p: from_light(p, light, sphere.center)[1])
    f = q.map(lambda q: radius - norm(q))
    if context.needs.planes:
        below = context.plane(number).shadow_function(point, light)
        f = where(context.tables.is_plane(number), below, f)
    return _Boundary(f.at(-x, -y), q.at(-x, -y), light.direction(point.value), radius)


def _shadow_half_plane(
    context: TraceContext, shaded: _Shaded, number: Ids, light: Light
) -> HalfPlane:
    """Returns the half-plane of the pixel in the shadow of one object."""
    at, straight = barrier(_find_edge(*stop_first_gradient((context, shaded, light)), number))
    edge = _boundary(context, shaded, at, number, light)
    curved = disc_region(edge.q, edge.axis, edge.radius).edge
    return where(straight, half_plane_of(edge.f), curved)


def _find_edge(
    context: TraceContext, shaded: _Shaded, light: Light, number: Ids
) -> tuple[tuple[PixelArray, PixelArray], Mask]:
    """Finds a place on the edge of a shadow, and whether to take the edge as straight there."""
    here = _boundary(context, shaded, shaded.middle, number, light)
    small = here.radius < _SMALL * larger(norm(here.q.dx), norm(here.q.dy))
    zero, near_rim = _find_zero(context, shaded, here.f)
    there = _boundary(context, shaded, zero, number, light)
    # seen from the edge, the middle is on the side that it is on, but for wild mirrors
    agree = there.f.at(*shaded.middle).value * here.f.at(*shaded.middle).value > 0
    x, y = where(agree & ~small, zero, shaded.middle)
    return (x, y), context.tables.is_plane(number) | near_rim & ~small


def _find_zero(
    context: TraceContext, shaded: _Shaded, f: Differential[PixelArray]
) -> tuple[tuple[PixelArray, PixelArray], Mask]:
    """Finds a place in the pixel, from the middle on, where a function of the surface is zero.

    Near a rim a surface runs away from the viewer, as the root of the distance to the rim, and
    every line on it comes to the rim as a parabola does. So half the chord of the ray inside the
    sphere is the coordinate in which the function is taken to be linear.

    **Arguments:** `f`: the function, as its derivatives at the middle say, seen from the centre.

    **Returns:** the place, right and down of the centre; and whether the rim is so near that the
    function is far from linear in the pixel.
    """
    x, y = shaded.middle
    sphere = context.sphere(shaded.hit.id)
    across = lambda ray: sphere.perpendicular(ray)[1]
    least = _LEAST_CHORD * sphere.mean_chord(across(shaded.ray.value), shaded.extent)[0]
    least = jnp.where(least > 0, least, 1)
    q = shaded.ray.at(x, y).map(lambda ray: across(unit_ray(ray)))
    square = sphere.radius * sphere.radius - dot(q.value, q.value)
    chord = safe_sqrt(larger(square, least * least))

    slope = safe_sqrt(f.dx * f.dx + f.dy * f.dy)
    per_slope = 1 / jnp.where(slope > 0, slope, 1)
    right, down = f.dx * per_slope, f.dy * per_slope
    step = -f.at(x, y).value * per_slope
    # along this line the square of the chord, and the chord itself, grow by so much
    to_right, to_down = dot(q.value, q.dx), dot(q.value, q.dy)
    grows = -2 * (to_right * right + to_down * down)
    is_sphere = ~context.tables.is_plane(shaded.hit.id)
    on_sphere = is_sphere & (grows != 0)
    steepest = 2 * safe_sqrt(to_right * to_right + to_down * to_down)
    near_rim = is_sphere & (chord * chord < 2 * steepest)
    new = chord + step * grows / (2 * chord)
    straight = step * (new + chord) / (2 * chord)
    rim = (least * least - chord * chord) / jnp.where(on_sphere, grows, 1)
    step = jnp.where(on_sphere, jnp.where(new > least, straight, rim), step)
    step = clamp(step, -0.5, 0.5)
    return (x + step * right, y + step * down), near_rim


class _Edge(NamedTuple):
    """The edge of an object's shadow in pixels."""

    number: Ids  #: the object's, the number of objects for none
    center: Mask  #: true where the middle of what is seen is dark


def _find_occluders(
    context: TraceContext, shaded: _Shaded, light: Light
) -> tuple[Mask, tuple[Ids, ...]]:
    """Finds pixels that are wholly dark, and the objects whose shadows' edges cross the others."""
    context, shaded, light = lax.stop_gradient((context, shaded, light))
    hit, middle = shaded.hit, shaded.middle
    point = shaded.ray.at(*middle).map(lambda ray: surface_at(context, unit_ray(ray), hit).point)
    pixel = ShadowedPixel(point, middle, light, light.distance(point.value))
    # near a rim the derivatives grow without bound, but no pixel sees more than all of a sphere
    footprint, size = pixel.footprint, 2 * context.sphere(hit.id).radius
    beyond = context.tables.is_sphere(hit.id) & (footprint > size)
    shrink = jnp.where(beyond, size / jnp.where(beyond, footprint, 1), 1)
    slopes = jax.tree.map(lambda slope: slope * shrink[None, None], point.slopes)
    pixel = eqx.tree_at(lambda p: p.point.slopes, pixel, slopes)

    count, shape = context.tables.object_count, pixel.light_distance.shape

    def add(pixels: tuple, object_: Sphere | Plane, number: Ids | Index, state: tuple) -> tuple:
        (pixel, hit), (occluded, edges) = pixels, state
        is_own = hit.id == number
        dark = object_.shadow_coverage(pixel, is_own, hit.inside, context.needs.inside)
        crosses = dark.some & ~dark.all
        new = jnp.where(crosses, number, count).astype(edges[0].number.dtype)
        new, kept = _Edge(new, dark.center), []
        # the first ones by number, so that the order in which they come does not matter
        for edge in edges:
            sooner = new.number < edge.number
            kept.append(where(sooner, new, edge))
            new = where(sooner, edge, new)
        return occluded | dark.all | (new.number < count) & new.center, tuple(kept)

    nowhere = jnp.full(shape, False)
    nothing = _Edge(jnp.full(shape, count, smallest_int(count + 1)), nowhere)
    done = lambda state: state[0]
    radius = pixel.footprint
    if context.needs.inside:
        # a sphere that is seen from inside shadows itself, also where the mean point lies off it
        away = norm(point.value - context.sphere(hit.id).center)
        radius = jnp.where(hit.inside, larger(radius, away), radius)
    way = shadow_cone(light, point.value, radius, hit.id >= 0)
    near = few_shadow_candidates(context, way, done)
    occluded, edges = context.fold(
        add, (pixel, hit), (nowhere, (nothing,) * EDGES), candidates=near, unroll=0
    )
    numbers = (jnp.where(e.number < count, e.number, -1) for e in edges)
    return occluded, tuple(x.astype(context.tables.id_type) for x in numbers)
