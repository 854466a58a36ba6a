"""Where rays meet spheres and planes."""

import jax.numpy as jnp

from ..base.types import PixelArray
from ..base.vec import Vec, dot


def perpendicular(origin: Vec, direction: Vec, center: Vec) -> tuple[PixelArray, Vec]:
    """How far along the ray it passes a point, and the vector from there to the point.

    **Arguments:** `origin`, `direction`: rays, `direction` of unit length. `center`: the point.

    **Returns:** `along`, the distance from the origin to the foot of the perpendicular, negative
    behind the origin; `q`, from the foot to `center`. World units.
    """
    oc = center - origin
    along = dot(oc, direction)
    return along, oc - direction * along


def ray_sphere(
    origin: Vec, direction: Vec, center: Vec, radius: PixelArray
) -> tuple[PixelArray, PixelArray]:
    """Where rays meet one sphere.

    The lecture solves A t^2 + B t + C = 0 with A = d.d, B = 2 d.(o - c), C = |o - c|^2 - R^2
    (slides "Computing Coefficients", "Solving the Equation"): two roots where the discriminant
    B^2 - 4AC is positive, one where it is 0 (the ray is tangent), none where it is negative. In
    float32 B^2 - 4AC cancels for small or distant spheres, so a quarter of it is taken as
    R^2 - q.q, from the perpendicular q from the ray to the centre (Haines, Guenther,
    Akenine-Moeller, "Precision Improvements for Ray/Sphere Intersection", Ray Tracing Gems, 2019,
    ch. 7).

    **Arguments:** `origin`, `direction`: rays, planes of shape `(*pixels,)`, world units;
    `direction` of unit length. `center`, `radius`: the sphere, world units, radius > 0.

    **Returns:** the near and the far `t` along the ray, world units: equal where the ray is
    tangent, `nan` where it misses, near negative and far positive where the ray starts inside.
    """
    along, q = perpendicular(origin, direction, center)
    half_chord = jnp.sqrt(radius * radius - dot(q, q))  # nan = miss: no comparison with it holds
    return along - half_chord, along + half_chord


def ray_plane(origin: Vec, direction: Vec, point: Vec, normal: Vec) -> PixelArray:
    """The `t` at which rays meet a plane, world units: negative behind, 0 where they run along it.

    **Arguments:** `origin`, `direction`: rays, planes of shape `(*pixels,)`, `direction` of unit
    length. `point`, `normal`: any point of the plane and its normal, of any length but 0.
    """
    slope = dot(direction, normal)
    crosses = slope != 0
    return jnp.where(crosses, dot(point - origin, normal) / jnp.where(crosses, slope, 1), 0)
