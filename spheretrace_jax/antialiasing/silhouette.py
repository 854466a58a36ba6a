"""Where in a pixel an object is seen: its silhouette or horizon, and lines where surfaces meet."""

import equinox as eqx
import jax.numpy as jnp

from ..base.safe_math import safe_sqrt
from ..base.types import PixelArray
from ..base.vec import Vec, dot, where
from ..scene.camera import Ray
from ..scene.needs import Needs
from ..tracing.intersect import perpendicular
from ..tracing.tables import Hit, SceneTables, Surface, mean_surface_at
from .coverage import Region, disc_region, half_plane_region
from .differential import Differential
from .polygon import HalfPlane, half_plane_of, whole_pixel


class SilhouetteDistance(eqx.Module):
    """How a beam passes the edges of objects."""

    q: Differential[Vec]  #: from the ray to the sphere's centre, at a right angle to the ray
    slope: (
        Differential[PixelArray] | None
    )  #: D.N, positive toward the plane; None if there are no planes
    reach: PixelArray  #: how far |q|, for planes D.N, varies from the pixel's centre to its border


class SurfaceCrossing(eqx.Module):
    """Where in a pixel a surface lies before the one behind it."""

    region: Region  #: inside the silhouette of the one behind
    ahead: HalfPlane


def silhouette_distance(
    world: SceneTables, beam: Differential[Ray], hit: Hit, needs: Needs
) -> SilhouetteDistance:
    """How a beam passes the edge of the object that it hits, or just misses."""
    center = world.ball(hit.id).center
    q = beam.map(lambda ray: perpendicular(ray.origin, ray.direction, center)[1])
    reach = safe_sqrt((dot(q.dx, q.dx) + dot(q.dy, q.dy)) / 8)
    if not needs.planes:
        return SilhouetteDistance(q, None, reach)
    flat = world.flat(hit.id)
    away = dot(flat.point - beam.value.origin, flat.normal)
    side = jnp.where(away < 0, -1, 1).astype(away.dtype)
    slope = beam.map(lambda ray: dot(ray.direction, flat.normal) * side)
    level = safe_sqrt(slope.dx * slope.dx + slope.dy * slope.dy) / 2
    return SilhouetteDistance(q, slope, jnp.where(hit.id >= world.spheres, level, reach))


def silhouette_region(
    world: SceneTables, beam: Differential[Ray], hit: Hit, rim: SilhouetteDistance
) -> Region:
    """What of a pixel is inside an object's silhouette; all of it, if there is none."""
    ball = world.ball(hit.id)
    is_ball = (hit.id >= 0) & (hit.id < world.spheres)
    radius = jnp.where(ball.radius > 0, ball.radius, 1)
    inside = disc_region(rim.q, beam.value.direction, radius)
    whole = Region(jnp.ones_like(radius), whole_pixel(radius))
    outline = where(is_ball & ~hit.inside, inside, whole)
    if rim.slope is None:
        return outline
    return where(hit.id >= world.spheres, half_plane_region(rim.slope), outline)


def mean_surface(
    world: SceneTables, beam: Differential[Ray], hit: Hit, rim: SilhouetteDistance, needs: Needs
) -> Differential[Surface]:
    """The mean surface of the part of a pixel inside an object's silhouette."""
    return beam.beside(rim.q).map(
        lambda both: mean_surface_at(world, both[0], both[1], hit, needs, rim.reach)
    )


def surface_crossing(
    world: SceneTables,
    beam: Differential[Ray],
    surface: Differential[Surface],
    behind: Hit,
    needs: Needs,
) -> SurfaceCrossing:
    """How a surface and the one behind it may cut one another."""
    rim = silhouette_distance(world, beam, behind, needs)
    other = mean_surface(world, beam, behind, rim, needs)

    def further(three: tuple[Ray, tuple[Surface, Surface]]) -> PixelArray:
        ray, (near, far) = three
        return dot(far.point - near.point, ray.direction)

    f = half_plane_of(beam.beside(surface.beside(other)).map(further))
    ahead = where(behind.id >= 0, f, whole_pixel(rim.reach))
    return SurfaceCrossing(silhouette_region(world, beam, behind, rim), ahead)
