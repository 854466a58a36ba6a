"""Where in a pixel an object is seen: its silhouette or horizon, and lines where surfaces meet."""

import equinox as eqx
import jax.numpy as jnp

from ._types import Plane
from .camera import Ray
from .coverage import Region, disc_region, half_plane_region
from .halfplane import HalfPlane, everything, positive
from .intersect import perpendicular
from .needs import Needs
from .varying import Varying
from .vec import dot, safe_sqrt, where
from .world import Hit, World, surface_at


class Outline(eqx.Module):
    """The part of a pixel inside an object's silhouette."""

    region: Region
    reach: Plane  #: how far its edge function varies (`world.surface_at`)


class Crossing(eqx.Module):
    """Where in a pixel a surface lies before the one behind it."""

    region: Region  #: inside the silhouette of the one behind
    ahead: HalfPlane


def outline_of(world: World, beam: Varying[Ray], hit: Hit, needs: Needs) -> Outline:
    """What of a pixel is inside an object's silhouette; all of it, if there is none."""
    ball = world.ball(hit.id)
    is_ball = (hit.id >= 0) & (hit.id < world.spheres)
    q = beam.map(lambda ray: perpendicular(ray.origin, ray.direction, ball.center)[1])
    radius = jnp.where(ball.radius > 0, ball.radius, 1)
    inside = disc_region(q, beam.value.direction, radius)
    whole = Region(jnp.ones_like(radius), everything(radius))
    outline = where(is_ball & ~hit.inside, inside, whole)
    reach = safe_sqrt((dot(q.dx, q.dx) + dot(q.dy, q.dy)) / 8)
    if needs.planes:
        flat = world.flat(hit.id)
        away = dot(flat.point - beam.value.origin, flat.normal)
        side = jnp.where(away < 0, -1, 1).astype(away.dtype)
        slope = beam.map(lambda ray: dot(ray.direction, flat.normal) * side)
        level = half_plane_region(slope)
        level_reach = safe_sqrt(slope.dx * slope.dx + slope.dy * slope.dy) / 2
        is_plane = hit.id >= world.spheres
        outline, reach = where(is_plane, (level, level_reach), (outline, reach))
    return Outline(outline, reach)


def crossing(
    world: World, beam: Varying[Ray], hit: Hit, reach: Plane, behind: Hit, needs: Needs
) -> Crossing:
    """How a surface and the one behind it may cut one another. **Arguments:** `reach`: of `hit`."""
    other = outline_of(world, beam, behind, needs)

    def further(ray: Ray) -> Plane:
        depth = lambda hit, reach: dot(
            surface_at(world, ray, hit, needs, reach).point - ray.origin, ray.direction
        )
        return depth(behind, other.reach) - depth(hit, reach)

    some, f = behind.id >= 0, positive(beam.map(further))
    return Crossing(other.region, where(some, f, everything(reach)))
