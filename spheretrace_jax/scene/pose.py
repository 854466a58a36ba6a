"""Poses: the axes of a view from its angles, and the angles from OpenCV's rotation."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.errors import InputError
from ..base.safe_math import larger, safe_sqrt
from ..base.types import Scalar
from ..base.vec import SplitVec, Vec, components, dot, vec
from .arrays import is_traced

# A view within this many rounding errors of straight up or down has no azimuth of its own.
_POLE = 4

# How far R R^T of a rotation may be from 1: R is often printed with four digits.
_LEAST_ORTHONORMAL = 1e-3


class Orbit(NamedTuple):
    """The angles, the distance and the centre of a view; see the fields of `Camera`."""

    theta: Scalar
    phi: Scalar
    roll: Scalar
    mu: Scalar
    look_at: Float[Array, " 3"]


def view_axes(theta: Scalar, phi: Scalar, roll: Scalar | None) -> tuple[Vec, Vec, Vec]:
    """Returns the axes right, up and forward of a view, in world coordinates.

    **Arguments:** `roll`: None for 0, without the operations of a turn.
    """
    st, ct = jnp.sin(theta), jnp.cos(theta)
    sp, cp = jnp.sin(phi), jnp.cos(phi)
    forward = SplitVec(-sp * ct, -sp * st, -cp)
    right = SplitVec(-st, ct, jnp.zeros_like(st))
    up = SplitVec(-ct * cp, -st * cp, sp)
    if roll is None:
        return right, up, forward
    s, c = jnp.sin(roll), jnp.cos(roll)
    return right * c - up * s, right * s + up * c, forward


def orbit_of(rotation: Float[Array, "3 3"], translation: Float[Array, " 3"]) -> Orbit:
    """Finds the orbit of an eye with OpenCV's pose, X_camera = R X_world + t.

    The rows of R are the camera's right, down and forward. The eye looks at the point of its axis
    that is closest to the world's origin, or, where this point is behind it, at itself (mu = 0).
    Where the eye looks straight up or down, theta is chosen so that roll is 0.

    **Arguments:** `rotation`: R, orthonormal up to rounding, of determinant 1.
    """
    right, forward = vec(rotation[0]), vec(rotation[2])
    across = safe_sqrt(forward.x * forward.x + forward.y * forward.y)
    pole = across <= _POLE * float(jnp.finfo(across.dtype).eps)
    theta = jnp.arctan2(jnp.where(pole, -right.x, -forward.y), jnp.where(pole, right.y, -forward.x))
    phi = jnp.arctan2(across, -forward.z)
    level, upright, _ = view_axes(theta, phi, None)
    roll = jnp.arctan2(-dot(right, upright), dot(right, level))
    right, up, forward = view_axes(theta, phi, roll)
    eye = up * translation[1] - right * translation[0] - forward * translation[2]
    mu = larger(-dot(eye, forward), 0)
    return Orbit(theta, phi, roll, mu, jnp.stack(components(eye + forward * mu)))


def check_pose(R: Array, t: Array) -> None:
    """Checks OpenCV's pose. **Raises:** `InputError`."""
    if R.shape != (3, 3) or t.shape != (3,):
        raise InputError(
            f"rotation and translation must be of shapes (3, 3) and (3,), got {R.shape} and "
            f"{t.shape}"
        )
    if is_traced(R):
        return
    matrix = np.asarray(R, np.float64)
    if not np.abs(matrix @ matrix.T - np.eye(3)).max() < _LEAST_ORTHONORMAL:
        raise InputError("rotation must be orthonormal: R R^T must be 1")
    if np.linalg.det(matrix) < 0:
        raise InputError("rotation must not mirror the world: its determinant must be 1, got -1")
