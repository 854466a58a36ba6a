"""How much of a pixel a light reaches: shadow edges, covered by area.

The lecture's lights are points, so shadows are sharp; only a pixel can be partly in shadow.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from ..base.safe_math import safe_sqrt
from ..base.types import Ids, Mask, PixelArray
from ..base.vec import Vec, dot, norm, unit, where
from ..scene.camera import Ray, unit_ray
from ..scene.needs import Needs
from ..tracing.intersect import perpendicular
from ..tracing.queries import table_row
from ..tracing.tables import Hit, SceneTables, mean_chord, surface_at
from ..xla.barriers import barrier
from ..xla.compaction import replace_where
from ..xla.loops import loop
from .coverage import disc_region
from .differential import Differential
from .polygon import HalfPlane, Polygon, clipped_area, half_plane_of, whole_pixel

#: Shadow edges of one light in one pixel and layer; of further ones the centre decides.
EDGES = 2

# Shadow edges, of which some third of the pixels have one and few two, are looked at in groups of
# this part of the pixels (for 2048 of them 1.9 ms, where it takes 3.6 to look at all).
GROUPS = 4


def lit_coverage(
    world: SceneTables,
    beam: Differential[Ray],
    reach: PixelArray,
    visible: Polygon,
    hit: Hit,
    light: Vec,
    needs: Needs,
) -> PixelArray:
    """The part of what is visible of an object in a pixel that a light reaches, 0..1.

    Says the same as `visibility.unoccluded` where no edge runs through the pixel.

    **Arguments:** `hit`: the objects that are lit. `reach`: as in `outlines.Rim`. `visible`:
    what of the pixel the object shows in.
    """
    place = visible.x, visible.y
    blocked, edges = _find_occluders(world, beam, reach, place, hit, light, needs)

    count, number = reach.size, jnp.concatenate(edges)

    # what few groups have is not worth its place in memory
    @jax.checkpoint
    def outside(places: Ids, _: Mask) -> HalfPlane:
        at = places % count
        # rays from the eye have one origin for all
        pick = lambda x: x[at] if x.ndim else x
        beam_, reach_, place_, hit_ = barrier(jax.tree.map(pick, (beam, reach, place, hit)))
        world_ = world if world.own is None else world.with_own(world.own.at(at))
        light_ = jax.tree.map(pick, light)
        return ~_shadow(world_, beam_, reach_, place_, hit_, number[places], light_, needs)

    def cut() -> PixelArray:
        anywhere = whole_pixel(jnp.ones_like(number, reach.dtype))
        bright = replace_where(anywhere, number >= 0, outside, -(-count // GROUPS))
        bright = [jax.tree.map(lambda x, k=k: x[k * count :][:count], bright) for k in range(EDGES)]
        some = (edges[0] >= 0) & (visible.area > jnp.finfo(reach.dtype).eps)
        lit = clipped_area(*visible.sides, *bright)
        return jnp.where(some, lit / jnp.where(some, visible.area, 1), 1)

    part = lax.cond(jnp.any(edges[0] >= 0), cut, lambda: jnp.ones_like(reach))
    return jnp.where(blocked, 0, part)


def _from_light(point: Vec, light: Vec, center: Vec) -> tuple[PixelArray, Vec]:
    """Where the way from a point to the light passes a centre, as `perpendicular` says."""
    return perpendicular(point, unit(light - point), center)


class _Bound(eqx.Module):
    """What bounds a shadow, taken to be linear across the pixel."""

    f: Differential[PixelArray]  #: positive in the shadow
    q: Differential[Vec]  #: from the way to the light to the centre of the sphere that is in it
    axis: Vec  #: the direction of that way
    radius: PixelArray  #: the sphere's


def _bound(
    world: SceneTables,
    beam: Differential[Ray],
    place: tuple[PixelArray, PixelArray],
    hit: Hit,
    number: Ids,
    light: Vec,
    needs: Needs,
) -> _Bound:
    """What bounds the shadow of one object, as its derivatives at a place in the pixel say."""
    x, y = place
    ball = world.ball(number)
    radius = jnp.where(ball.radius > 0, ball.radius, 1)
    there = beam.at(x, y).map(lambda ray: surface_at(world, unit_ray(ray), hit, needs).point)
    q = there.map(lambda p: _from_light(p, light, ball.center)[1])
    f = q.map(lambda q: radius - norm(q))
    if needs.planes:
        flat = world.flat(number)
        side = jnp.where(dot(light - flat.point, flat.normal) > 0, -1, 1).astype(radius.dtype)
        below = there.map(lambda p: dot(p - flat.point, flat.normal) * side)
        f = where(number >= world.spheres, below, f)
    return _Bound(f.at(-x, -y), q.at(-x, -y), unit(light - there.value), radius)


def _shadow(
    world: SceneTables,
    beam: Differential[Ray],
    reach: PixelArray,
    place: tuple[PixelArray, PixelArray],
    hit: Hit,
    number: Ids,
    light: Vec,
    needs: Needs,
) -> HalfPlane:
    """The half-plane of the pixel in the shadow of one object."""

    def edge_place(
        world: SceneTables, beam: Differential[Ray], reach: PixelArray, light: Vec
    ) -> tuple:
        """Where the edge runs, and whether to take it as straight."""
        here = _bound(world, beam, place, hit, number, light, needs)
        small = here.radius < 2 * jnp.maximum(norm(here.q.dx), norm(here.q.dy))
        zero, near_rim = _where_zero(world, beam, reach, place, hit, here.f)
        there = _bound(world, beam, zero, hit, number, light, needs)
        # seen from the edge, the place is on the side that it is on, but for wild mirrors
        agree = there.f.at(*place).value * here.f.at(*place).value > 0
        x, y = where(agree & ~small, zero, place)
        return (x, y), (number >= world.spheres) | near_rim & ~small

    at, straight = barrier(edge_place(*lax.stop_gradient((world, beam, reach, light))))
    edge = _bound(world, beam, at, hit, number, light, needs)
    curved = disc_region(edge.q, edge.axis, edge.radius).edge
    return where(straight, half_plane_of(edge.f), curved)


def _where_zero(
    world: SceneTables,
    beam: Differential[Ray],
    reach: PixelArray,
    place: tuple[PixelArray, PixelArray],
    hit: Hit,
    f: Differential[PixelArray],
) -> tuple[tuple[PixelArray, PixelArray], Mask]:
    """A place in the pixel, from a given one on, where a function of the surface seen is zero.

    Near a rim a surface runs away from the viewer, as the root of the distance to the rim, and
    every line on it comes to the rim as a parabola does. So half the chord of the ray inside the
    sphere is the coordinate in which the function is taken to be linear.

    **Arguments:** `f`: the function, as its derivatives at `place` say, seen from the centre.

    **Returns:** the place, right and down of the centre; and whether the rim is so near that the
    function is far from linear in the pixel.
    """
    x, y = place
    ball = world.ball(hit.id)
    across = lambda ray: perpendicular(ray.origin, ray.direction, ball.center)[1]
    least = 0.3 * mean_chord(across(beam.value), ball.radius, reach)[0]
    least = jnp.where(least > 0, least, 1)
    q = beam.at(x, y).map(lambda ray: across(unit_ray(ray)))
    square = ball.radius * ball.radius - dot(q.value, q.value)
    chord = safe_sqrt(jnp.maximum(square, least * least))

    slope = safe_sqrt(f.dx * f.dx + f.dy * f.dy)
    per_slope = 1 / jnp.where(slope > 0, slope, 1)
    right, down = f.dx * per_slope, f.dy * per_slope
    step = -f.at(x, y).value * per_slope
    # along this line the square of the chord, and the chord itself, grow by so much
    to_right, to_down = dot(q.value, q.dx), dot(q.value, q.dy)
    grows = -2 * (to_right * right + to_down * down)
    on_ball = (hit.id < world.spheres) & (grows != 0)
    steepest = 2 * safe_sqrt(to_right * to_right + to_down * to_down)
    near_rim = (hit.id < world.spheres) & (chord * chord < 2 * steepest)
    new = chord + step * grows / (2 * chord)
    straight = step * (new + chord) / (2 * chord)
    rim = (least * least - chord * chord) / jnp.where(on_ball, grows, 1)
    step = jnp.where(on_ball, jnp.where(new > least, straight, rim), step)
    step = jnp.clip(step, -0.5, 0.5)
    return (x + step * right, y + step * down), near_rim


def _find_occluders(
    world: SceneTables,
    beam: Differential[Ray],
    reach: PixelArray,
    place: tuple[PixelArray, PixelArray],
    hit: Hit,
    light: Vec,
    needs: Needs,
) -> tuple[Mask, tuple[Ids, ...]]:
    """Whether something darkens all of a pixel, and the objects whose shadows' edges cross it."""
    world, beam, light = jax.lax.stop_gradient((world, beam, light))
    point = beam.at(*place).map(lambda ray: surface_at(world, unit_ray(ray), hit, needs).point)
    here = point.value
    to_light = light - here
    shape, far = to_light.x.shape, norm(to_light)
    across, down = (0.5 + jnp.abs(m) for m in place)
    extent = lambda dx, dy: norm(dx) * across + norm(dy) * down
    footprint = extent(point.dx, point.dy)

    def add(state: tuple, i, full: Mask, touched: Mask, center: Mask) -> tuple:
        """**Arguments:** whether object i darkens all of the pixel, any of it, and its centre."""
        blocked, edges = state
        crosses = touched & ~full
        blocked = blocked | full | crosses & (edges[-1] >= 0) & center
        crosses = crosses & (edges[-1] < 0)
        moved = (jnp.full(shape, i, edges[0].dtype), *edges[:-1])
        return blocked, tuple(
            jnp.where(crosses, new, old) for new, old in zip(moved, edges, strict=True)
        )

    def sphere(i, state: tuple) -> tuple:
        ball = table_row(world.balls, i)
        foot = point.map(lambda p: _from_light(p, light, ball.center))
        along, q = foot.value
        reach, inner = extent(foot.dx[1], foot.dy[1]), ball.radius - norm(q)
        from_light, to_center = light - ball.center, ball.center - here
        square = ball.radius * ball.radius
        light_inside = dot(from_light, from_light) < square
        between = (along > 0) & (along < far)
        own = hit.id == i
        if not needs.inside:
            between = (between | light_inside) & ~own
            full = (inner >= reach) & between
            return add(state, i, full, (inner > -reach) & between, inner > 0)
        # a mean point may lie a little inside a sphere that cuts the surface in this pixel
        deep = jnp.maximum(ball.radius - footprint, 0)
        inside = jnp.where(own, hit.inside, dot(to_center, to_center) < deep * deep)
        within = inside | light_inside
        full = jnp.where(within, inside != light_inside, (inner >= reach) & between & ~own)
        touched = jnp.where(within, full, (inner > -reach) & between & ~own)
        return add(state, i, full, touched, inner > 0)

    def plane(i, state: tuple) -> tuple:
        flat = table_row(world.flats, i)
        above = dot(light - flat.point, flat.normal)
        f = point.map(lambda p: dot(p - flat.point, flat.normal))
        inner = jnp.where(above > 0, -f.value, f.value)
        reach = jnp.abs(f.dx) * across + jnp.abs(f.dy) * down
        other = (hit.id != i + world.spheres) & (above != 0)
        full, touched = (inner >= reach) & other, (inner > -reach) & other
        return add(state, i + world.spheres, full & (inner > 0), touched, inner > 0)

    none = jnp.full(shape, -1, world.id_type)
    state = jnp.full(shape, False), (none,) * EDGES
    state = loop(world.spheres, sphere, state, unroll=0)
    return loop(world.planes, plane, state, unroll=0) if needs.planes else state
