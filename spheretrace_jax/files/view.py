"""Cameras of other programs: from an eye, a target and axes to the numbers of `Camera`."""

from typing import Any

import numpy as np
from jaxtyping import Float

from ..scene.camera import Camera

Vector = Float[np.ndarray, " 3"]

# Within this many rounding errors of a special case (straight down, no roll, the origin) it is one.
_ROUNDING = 64 * float(np.finfo(np.float64).eps)


def unit_vector(v: Vector) -> Vector:
    """Returns a vector of any length above 0 with length 1, without overflow."""
    v = v / np.abs(v).max()
    return v / np.linalg.norm(v)


def camera_of(
    eye: Vector,
    target: Vector,
    right: Vector,
    forward: Vector,
    dtype: Any,
    *,
    distance: float | None = None,
    window: float = 1.0,
    **others: Any,
) -> Camera:
    """Builds the camera whose eye looks at a target.

    **Arguments:** `right`, `forward`: orthogonal axes of length 1; `target` is on the axis through
    `eye` along `forward`. `distance`, by default that of the target, `window`, `others`: as the
    fields of `Camera`.

    **Returns:** a camera of `dtype`, where `look_at` and `roll` are None if they are 0.
    """
    x, y, z = -forward
    mu, across = float((target - eye) @ forward), float(np.hypot(x, y))
    pole = across <= _ROUNDING
    # straight up or down theta has all of the turn
    theta = float(np.arctan2(-right[0], right[1]) if pole else np.arctan2(y, x))
    phi = float(np.arctan2(0.0 if pole else across, z))
    level = np.array([-np.sin(theta), np.cos(theta), 0])
    upright = np.array([*(-np.cos(phi) * np.array([np.cos(theta), np.sin(theta)])), np.sin(phi)])
    roll = float(np.arctan2(-right @ upright, right @ level))
    size = max(float(np.abs(eye).max()), mu)
    optional = {
        "roll": None if abs(roll) <= _ROUNDING else roll,
        "look_at": None if np.abs(target).max() <= _ROUNDING * size else target,
        **others,
    }
    number = lambda x: np.asarray(x, dtype)
    given = {name: number(x) for name, x in optional.items() if x is not None and x is not True}
    flags = {name: x for name, x in optional.items() if x is True}
    distance = mu if distance is None else distance
    return Camera(*map(number, (theta, phi, mu, distance, window)), **given, **flags)
