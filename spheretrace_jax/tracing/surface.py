"""Surfaces at hits: the smooth half of what a ray meets, and its mean over a pixel."""

from ..base.types import PixelArray
from ..base.vec import Vec, where
from ..scene.camera import Ray
from .context import TraceContext
from .hit import Hit, Surface
from .shapes.sphere import Sphere


def surface_at(context: TraceContext, ray: Ray, hit: Hit) -> Surface:
    """Returns the point and normal at which rays meet the objects they are known to hit.

    Where a ray hits nothing the numbers are finite but mean nothing.
    """
    sphere = context.sphere(hit.id)
    _, q = sphere.perpendicular(ray)
    return _surface(context, ray, hit, sphere, q, sphere.half_chord(q), None)


def mean_surface_at(
    context: TraceContext, ray: Ray, q: Vec, hit: Hit, extent: PixelArray
) -> Surface:
    """Returns the mean surface of the part of a pixel that an object covers.

    Its normal is the mean of the normals, as Lambert's term, being linear, needs it: of unit length
    unless the sphere is as small as the pixel. Rays that just miss the object have one, too.

    **Arguments:** `q`: the perpendicular from the ray to the sphere's centre. `extent`: how far
    |q|, or for planes D.N, varies from the pixel's centre to its border.
    """
    sphere = context.sphere(hit.id)
    half_chord, q = sphere.mean_chord(q, extent)
    return _surface(context, ray, hit, sphere, q, half_chord, extent)


def _surface(
    context: TraceContext,
    ray: Ray,
    hit: Hit,
    sphere: Sphere,
    q: Vec,
    half_chord: PixelArray,
    extent: PixelArray | None,
) -> Surface:
    inside = hit.inside if context.needs.inside else None
    on_sphere = sphere.surface(ray, q, half_chord, inside, context.curvature(hit.id))
    if not context.needs.planes:
        return on_sphere
    is_plane = context.tables.is_plane(hit.id)
    return where(is_plane, context.plane(hit.id).surface(ray, extent, is_plane), on_sphere)
