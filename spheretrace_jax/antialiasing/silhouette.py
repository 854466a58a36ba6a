"""Silhouettes: the part of a pixel inside an object's outline or horizon, and surface crossings."""

import equinox as eqx
import jax.numpy as jnp

from ..base.safe_math import safe_sqrt
from ..base.types import PixelArray
from ..base.vec import Vec, dot, where
from ..scene.camera import Ray
from ..tracing.context import TraceContext
from ..tracing.differential import Differential
from ..tracing.hit import Hit, Surface
from ..tracing.surface import mean_surface_at
from .coverage import Region, disc_region, half_plane_region
from .polygon import HalfPlane, half_plane_of, whole_pixel


class SilhouetteDistance(eqx.Module):
    """The distance from a ray to the silhouette of the object that it hits, or just misses."""

    q: Differential[Vec]  #: from the ray to the sphere's centre, at a right angle to the ray
    slope: Differential[PixelArray] | None  #: D.N, positive toward the plane; None without planes
    extent: PixelArray  #: how far |q|, for planes D.N, varies from the pixel's centre to its border


class SurfaceCrossing(eqx.Module):
    """The part of a pixel in which a surface lies before the one behind it."""

    region: Region  #: inside the silhouette of the one behind
    ahead: HalfPlane


def silhouette_distance(
    context: TraceContext, ray: Differential[Ray], hit: Hit
) -> SilhouetteDistance:
    """Returns the distance from rays to the silhouettes of the objects at their hits."""
    sphere = context.sphere(hit.id)
    q = ray.map(lambda ray: sphere.perpendicular(ray)[1])
    extent = safe_sqrt((dot(q.dx, q.dx) + dot(q.dy, q.dy)) / 8)
    if not context.needs.planes:
        return SilhouetteDistance(q, None, extent)
    slope, level = context.plane(hit.id).horizon(ray)
    is_plane = context.tables.is_plane(hit.id)
    return SilhouetteDistance(q, slope, jnp.where(is_plane, level, extent))


def silhouette_region(
    context: TraceContext, ray: Ray, hit: Hit, distance: SilhouetteDistance
) -> Region:
    """Returns the part of a pixel inside an object's silhouette; all of it, if there is none."""
    sphere = context.sphere(hit.id)
    radius = jnp.where(sphere.radius > 0, sphere.radius, 1)
    inside = disc_region(distance.q, ray.direction, radius)
    all_ = Region(jnp.ones_like(radius), whole_pixel(radius))
    region = where(context.tables.is_sphere(hit.id) & ~hit.inside, inside, all_)
    if distance.slope is None:
        return region
    return where(context.tables.is_plane(hit.id), half_plane_region(distance.slope), region)


def mean_surface(
    context: TraceContext, ray: Differential[Ray], hit: Hit, distance: SilhouetteDistance
) -> Differential[Surface]:
    """Returns the mean surface of the part of a pixel inside an object's silhouette."""
    return ray.paired_with(distance.q).map(
        lambda both: mean_surface_at(context, both[0], both[1], hit, distance.extent)
    )


def surface_crossing(
    context: TraceContext, ray: Differential[Ray], surface: Differential[Surface], behind: Hit
) -> SurfaceCrossing:
    """Returns where a surface and the one behind it may cut one another."""
    distance = silhouette_distance(context, ray, behind)
    other = mean_surface(context, ray, behind, distance)

    def depth_between(three: tuple[Ray, tuple[Surface, Surface]]) -> PixelArray:
        ray, (near, far) = three
        return dot(far.point - near.point, ray.direction)

    f = half_plane_of(ray.paired_with(surface.paired_with(other)).map(depth_between))
    ahead = where(behind.id >= 0, f, whole_pixel(distance.extent))
    return SurfaceCrossing(silhouette_region(context, ray.value, behind, distance), ahead)
