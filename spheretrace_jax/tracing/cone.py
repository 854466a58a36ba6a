"""Ray cones: how wide a pixel is along its ray (Amanatides, "Ray Tracing with Cones", 1984)."""

import equinox as eqx
import jax.numpy as jnp

from ..base.types import Mask, PixelArray
from ..base.vec import dot
from ..scene.camera import Camera, Ray, view_frame
from .hit import Surface

# Half a pixel's diagonal, 0.71 pixels, and a little more, since shading near a rim is averaged too.
# Smaller numbers miss edges in the corners of pixels; larger ones send more pixels to compositing.
_PIXEL_RADIUS = 0.75

#: The least N.V: the footprint of a pixel on a surface is stretched by no more than its inverse.
LEAST_COS_VIEW = 1e-3


class RayCone(eqx.Module):
    """The width of a pixel along its ray: a radius where the ray starts, and its growth."""

    radius: PixelArray  #: world units
    spread: PixelArray  #: growth of the radius per unit length

    def radius_at(self, t: PixelArray) -> PixelArray:
        """Returns the radius at a distance along the ray, world units."""
        return self.radius + self.spread * jnp.maximum(t, 0)


def pixel_cones(camera: Camera, ray: Ray, pixel_side: PixelArray) -> RayCone:
    """Returns the cones around the rays of pixels; cylinders for an orthographic camera.

    **Arguments:** `pixel_side`: the height of a pixel on the view plane, world units.
    """
    if camera.pixel_aspect is not None:
        pixel_side = pixel_side * jnp.maximum(camera.pixel_aspect, 1)
    if camera.orthographic:
        radius = jnp.full_like(ray.direction.x, _PIXEL_RADIUS * pixel_side)
        return RayCone(radius, jnp.zeros_like(radius))
    straight = dot(ray.direction, view_frame(camera).forward)
    spread = _PIXEL_RADIUS * pixel_side / camera.distance * straight
    return RayCone(jnp.zeros_like(spread), spread)


def next_cone(
    cone: RayCone, ray: Ray, surface: Surface, curvature: PixelArray, mirrored: Mask
) -> RayCone:
    """Returns the cone after a hit: a curved mirror spreads the cone.

    **Arguments:** `curvature`: 1/R of the surface, 0 for a plane. `mirrored`: false where the ray
    goes straight on.
    """
    width = cone.radius_at(dot(surface.point - ray.origin, ray.direction))
    bend = 2 * width * curvature / jnp.maximum(surface.cos_view, LEAST_COS_VIEW)
    return RayCone(width, cone.spread + jnp.where(mirrored, bend, 0))
