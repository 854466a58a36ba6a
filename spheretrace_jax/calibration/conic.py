"""The outline of a ball in a picture: an ellipse in perspective, a circle in orthography.

A ball is described by what its picture determines: (u, v), the projection of its centre, and
r = focal R / Z, both in pixels. With q = (x, y) - principal point, c = (u, v) - principal point and
k = 1 / focal^2 the ray through q meets the ball exactly where

    F(q) = r^2 (1 + k |q|^2) - |q - c|^2 - k (q x c)^2 >= 0,

which is (d . C)^2 >= |d|^2 (|C|^2 - R^2) divided by Z^2 k (Hartley and Zisserman, Multiple View
Geometry, 2nd edition, 8.3: the cone of tangents). With k = 0 it is the disc of an orthographic
camera.
"""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike, Float

from ..base.errors import InputError
from .camera import Intrinsics, Number

Numbers = Float[np.ndarray, "..."]

# Step of difference quotients, in radii: errors of 1e-12 from the step and 1e-10 from rounding.
_STEP = 1e-6


class Ellipse(eqx.Module):
    """An ellipse: the points p with (p - center)^T shape^-1 (p - center) <= 1."""

    center: Float[np.ndarray, "2"]  #: middle of the ellipse, pixels
    shape: Float[np.ndarray, "2 2"]  #: symmetric and positive; eigenvalues: semi-axes squared
    #: covariance of (center x, center y, shape xx, shape xy, shape yy); zeros if not known
    covariance: Float[np.ndarray, "5 5"]

    @staticmethod
    def circle(x: Number, y: Number, radius: Number, std: Number = 0.0) -> "Ellipse":
        """Makes a circle, say one drawn by hand. **Arguments:** in pixels; `std` of all three."""
        if not radius > 0:
            raise InputError(f"radius: expected a positive number of pixels, got {radius}")
        change = np.zeros((5, 3))  # by x, y and radius
        change[[0, 1, 2, 4], [0, 1, 2, 2]] = 1, 1, 2 * radius, 2 * radius
        return Ellipse(np.array([x, y]), radius**2 * np.eye(2), std**2 * change @ change.T)

    @property
    def axes(self) -> tuple[float, float]:
        """The semi-axes in pixels, the longer one first."""
        short, long = np.sqrt(np.linalg.eigvalsh(self.shape))
        return float(long), float(short)

    @property
    def angle(self) -> float:
        """Direction of the longer axis, in radians from x (right) towards y (down)."""
        x, y = np.linalg.eigh(self.shape)[1][:, 1]
        return float(np.arctan(y / x) if x else np.pi / 2)

    @property
    def conic(self) -> Float[np.ndarray, "3 3"]:
        """The symmetric matrix M with p^T M p >= 0 inside, for homogeneous p = (x, y, 1)."""
        inverse = np.linalg.inv(self.shape)
        linear = inverse @ self.center
        constant = 1 - self.center @ linear
        return np.block([[-inverse, linear[:, None]], [linear, constant]])


class Ball(eqx.Module):
    """A ball in the camera's frame, in units of its own radius.

    No picture tells the size of a ball from its distance, so the radius is the unit. Of an
    orthographic camera nor does it tell the distance: `center` has z = 0 then, on the plane of
    which distances are counted.
    """

    center: Float[np.ndarray, "3"]  #: x right, y down, z forward, in radii
    covariance: Float[np.ndarray, "3 3"]  #: of `center`
    orthographic: bool  #: whether the rays are parallel to z

    @property
    def distance(self) -> float:
        """From the camera to the centre in radii; infinite for an orthographic camera."""
        return np.inf if self.orthographic else float(np.linalg.norm(self.center))

    @property
    def direction(self) -> Float[np.ndarray, "3"]:
        """Unit vector from the camera to the centre."""
        if self.orthographic:
            return np.array([0.0, 0, 1])
        return self.center / self.distance

    @property
    def direction_covariance(self) -> Float[np.ndarray, "3 3"]:
        """Covariance of `direction`, square radians: singular along the direction itself."""
        if self.orthographic:
            return np.zeros((3, 3))
        across = (np.eye(3) - np.outer(self.direction, self.direction)) / self.distance
        return across @ self.covariance @ across

    @property
    def angular_radius(self) -> float:
        """Angle between the centre and the outline, radians; 0 for an orthographic camera."""
        return float(np.arcsin(1 / self.distance))

    @property
    def angular_radius_std(self) -> float:
        """Standard deviation of `angular_radius`, radians."""
        if self.orthographic:
            return 0.0
        along = np.sqrt(self.direction @ self.covariance @ self.direction)
        return float(along / (self.distance * np.sqrt(self.distance**2 - 1)))


