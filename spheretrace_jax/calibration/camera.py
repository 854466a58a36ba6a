"""`Intrinsics`: a camera as photographs have it, and the frames of its vectors."""

import math

import equinox as eqx
import numpy as np
from jaxtyping import Float, Shaped

from ..base.errors import InputError

Number = float | int


class Intrinsics(eqx.Module):
    """Intrinsic parameters of a pinhole camera with square pixels, or an orthographic one.

    The camera's frame is OpenCV's: x right, y down, z forward. A point (X, Y, Z) is seen at
    (cx + focal X/Z, cy + focal Y/Z) in pixels from the left and top edge: pixel i has its centre
    at i + 1/2. OpenCV counts from the centre of the first pixel, so its cx is ours less 1/2.
    """

    focal: float  #: focal length in pixels; infinite for an orthographic camera
    cx: float  #: principal point in pixels, from the left edge
    cy: float  #: principal point in pixels, from the top edge

    def __init__(self, focal: Number = math.inf, cx: Number = 0.0, cy: Number = 0.0):
        """Builds a camera. **Arguments:** as the fields.

        **Raises:** `InputError` if `focal` is not positive, or the principal point not finite.
        """
        self.focal, self.cx, self.cy = float(focal), float(cx), float(cy)
        if not self.focal > 0:
            raise InputError(f"focal: expected a positive length in pixels, got {focal}")
        if not (math.isfinite(self.cx) and math.isfinite(self.cy)):
            raise InputError(f"principal_point: expected two finite numbers, got {cx}, {cy}")

    @property
    def orthographic(self) -> bool:
        """Tells whether all rays are parallel to the axis."""
        return math.isinf(self.focal)

    @property
    def bend(self) -> float:
        """1 / focal^2: what tells a perspective from an orthographic picture (0)."""
        return self.focal**-2

    @property
    def principal_point(self) -> Float[np.ndarray, "2"]:
        """The principal point (cx, cy) in pixels."""
        return np.array([self.cx, self.cy])


def intrinsics_of(
    size: tuple[int, int],
    focal: Number = math.inf,
    principal_point: tuple[Number, Number] | None = None,
) -> Intrinsics:
    """Returns the camera of a picture.

    **Arguments:** `size`: (height, width) of the picture in pixels. `focal`: focal length in
    pixels, infinite for an orthographic camera. `principal_point`: (cx, cy) in pixels; by default
    the middle of the picture.

    **Raises:** `InputError` for numbers that describe no camera.
    """
    cx, cy = (size[1] / 2, size[0] / 2) if principal_point is None else principal_point
    return Intrinsics(focal, cx, cy)


def flip_frame(vectors: Shaped[np.ndarray, "*n 3"]) -> Shaped[np.ndarray, "*n 3"]:
    """Changes between the camera's frame and the frame of photometric stereo, either way.

    The camera's frame (OpenCV): x right, y down, z forward. Photometric stereo: x right, y up,
    z toward the viewer. The change negates y and z, so it is its own inverse.
    """
    return vectors * np.array([1.0, -1.0, -1.0])
