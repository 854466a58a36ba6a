"""`Camera`: the lecture's view, and cameras as photographs have them; rays from its eye."""

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..base.errors import InputError
from ..base.safe_math import to_order_one
from ..base.types import PixelArray, Scalar
from ..base.vec import SplitVec, Vec, components, spread, unit, vec
from .arrays import at_once, converted, floats, is_traced
from .pose import check_pose, orbit_of, view_axes

#: The numbers that a camera may leave unset, and what they are then.
DEFAULTS = {
    "roll": 0.0,
    "look_at": (0.0, 0.0, 0.0),
    "principal_point": (0.0, 0.0),
    "pixel_aspect": 1.0,
}


class Camera(eqx.Module):
    """A pinhole camera, or an orthographic one: an eye, and a window before it.

    The eye is on a sphere around `look_at` and looks at its centre. By default that is the origin,
    which is the lecture's view. What is None is left out of compiled pictures; to differentiate by
    such a number, set it. In pixels the focal length is distance / window times the picture's
    height, so a fit that searches the focal length has `distance` free.
    """

    theta: Scalar  #: azimuth of the eye, radians; differentiable, moves edges
    phi: Scalar  #: polar angle of the eye from +z, radians; differentiable, moves edges
    mu: Scalar  #: distance from `look_at` to the eye, world units; differentiable, moves edges
    distance: Scalar  #: from eye to view plane, world units; differentiable, moves edges
    #: height of the window on the view plane, world units; differentiable, moves edges
    window: Scalar
    #: radians, about `forward` by the right-hand rule: the camera's right side goes down, what it
    #: sees turns counter-clockwise; None for 0; differentiable, moves edges
    roll: Scalar | None
    #: what the eye looks at, world coordinates; None for the origin; differentiable, moves edges
    look_at: Float[Array, " 3"] | None
    #: where the optical axis meets the picture, right and down of its centre, in heights of the
    #: picture; None for its centre; differentiable, moves edges
    principal_point: Float[Array, " 2"] | None
    #: width of a pixel / its height, which is fy / fx; None for 1; differentiable, moves edges
    pixel_aspect: Scalar | None
    #: whether rays are parallel to `forward`: the window then is what of the world is seen
    orthographic: bool = eqx.field(static=True)

    def __init__(
        self,
        theta: ArrayLike = 0.0,
        phi: ArrayLike = 0.0,
        mu: ArrayLike = 500.0,
        distance: ArrayLike = 800.0,
        window: ArrayLike = 512.0,
        *,
        roll: ArrayLike | None = None,
        look_at: ArrayLike | Sequence | None = None,
        principal_point: ArrayLike | Sequence | None = None,
        pixel_aspect: ArrayLike | None = None,
        orthographic: bool = False,
    ):
        """Builds a camera. **Arguments:** as the fields."""
        optional = dict(zip(DEFAULTS, (roll, look_at, principal_point, pixel_aspect), strict=True))
        given = {name: value for name, value in optional.items() if value is not None}
        self.theta, self.phi, self.mu, self.distance, self.window, *numbers = floats(
            theta, phi, mu, distance, window, *given.values()
        )
        found = dict(zip(given, numbers, strict=True))
        self.roll, self.look_at = found.get("roll"), found.get("look_at")
        self.principal_point = found.get("principal_point")
        self.pixel_aspect = found.get("pixel_aspect")
        self.orthographic = bool(orthographic)

    @classmethod
    @at_once
    def from_intrinsics(
        cls,
        fx: ArrayLike,
        fy: ArrayLike,
        cx: ArrayLike,
        cy: ArrayLike,
        width: int,
        height: int,
        *,
        rotation: ArrayLike | Sequence | None = None,
        translation: ArrayLike | Sequence | None = None,
    ) -> "Camera":
        """Builds the camera of a photograph from numbers in pixels, by OpenCV's conventions.

        OpenCV's camera has x to the right, y down and z forward; X_camera = R X_world + t; a point
        is seen at (fx x/z + cx, fy y/z + cy), where pixel i has its centre at i. (Elsewhere in this
        package pixel i has its centre at i + 1/2.) The world is not mirrored: its coordinates and
        their hand stay as they are.

        **Arguments:** `fx`, `fy`: focal lengths, pixels, > 0. `cx`, `cy`: the principal point,
        pixels. `width`, `height`: of the picture, pixels. `rotation`: R, `(3, 3)`, by default 1
        (from a rotation vector: `cv2.Rodrigues(rvec)[0]`). `translation`: t, `(3,)` or `(3, 1)`, by
        default 0. Without both, the world is OpenCV's camera: the eye is at the origin and looks
        along +z, and +y is down.

        **Returns:** a camera whose `distance` and `window` are in pixels: only their ratio counts.

        **Raises:** `InputError` for arrays of other shapes, for an R that is no rotation, and for
        focal lengths and sizes that are not above 0.
        """
        size = _checked_size(width, height)
        rotation = np.eye(3, dtype=np.int32) if rotation is None else rotation
        translation = np.zeros(3, np.int32) if translation is None else translation
        fx, fy, cx, cy, R, t = floats(fx, fy, cx, cy, rotation, translation)
        t = t.reshape(-1)
        check_pose(R, t)
        for name, focal in (("fx", fx), ("fy", fy)):
            if not is_traced(focal) and not focal > 0:
                raise InputError(f"{name}, a focal length in pixels, must be above 0, got {focal}")
        orbit = orbit_of(R, t)
        # from pixel centres at i to those at i + 1/2
        offset = jnp.stack([cx - (size[0] - 1) / 2, cy - (size[1] - 1) / 2])
        return cls(
            orbit.theta,
            orbit.phi,
            orbit.mu,
            fy,
            converted(size[1], fy.dtype),
            roll=orbit.roll,
            look_at=orbit.look_at,
            principal_point=offset / size[1],
            pixel_aspect=fy / fx,
        )

    @classmethod
    @at_once
    def from_opencv(
        cls,
        matrix: ArrayLike | Sequence,
        rotation: ArrayLike | Sequence,
        translation: ArrayLike | Sequence,
        size: tuple[int, int],
    ) -> "Camera":
        """Builds the camera of OpenCV's matrices; the inverse of `opencv`.

        **Arguments:** `matrix`: K, `(3, 3)`. `rotation`, `translation`: R and t, as for
        `from_intrinsics`. `size`: the picture's (width, height) in pixels.

        **Raises:** `InputError` as `from_intrinsics`, and for a K with skew, which no camera here
        has. Lens distortion is no part of K: undistort pictures first.
        """
        (K,) = floats(matrix)
        if K.shape != (3, 3):
            raise InputError(f"K must be an array of shape (3, 3), got {K.shape}")
        if not is_traced(K):
            fixed = np.asarray(K)[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]]
            if fixed[0] != 0:
                raise InputError(f"K must have no skew, got K[0, 1] = {fixed[0]:g}")
            if (fixed != [0, 0, 0, 0, 1]).any():
                raise InputError("K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
        focal, center = (K[0, 0], K[1, 1]), (K[0, 2], K[1, 2])
        pose = dict(rotation=rotation, translation=translation)
        return cls.from_intrinsics(*focal, *center, *size, **pose)

    @at_once
    def opencv(
        self, size: tuple[int, int]
    ) -> tuple[Float[Array, "3 3"], Float[Array, "3 3"], Float[Array, " 3"]]:
        """Returns OpenCV's matrices K, R and t of a picture; see `from_intrinsics`.

        **Arguments:** `size`: the picture's (width, height) in pixels.

        **Raises:** `InputError` for orthographic cameras, which have no K.
        """
        if self.orthographic:
            raise InputError("an orthographic camera has no K")
        (fx, fy), (cx, cy) = intrinsics(self, _checked_size(*size))
        zero, frame = jnp.zeros_like(fx), view_frame(self)
        K = [[fx, zero, cx - 0.5], [zero, fy, cy - 0.5], [zero, zero, zero + 1]]
        axes = (frame.right, -frame.up, frame.forward)
        R = jnp.stack([jnp.stack(components(axis)) for axis in axes])
        eye = jnp.stack(components(frame.eye))
        return jnp.stack([jnp.stack(row) for row in K]), R, -(R @ eye)

    @at_once
    def crop(
        self, left: ArrayLike, top: ArrayLike, width: int, height: int, size: tuple[int, int]
    ) -> "Camera":
        """Returns the camera of a part of a picture, whose rays are those of the whole picture.

        They agree to some rounding errors of a pixel's position. Where edges are covered, the
        part's outermost pixels lack the neighbours by which smooth shading is averaged.

        **Arguments:** `left`, `top`: of the part, pixels, which may be fractions and lie outside of
        the picture. `width`, `height`: of the part, pixels. `size`: the whole picture's
        (width, height).

        **Raises:** `InputError` for sizes that are not above 0.
        """
        width, height = _checked_size(width, height)
        _, center = intrinsics(self, _checked_size(*size))
        corner = [converted(x, self.window.dtype) for x in (left, top)]
        middle = (width / 2, height / 2)
        offset = [c - at - m for c, at, m in zip(center, corner, middle, strict=True)]
        return dataclasses.replace(
            self,
            window=self.window * (height / size[1]),
            principal_point=jnp.stack(offset) / height,
        )


def with_defaults(camera: Camera, names: Iterable[str] = tuple(DEFAULTS)) -> Any:
    """Returns a camera whose optional numbers of some names are arrays, at defaults if unset."""
    unset = {n: x for n, x in DEFAULTS.items() if n in names and getattr(camera, n) is None}
    arrays = {name: converted(x, camera.mu.dtype) for name, x in unset.items()}
    return dataclasses.replace(camera, **arrays) if arrays else camera


def _checked_size(width: int, height: int) -> tuple[int, int]:
    """Checks a size in pixels. **Raises:** `InputError`."""
    for name, count in (("width", width), ("height", height)):
        if not isinstance(count, int | np.integer) or count <= 0:
            raise InputError(f"{name} must be a whole number of pixels above 0, got {count!r}")
    return int(width), int(height)


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


class Intrinsics(NamedTuple):
    """The map from the camera's coordinates to a picture's pixels: right, then down."""

    #: pixels per slope, x/z and y/z; of an orthographic camera per world unit
    scale: tuple[Scalar, Scalar]
    #: where the optical axis meets the picture, in pixels from its left and top edge
    center: tuple[Scalar | float, Scalar | float]


def view_frame(camera: Camera) -> Frame:
    """Computes the eye's position and the axes of the view, in world coordinates.

    The eye is at polar angle phi and azimuth theta on the sphere of radius mu around `look_at`, and
    looks at its centre. The axes depend on the angles alone, so mu = 0 is no special case.

    **Returns:** the position `eye`, and orthonormal `right`, `up` and `forward`.
    """
    right, up, forward = view_axes(camera.theta, camera.phi, camera.roll)
    eye = forward * -camera.mu
    if camera.look_at is not None:
        eye = vec(camera.look_at) + eye
    return Frame(eye, right, up, forward)


def intrinsics(camera: Camera, size: tuple[int, int]) -> Intrinsics:
    """Returns the focal lengths and the principal point of a picture of a size, in pixels."""
    pitch = camera.window / size[1]
    down = 1 / pitch if camera.orthographic else camera.distance / pitch
    right = down if camera.pixel_aspect is None else down / camera.pixel_aspect
    center = size[0] / 2, size[1] / 2
    if (offset := camera.principal_point) is not None:
        center = center[0] + offset[0] * size[1], center[1] + offset[1] * size[1]
    return Intrinsics((right, down), center)


def pixel_rays(camera: Camera, columns: PixelArray, rows: PixelArray, size: tuple[int, int]) -> Ray:
    """Returns the rays through points of the window, from the eye.

    Column i and row j of a picture `height` pixels high have their centre at
    x = (i + 1/2 - width/2) pitch along right, y = -(j + 1/2 - height/2) pitch along up, with
    pitch = window/height, on the view plane `distance` before the eye. Row 0 is the top. A
    principal point moves the window against the axis, and x grows by the aspect of pixels. Rays of
    an orthographic camera start at these points of the plane through the eye.

    **Arguments:** `columns`, `rows`: positions in pixels from the picture's left and top edge
    (pixel i's centre is at i + 1/2), of shapes that broadcast: `(1, width)` and `(rows, 1)` for a
    whole picture. `size`: the picture's (width, height) in pixels.

    **Returns:** rays with one origin, or of an orthographic camera one for each position, and a
    direction of unit length for each position.
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
    scale = 1 if camera.orthographic else to_order_one(camera.window, camera.distance)
    distance, pitch = camera.distance * scale, camera.window * scale / size[1]
    right, up = columns - size[0] / 2, size[1] / 2 - rows
    if (offset := camera.principal_point) is not None:
        right, up = right - offset[0] * size[1], up + offset[1] * size[1]
    if camera.pixel_aspect is not None:
        right = right * camera.pixel_aspect
    x, y = right * pitch, up * pitch
    if camera.orthographic:
        across = lambda eye, right, up: eye + (y * up + x * right)
        origin = SplitVec(*map(across, *map(components, (frame.eye, frame.right, frame.up))))
        return Ray(origin, spread(frame.forward, jnp.broadcast_shapes(x.shape, y.shape)))

    def along(right: PixelArray, up: PixelArray, forward: PixelArray) -> PixelArray:
        return (y * up + distance * forward) + x * right

    towards = SplitVec(
        along(frame.right.x, frame.up.x, frame.forward.x),
        along(frame.right.y, frame.up.y, frame.forward.y),
        along(frame.right.z, frame.up.z, frame.forward.z),
    )
    return Ray(frame.eye, towards)
