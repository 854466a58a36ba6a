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
from .vec import Vec, dot, safe_sqrt, where
from .world import Hit, Surface, World, mean_surface_at


class Rim(eqx.Module):
    """How a beam passes the edges of objects."""

    q: Varying[Vec]  #: from the ray to the sphere's centre, at a right angle to the ray
    slope: Varying[Plane] | None  #: D.N, positive toward the plane; None if there are no planes
    reach: Plane  #: how far |q|, for planes D.N, varies from the pixel's centre to its border


class Crossing(eqx.Module):
    """Where in a pixel a surface lies before the one behind it."""

    region: Region  #: inside the silhouette of the one behind
    ahead: HalfPlane


def rim_of(world: World, beam: Varying[Ray], hit: Hit, needs: Needs) -> Rim:
    """How a beam passes the edge of the object that it hits, or just misses."""
    center = world.ball(hit.id).center
    q = beam.map(lambda ray: perpendicular(ray.origin, ray.direction, center)[1])
    reach = safe_sqrt((dot(q.dx, q.dx) + dot(q.dy, q.dy)) / 8)
    if not needs.planes:
        return Rim(q, None, reach)
    flat = world.flat(hit.id)
    away = dot(flat.point - beam.value.origin, flat.normal)
    side = jnp.where(away < 0, -1, 1).astype(away.dtype)
    slope = beam.map(lambda ray: dot(ray.direction, flat.normal) * side)
    level = safe_sqrt(slope.dx * slope.dx + slope.dy * slope.dy) / 2
    return Rim(q, slope, jnp.where(hit.id >= world.spheres, level, reach))


def outline_of(world: World, beam: Varying[Ray], hit: Hit, rim: Rim) -> Region:
    """What of a pixel is inside an object's silhouette; all of it, if there is none."""
    ball = world.ball(hit.id)
    is_ball = (hit.id >= 0) & (hit.id < world.spheres)
    radius = jnp.where(ball.radius > 0, ball.radius, 1)
    inside = disc_region(rim.q, beam.value.direction, radius)
    whole = Region(jnp.ones_like(radius), everything(radius))
    outline = where(is_ball & ~hit.inside, inside, whole)
    if rim.slope is None:
        return outline
    return where(hit.id >= world.spheres, half_plane_region(rim.slope), outline)


def mean_surface(
    world: World, beam: Varying[Ray], hit: Hit, rim: Rim, needs: Needs
) -> Varying[Surface]:
    """The mean surface of the part of a pixel inside an object's silhouette."""
    return beam.beside(rim.q).map(
        lambda both: mean_surface_at(world, both[0], both[1], hit, needs, rim.reach)
    )


def crossing(
    world: World,
    beam: Varying[Ray],
    surface: Varying[Surface],
    behind: Hit,
    needs: Needs,
) -> Crossing:
    """How a surface and the one behind it may cut one another."""
    rim = rim_of(world, beam, behind, needs)
    other = mean_surface(world, beam, behind, rim, needs)

    def further(three: tuple[Ray, tuple[Surface, Surface]]) -> Plane:
        ray, (near, far) = three
        return dot(far.point - near.point, ray.direction)

    f = positive(beam.beside(surface.beside(other)).map(further))
    ahead = where(behind.id >= 0, f, everything(rim.reach))
    return Crossing(outline_of(world, beam, behind, rim), ahead)
