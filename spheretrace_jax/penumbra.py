"""How much of a pixel a light reaches: shadow edges, covered by area.

The lecture's lights are points, so shadows are sharp; only a pixel can be partly in shadow.
"""

import jax
import jax.numpy as jnp

from ._types import Ids, Mask, Plane
from .coverage import Region, disc_region, half_plane_region, share
from .intersect import perpendicular
from .needs import Needs
from .phases import fetch, over
from .varying import Varying
from .vec import Vec, dot, norm, unit
from .visibility import row
from .world import Hit, World

#: Shadow edges of one light in one pixel and layer; of further ones the centre decides.
EDGES = 2


def unoccluded_part(world: World, point: Varying[Vec], hit: Hit, light: Vec, needs: Needs) -> Plane:
    """The part of a pixel, seen on a surface, that a light reaches: 0 in shadow, 1 in light.

    Says the same as `visibility.unoccluded` where no edge runs through the pixel.

    **Arguments:** `point`: the surface's point, with `hit` the objects it lies on.
    """
    blocked, edges = _occluders(world, point, hit, light, needs)
    one, other = (_shadow(world, point, number, light, needs) for number in edges)
    return jnp.where(blocked, 0, (1 - one.part) * (1 - share(one, other)))


def _from_light(point: Vec, light: Vec, center: Vec) -> tuple[Plane, Vec]:
    """Where the way from a point to the light passes a centre, as `perpendicular` says."""
    return perpendicular(point, unit(light - point), center)


def _shadow(world: World, point: Varying[Vec], number: Ids, light: Vec, needs: Needs) -> Region:
    """The part of the pixel in the shadow of one object, 0 where there is none."""
    ball = fetch(world.balls, number)
    q = point.map(lambda p: _from_light(p, light, ball.center)[1])
    radius = jnp.where(ball.radius > 0, ball.radius, 1)
    dark = disc_region(q, unit(light - point.value), radius)
    if needs.planes:
        flat = fetch(world.flats, number - world.spheres)
        side = jnp.where(dot(light - flat.point, flat.normal) > 0, -1, 1).astype(radius.dtype)
        f = point.map(lambda p: dot(p - flat.point, flat.normal) * side)
        is_plane = number >= world.spheres
        pick = lambda a, b: jnp.where(is_plane, a, b)
        dark = jax.tree.map(pick, half_plane_region(f), dark)
    return Region(jnp.where(number >= 0, dark.part, 0), dark.right, dark.down)


def _occluders(
    world: World, point: Varying[Vec], hit: Hit, light: Vec, needs: Needs
) -> tuple[Mask, tuple[Ids, ...]]:
    """Whether something darkens all of a pixel, and the objects whose shadows' edges cross it."""
    world, point, hit, light = jax.lax.stop_gradient((world, point, hit, light))
    here = point.value
    to_light = light - here
    shape, far = to_light.x.shape, norm(to_light)
    footprint = (norm(point.dx) + norm(point.dy)) / 2

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
        ball = row(world.balls, i)
        foot = point.map(lambda p: _from_light(p, light, ball.center))
        along, q = foot.value
        reach, inner = (norm(foot.dx[1]) + norm(foot.dy[1])) / 2, ball.radius - norm(q)
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
        flat = row(world.flats, i)
        above = dot(light - flat.point, flat.normal)
        f = point.map(lambda p: dot(p - flat.point, flat.normal))
        inner = jnp.where(above > 0, -f.value, f.value)
        reach = (jnp.abs(f.dx) + jnp.abs(f.dy)) / 2
        other = (hit.id != i + world.spheres) & (above != 0)
        full, touched = (inner >= reach) & other, (inner > -reach) & other
        return add(state, i + world.spheres, full & (inner > 0), touched, inner > 0)

    none = jnp.full(shape, -1, world.id_type)
    state = jnp.full(shape, False), (none,) * EDGES
    state = over(world.spheres, sphere, state, unroll=0)
    return over(world.planes, plane, state, unroll=0) if needs.planes else state