class BallOutline(eqx.Module):
    """A ball in a picture: the three numbers that a picture determines, in pixels."""

    center: Float[np.ndarray, "2"]  #: projection (u, v) of the ball's centre, pixels
    #: r = focal R / Z, pixels: the radius that the ball has in its own depth Z parallel to the
    #: picture. In orthography this is the outline's radius; in perspective the outline is a little
    #: larger, and its middle lies further from the principal point than `center`.
    radius: float
    covariance: Float[np.ndarray, "3 3"]  #: of (u, v, r), square pixels
    intrinsics: Intrinsics  #: the camera for which these numbers hold

    @property
    def std(self) -> Float[np.ndarray, "3"]:
        """Standard deviations of (u, v, r), pixels."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def numbers(self) -> Float[np.ndarray, "3"]:
        """The vector (u, v, r), pixels."""
        return np.array([*self.center, self.radius])

    def ball(
        self, focal: Number | None = None, principal_point: tuple[Number, Number] | None = None
    ) -> Ball:
        """Returns the ball in the camera's frame, in units of its radius.

        **Arguments:** `focal`, `principal_point`: of another camera than `intrinsics`. The outline
        stays then, so the projection of the centre moves.

        **Raises:** `InputError` if no ball before that camera has this outline.
        """
        if focal is not None or principal_point is not None:
            known = self.intrinsics
            cx, cy = known.principal_point if principal_point is None else principal_point
            camera = Intrinsics(known.focal if focal is None else focal, cx, cy)
            return outline_of_ellipse(self.ellipse, camera).ball()
        depth = 0.0 if self.intrinsics.orthographic else self.intrinsics.focal
        center = np.array([*self.center - self.intrinsics.principal_point, depth]) / self.radius
        change = np.column_stack([np.eye(3, 2), -center]) / self.radius
        covariance = change @ self.covariance @ change.T
        return Ball(center, covariance, self.intrinsics.orthographic)

    @property
    def ellipse(self) -> Ellipse:
        """The outline that shows in the picture."""
        values = _ellipse_numbers(self.numbers, self.intrinsics)
        steps = np.full(3, _STEP * self.radius)
        change = _jacobian(lambda x: _ellipse_numbers(x, self.intrinsics), self.numbers, steps)
        return Ellipse(values[:2], _symmetric(values[2:]), change @ self.covariance @ change.T)


def make_outline(
    u: Number, v: Number, r: Number, intrinsics: Intrinsics, covariance: Numbers | None = None
) -> BallOutline:
    """Makes the outline of a ball. **Arguments:** as the fields of `BallOutline`.

    **Raises:** `InputError` if the ball is not wholly in front of the camera.
    """
    if not 0 < r < intrinsics.focal:
        raise InputError(
            f"radius: expected 0 < radius < focal length, so that the ball is before the camera, "
            f"got radius {r:g} and focal length {intrinsics.focal:g} pixels"
        )
    covariance = np.zeros((3, 3)) if covariance is None else covariance
    return BallOutline(np.array([u, v], float), float(r), covariance, intrinsics)


def outline_of_numbers(
    numbers: Float[np.ndarray, "3"], intrinsics: Intrinsics, covariance: Numbers | None = None
) -> BallOutline:
    """Makes the outline of a ball from the vector (u, v, r), as `make_outline`."""
    u, v, r = numbers.tolist()
    return make_outline(u, v, r, intrinsics, covariance)


def outline_of_ball(
    center: ArrayLike | Sequence, radius: Number, intrinsics: Intrinsics
) -> BallOutline:
    """Projects a ball.

    **Arguments:** `center`: (X, Y, Z) in the camera's frame, any unit; an orthographic camera
    counts X and Y in pixels, and leaves Z out. `radius`: in the same unit.

    **Raises:** `InputError` if the ball is not wholly in front of the camera.
    """
    x, y, z = np.asarray(center, float)
    if not intrinsics.orthographic and not z > radius:
        raise InputError(f"center: expected a ball before the camera, got z = {z:g}")
    scale = 1.0 if intrinsics.orthographic else intrinsics.focal / z
    cx, cy = intrinsics.principal_point
    return make_outline(cx + scale * x, cy + scale * y, scale * radius, intrinsics)


def outline_of_ellipse(ellipse: Ellipse, intrinsics: Intrinsics) -> BallOutline:
    """Finds the ball that an ellipse is the outline of.

    The cone over the ellipse has one axis along which a ball lies. A ball's cone is circular; of
    other ellipses the two angles are averaged geometrically.

    **Raises:** `InputError` if no ball before the camera has such an outline.
    """
    values = np.array([*ellipse.center, *ellipse.shape[[0, 0, 1], [0, 1, 1]]])
    u, v, r = _outline_numbers(values, intrinsics)
    size = np.sqrt(np.linalg.eigvalsh(ellipse.shape)[0])  # the shorter semi-axis
    steps = _STEP * np.repeat([size, size**2], [2, 3])
    change = _jacobian(lambda x: _outline_numbers(x, intrinsics), values, steps)
    return make_outline(u, v, r, intrinsics, change @ ellipse.covariance @ change.T)


def outline_distance(
    points: Float[np.ndarray, "n 2"], numbers: Float[np.ndarray, "3"], intrinsics: Intrinsics
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 2"]]:
    """Computes how deep points of the picture lie inside the outline of a ball.

    The distance is A - B by the length of its gradient, with F = A^2 - B^2: exact for circles, and
    exact to first order next to any outline.

    **Arguments:** `points`: (x, y) in pixels. `numbers`: (u, v, r) of the ball.

    **Returns:** distances in pixels, positive inside; their derivatives by (u, v, r); and the
    unit normals of the outline, which point outside.
    """
    k = intrinsics.bend
    q = points - intrinsics.principal_point
    c = numbers[:2] - intrinsics.principal_point
    e = q - c
    cross = e[:, 0] * c[1] - e[:, 1] * c[0]  # = q x c, without cancellation
    stretch = np.sqrt(1 + k * (q * q).sum(1))
    b = np.sqrt((e * e).sum(1) + k * cross**2)
    b = np.where(b == 0, 1, b)  # at the centre itself, where any direction is as good
    gradient = (e + k * cross[:, None] * np.array([c[1], -c[0]])) / b[:, None]
    gradient -= numbers[2] * k * q / stretch[:, None]
    by_center = (e - k * cross[:, None] * np.column_stack([-q[:, 1], q[:, 0]])) / b[:, None]
    length = np.sqrt((gradient * gradient).sum(1))
    length = np.where(length == 0, 1, length)
    derivatives = np.column_stack([by_center, stretch]) / length[:, None]
    return (numbers[2] * stretch - b) / length, derivatives, gradient / length[:, None]


def outline_points(
    outline: BallOutline, angles: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 2"]:
    """Returns the points of an outline in directions from the centre's projection.

    **Arguments:** `angles`: radians from x (right) towards y (down).
    """
    k, r = outline.intrinsics.bend, outline.radius
    c = outline.center - outline.intrinsics.principal_point
    towards = np.column_stack([np.cos(angles), np.sin(angles)])
    along, across = towards @ c, towards[:, 0] * c[1] - towards[:, 1] * c[0]
    # F(c + s towards) = 0 is a s^2 - 2 b s - g = 0
    a, b, g = 1 + k * (across**2 - r**2), k * r**2 * along, r**2 * (1 + k * (c @ c))
    return outline.center + ((b + np.sqrt(b**2 + a * g)) / a)[:, None] * towards


def _ellipse_numbers(numbers: Numbers, intrinsics: Intrinsics) -> Numbers:
    """Returns (center x, center y, shape xx, xy, yy) of the outline of (u, v, r)."""
    k, r = intrinsics.bend, numbers[2]
    c = numbers[:2] - intrinsics.principal_point
    across = np.array([c[1], -c[0]])
    matrix = (1 - k * r**2) * np.eye(2) + k * np.outer(across, across)  # quadratic part of -F
    inverse = np.linalg.inv(matrix)
    # F(c) = r^2 (1 + k |c|^2), and F grows from there to the middle of the ellipse
    gradient = k * r**2 * c
    middle = inverse @ gradient  # of the ellipse, from c
    shape = (r**2 * (1 + k * (c @ c)) + gradient @ middle) * inverse
    return np.array([*numbers[:2] + middle, *shape[[0, 0, 1], [0, 1, 1]]])


def _outline_numbers(values: Numbers, intrinsics: Intrinsics) -> Numbers:
    """Returns (u, v, r) of the ball with the outline (center x, center y, shape xx, xy, yy)."""
    center, shape = values[:2], _symmetric(values[2:])
    determinant = np.linalg.det(shape)
    if intrinsics.orthographic:
        return np.array([*center, determinant**0.25])
    f = intrinsics.focal
    inverse = f**2 * np.linalg.inv(shape)
    m = (center - intrinsics.principal_point) / f
    linear = inverse @ m
    cone = np.block([[inverse, -linear[:, None]], [-linear, m @ linear - 1]])
    values, vectors = np.linalg.eigh(cone)
    axis = vectors[:, 0] * np.sign(vectors[2, 0])
    # the small eigenvalue from the determinant, which has no cancellation
    tangent = np.sqrt(f**4 / determinant / (values[1] * values[2]) ** 1.5)
    sine = tangent / np.hypot(1, tangent)
    if not (values[0] < 0 < values[1] and sine < axis[2]):
        raise InputError(
            f"outline: no ball before a camera of focal length {f:g} pixels is seen as this ellipse"
        )
    return np.array([*intrinsics.principal_point + f * axis[:2] / axis[2], f * sine / axis[2]])


def _symmetric(values: Numbers) -> Numbers:
    return values[[[0, 1], [1, 2]]]


def _jacobian(function, values: Numbers, steps: Numbers) -> Numbers:
    """Returns the Jacobian by central differences: rows of results, columns of values."""
    columns = [
        (function(values + step) - function(values - step)) / (2 * step.sum())
        for step in np.diag(steps)
    ]
    return np.column_stack(columns)
