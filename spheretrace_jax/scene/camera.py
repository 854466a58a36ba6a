"""`Camera` and the lecture's view transform: rays from an eye, which looks at the origin."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import ArrayLike

from ..base.safe_math import to_order_one
from ..base.types import PixelArray, Scalar
from ..base.vec import SplitVec, Vec, unit
from .arrays import floats


class Camera(eqx.Module):
    """The lecture's view: the eye on a sphere around the origin, looking at the origin."""

    theta: Scalar  #: azimuth of the eye, radians; differentiable, moves edges
    phi: Scalar  #: polar angle of the eye from +z, radians; differentiable, moves edges
    mu: Scalar  #: distance from the origin to the eye, world units; differentiable, moves edges
    distance: Scalar  #: from eye to view plane, world units; differentiable, moves edges
    window: Scalar  #: height of the window on the view plane, world units; differentiable

    def __init__(
        self,
        theta: ArrayLike = 0.0,
        phi: ArrayLike = 0.0,
        mu: ArrayLike = 500.0,
        distance: ArrayLike = 800.0,
        window: ArrayLike = 512.0,
    ):
        """Builds a camera. **Arguments:** as the fields."""
        self.theta, self.phi, self.mu, self.distance, self.window = floats(
            theta, phi, mu, distance, window
        )


class Ray(eqx.Module):
    """Rays `origin + t * direction`, t > 0, `direction` of unit length."""

    origin: Vec
    direction: Vec


class Frame(eqx.Module):
    """The camera's position and axes: unit vectors of scalars."""

    eye: Vec
    right: Vec
    up: Vec
    forward: Vec


def view_frame(camera: Camera) -> Frame:
    """Computes the eye's position and the axes of the view, in world coordinates.

    The eye is at polar angle phi and azimuth theta on the sphere of radius mu around the origin,
    and looks at the origin. The axes depend on the angles alone, so mu = 0 is no special case.

    **Returns:** the position `eye`, and orthonormal `right`, `up` and `forward`.
    """
    st, ct = jnp.sin(camera.theta), jnp.cos(camera.theta)
    sp, cp = jnp.sin(camera.phi), jnp.cos(camera.phi)
    forward = SplitVec(-sp * ct, -sp * st, -cp)
    return Frame(
        eye=forward * -camera.mu,
        right=SplitVec(-st, ct, jnp.zeros_like(st)),
        up=SplitVec(-ct * cp, -st * cp, sp),
        forward=forward,
    )


def pixel_rays(camera: Camera, columns: PixelArray, rows: PixelArray, size: tuple[int, int]) -> Ray:
    """Returns the rays through points of the window, from the eye.

    Column i and row j of a picture `height` pixels high have their centre at
    x = (i + 1/2 - width/2) pitch along right, y = -(j + 1/2 - height/2) pitch along up, with
    pitch = window/height, on the view plane `distance` before the eye. Row 0 is the top.

    **Arguments:** `columns`, `rows`: positions in pixels from the picture's left and top edge
    (pixel i's centre is at i + 1/2), of shapes that broadcast: `(1, width)` and `(rows, 1)` for a
    whole picture. `size`: the picture's (width, height) in pixels.

    **Returns:** rays with one origin, and a direction of unit length for each position.
    """
    return unit_ray(unnormalized_rays(camera, columns, rows, size))


def unit_ray(ray: Ray) -> Ray:
    """Returns the ray with a direction of unit length."""
    return Ray(ray.origin, unit(ray.direction))


def unnormalized_rays(
    camera: Camera, columns: PixelArray, rows: PixelArray, size: tuple[int, int]
) -> Ray:
    """Returns the rays of `pixel_rays`, with directions of any length."""
    frame = view_frame(camera)
    # only the ratio of window and distance matters
    scale = to_order_one(camera.window, camera.distance)
    distance, pitch = camera.distance * scale, camera.window * scale / size[1]
    x = (columns - size[0] / 2) * pitch
    y = (size[1] / 2 - rows) * pitch

    def along(right: PixelArray, up: PixelArray, forward: PixelArray) -> PixelArray:
        return (y * up + distance * forward) + x * right

    towards = SplitVec(
        along(frame.right.x, frame.up.x, frame.forward.x),
        along(frame.right.y, frame.up.y, frame.forward.y),
        along(frame.right.z, frame.up.z, frame.forward.z),
    )
    return Ray(frame.eye, towards)
