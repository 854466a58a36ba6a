"""The lecture's view transform: an eye on a sphere around the origin, rays through the window."""

import equinox as eqx
import jax.numpy as jnp

from ..base.safe_math import to_order_one
from ..base.types import PixelArray
from ..base.vec import Vec, unit
from .scene import Camera


class Ray(eqx.Module):
    """Rays `origin + t * direction`, t > 0, `direction` of unit length."""

    origin: Vec
    direction: Vec


class Frame(eqx.Module):
    """The camera's axes: unit vectors of scalars, and where the eye is."""

    eye: Vec
    right: Vec
    up: Vec
    forward: Vec


def view_frame(camera: Camera) -> Frame:
    """Where the eye is and which way is right, up and forward.

    The eye is at polar angle phi and azimuth theta on the sphere of radius mu around the origin
    and looks at the origin; the axes come from the angles alone, so mu = 0 is no special case.

    **Returns:** orthonormal `right`, `up`, `forward` and `eye`, world coordinates.
    """
    st, ct = jnp.sin(camera.theta), jnp.cos(camera.theta)
    sp, cp = jnp.sin(camera.phi), jnp.cos(camera.phi)
    forward = Vec(-sp * ct, -sp * st, -cp)
    return Frame(
        eye=forward * -camera.mu,
        right=Vec(-st, ct, jnp.zeros_like(st)),
        up=Vec(-ct * cp, -st * cp, sp),
        forward=forward,
    )


def pixel_rays(camera: Camera, columns: PixelArray, rows: PixelArray, size: tuple[int, int]) -> Ray:
    """The rays through points of the window.

    Column i and row j of a picture `height` pixels high have their centre at
    x = (i + 1/2 - width/2) pitch along right, y = -(j + 1/2 - height/2) pitch along up, with
    pitch = window/height, on the view plane `distance` before the eye. Row 0 is the top.

    **Arguments:** `columns`, `rows`: positions in pixels from the picture's left and top edge
    (pixel i's centre is at i + 1/2), of shapes that broadcast: `(1, width)` and `(rows, 1)` for a
    whole picture. `size`: the picture's (width, height) in pixels.

    **Returns:** rays from the eye, with a direction for each position.
    """
    return unit_ray(unnormalized_rays(camera, columns, rows, size))


def unit_ray(ray: Ray) -> Ray:
    """The ray with a direction of unit length."""
    return Ray(ray.origin, unit(ray.direction))


def unnormalized_rays(
    camera: Camera, columns: PixelArray, rows: PixelArray, size: tuple[int, int]
) -> Ray:
    """`pixel_rays` with directions of any length."""
    frame = view_frame(camera)
    # only their ratio matters
    scale = to_order_one(camera.window, camera.distance)
    distance, pitch = camera.distance * scale, camera.window * scale / size[1]
    x = (columns - size[0] / 2) * pitch
    y = (size[1] / 2 - rows) * pitch

    def along(right: PixelArray, up: PixelArray, forward: PixelArray) -> PixelArray:
        return (y * up + distance * forward) + x * right

    towards = Vec(
        along(frame.right.x, frame.up.x, frame.forward.x),
        along(frame.right.y, frame.up.y, frame.forward.y),
        along(frame.right.z, frame.up.z, frame.forward.z),
    )
    return Ray(frame.eye, towards)
