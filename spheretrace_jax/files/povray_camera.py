"""Cameras of POV-Ray, read: from location, axes and angle to those of `Camera`."""

from dataclasses import dataclass
from math import radians, tan
from typing import Any

import numpy as np

from ..scene.camera import Camera
from .povray_tokens import PovrayTokens
from .tokens import Token
from .view import camera_of, unit_vector

_WORDS = (
    "perspective", "orthographic", "location", "right", "up", "direction", "sky", "look_at",
    "angle",
)  # fmt: skip
_ROUNDING = 1e-12  # how far axes may be from orthogonal, offsets and ratios from none


@dataclass
class PovrayCamera:
    """A camera as POV-Ray has it, by default POV-Ray's."""

    token: Token
    location: np.ndarray
    right: np.ndarray
    up: np.ndarray
    direction: np.ndarray
    orthographic: bool = False
    fixed_aspect: bool = False  #: whether `right` holds a picture's width / height as a number
    wide_angle: bool = False  #: whether an angle is that of a picture's width

    @property
    def mirrored(self) -> bool:
        """Tells whether the axes are left-handed, as POV-Ray's own are."""
        return bool(np.cross(self.right, self.up) @ self.direction > 0)


def read_camera(tokens: PovrayTokens, start: Token) -> PovrayCamera:
    """Reads a camera's block. **Raises:** `SceneError`."""
    opened = tokens.expect("{")
    given: dict[str, Any] = {
        "location": np.zeros(3), "right": np.array([4 / 3, 0, 0]), "up": np.array([0.0, 1, 0]),
        "direction": np.array([0.0, 0, 1]), "sky": np.array([0.0, 1, 0]),
    }  # fmt: skip
    orthographic, angle, look_at, fixed = False, None, None, True
    # the width of a picture is that of its height: pixels are square, or as `right` says
    tokens.names |= {"image_width": 1.0, "image_height": 1.0}
    while tokens.inside(opened):
        word = tokens.take()
        if word.text not in _WORDS:
            tokens.fail_unknown(word, "a camera", (*_WORDS, "}"))
        if word.text in ("perspective", "orthographic"):
            orthographic = word.text == "orthographic"
        elif word.text == "angle":
            angle = tokens.scalar("the angle", 0.0, 180.0)
            if not 0 < angle < 180:
                tokens.fail(tokens.last, "the angle must be between 0 and 180 degrees")
        elif word.text == "look_at":
            look_at = (word, tokens.vector("look_at"))
        else:
            tokens.used.clear()
            given[word.text] = tokens.vector(word.text)
            if word.text == "right":
                fixed = not {"image_width", "image_height"} <= tokens.used
            if word.text != "location" and not given[word.text].any():
                tokens.fail(word, f"{word.text} must not be 0 0 0")
    location, right, up, direction = (given[n] for n in ("location", "right", "up", "direction"))
    sizes = [float(np.linalg.norm(v)) for v in (right, up, direction)]
    if angle is not None:
        # of the width; a picture as wide as high has |right| 1
        direction = unit_vector(direction) * (sizes[0] / 2 / tan(radians(angle) / 2))
        sizes[2] = float(np.linalg.norm(direction))
    if look_at is not None:
        token, target = look_at
        if not (target - location).any():
            tokens.fail(token, "look_at must not be where the location is")
        handed = np.cross(up, direction) @ right > 0
        direction = unit_vector(target - location) * sizes[2]
        across = np.cross(given["sky"], direction)
        if np.linalg.norm(across) < 1e-9 * np.linalg.norm(given["sky"]) * sizes[2]:
            tokens.fail(token, "the camera must not look along its sky")
        right = unit_vector(across if handed else -across) * sizes[0]
        above = np.cross(direction, right)
        up = unit_vector(above if handed else -above) * sizes[1]
    wide = angle is not None and not fixed
    return PovrayCamera(start, location, right, up, direction, orthographic, fixed, wide)


def build_camera(tokens: PovrayTokens, read: PovrayCamera, dtype: Any) -> Camera:
    """Builds the camera of what was read, in a world that its axes do not mirror.

    **Raises:** `SceneError` for axes that no camera here has.
    """
    width, height = float(np.linalg.norm(read.right)), float(np.linalg.norm(read.up))
    right, up = read.right / width, read.up / height
    if abs(right @ up) > 1e-9:
        tokens.fail(read.token, "right and up of the camera must be orthogonal")
    forward = np.cross(up, right)
    distance = float(read.direction @ forward)
    if not distance > 0:
        tokens.fail(read.token, "direction, right and up of the camera must not lie in a plane")
    shift = read.direction - distance * forward
    eye = read.location
    if read.orthographic:
        # rays start at the location; the axis is chosen through it
        shift, distance = np.zeros(3), 1.0
    others: dict[str, Any] = {}
    aspect = 1.0 if read.fixed_aspect else width / height
    offset = np.array([-(shift @ right) / aspect, shift @ up]) / height
    if np.abs(offset).max() > _ROUNDING * max(1, distance / height):
        others["principal_point"] = offset
    if abs(aspect - 1) > _ROUNDING:
        others["pixel_aspect"] = aspect
    if read.orthographic:
        others["orthographic"] = True
    # the point of the axis closest to the origin, unless it is behind the eye
    mu = max(-float(eye @ forward), 0.0)
    target = eye + mu * forward
    if np.abs(target).max() <= _ROUNDING * np.abs(eye).max():
        target = np.zeros(3)
    return camera_of(eye, target, right, forward, dtype, distance=distance, window=height, **others)
