"""Highlights of a ball: where lights are mirrored, and the directions of these lights.

A mirror turns the view direction V at a point with the normal N to L = 2 (N.V) N - V. All pixels of
a spot are turned so, and the mean of their directions is taken, by brightness and solid angle: in
directions the spot is round about its light, while in the picture it is not (Debevec 1998).
"""

from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Num
from scipy import ndimage

from ..base.errors import InputError
from .ball_pixels import ball_hits, ball_pixels
from .camera import Number
from .conic import BallOutline, outline_of_numbers

Picture = Num[np.ndarray, "height width *channels"]

# Numbers within this share of the maximum count as saturated, where they are this many.
_ONE_LEVEL, _MANY = 1e-4, 4

# Where a spot ends, from its surroundings (0) to its peak (1).
_HALF = 0.5

# The least height above the ball's median that a spot has: in shares of the highest, and in
# deviations of the picture. Lower, the mirrored surroundings count as lights.
_LEAST_HEIGHT, _SIGNIFICANT = 0.3, 8.0

# The least brightness of a further spot in shares of the brightest.
_LEAST_BRIGHTNESS = 0.02


class Spot(eqx.Module):
    """A bright spot on a ball, and the light that it mirrors; vectors in the camera's frame."""

    center: Float[np.ndarray, "2"]  #: middle of the spot in the picture, pixels
    center_covariance: Float[np.ndarray, "2 2"]  #: square pixels
    pixels: float  #: area of the spot in the picture
    saturated: bool  #: whether the picture is clipped there
    color: Float[np.ndarray, " channels"]  #: mean of the spot's pixels
    brightness: float  #: sum over the spot, above its surroundings, times solid angle
    normal: Float[np.ndarray, "3"]  #: outward unit normal of the ball at the spot
    direction: Float[np.ndarray, "3"]  #: unit vector from the ball's surface to the light
    covariance: Float[np.ndarray, "3 3"]  #: of `direction`, square radians
    solid_angle: float  #: of the light as seen from the ball, steradians; with the lobe of gloss

    @property
    def std(self) -> float:
        """Standard deviation of `direction` in radians, along its less certain axis."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance)[-1]))

    def from_center(self, distance: Number = np.inf) -> Float[np.ndarray, "3"]:
        """Returns the unit vector from the ball's centre to the light.

        A mirror tells the direction from its own point. The centre sees a light at d radii in a
        direction up to 1/d radians away, and a light at infinity in the same.

        **Arguments:** `distance`: from the ball's centre to the light, in radii, more than 1.
        """
        if not distance > 1:
            raise InputError(f"distance: expected more than 1 radius, got {distance}")
        if np.isinf(distance):
            return self.direction
        along = float(self.normal @ self.direction)
        # |normal + s direction| = distance
        s = -along + np.sqrt(along**2 + (distance - 1) * (distance + 1))
        return (self.normal + s * self.direction) / distance


def brightest_spot(picture: Picture, outline: BallOutline, *, level: Number | None = None) -> Spot:
    """Finds the highlight of a glossy ball: the spot that holds its brightest pixels.

    Where the picture is saturated, the saturated region counts; else the part above half of the
    highlight's height, weighted by brightness.

    **Arguments:** `picture`: linear numbers. `level`: at which the picture is saturated; by default
    told from numbers that are equal to the maximum.

    **Raises:** `InputError` if the picture does not show the ball, or it is dark.
    """
    return _spots(picture, outline, level, chrome=False)[0]


def chrome_spots(
    picture: Picture,
    outline: BallOutline,
    count: int | None = None,
    *,
    level: Number | None = None,
) -> list[Spot]:
    """Finds the lights that a mirroring ball shows, the brightest first.

    **Arguments:** `picture`, `level`: as in `brightest_spot`. `count`: how many lights there are;
    by default all spots clearly above the mirrored surroundings.

    **Raises:** `InputError` if there are fewer spots.
    """
    spots = _spots(picture, outline, level, chrome=True)
    if count is not None and len(spots) < count:
        raise InputError(f"count: expected {count} bright spots on the ball, found {len(spots)}")
    return spots[:count]


class _Shown(NamedTuple):
    """The ball's pixels in a picture."""

    mask: Bool[np.ndarray, "height width"]
    rows: np.ndarray
    columns: np.ndarray
    mirrored: Float[np.ndarray, "n 3"]
    solid_angles: Float[np.ndarray, " n"]


def _spots(
    picture: Picture, outline: BallOutline, level: Number | None, *, chrome: bool
) -> list[Spot]:
    """Finds the bright spots of a ball: all, or the one that holds the maximum."""
    values = np.asarray(picture, float)
    values = values[..., None] if values.ndim == 2 else values
    shown = _mirrored(outline, values.shape[:2])
    grey = np.where(shown.mask, values.mean(-1), -np.inf)
    on_ball = grey[shown.mask]
    top, ground = float(on_ball.max()), float(np.median(on_ball))
    if not (np.isfinite(on_ball).all() and top > ground):
        raise InputError("picture: the ball shows no spot, its brightest pixels are the usual ones")
    if level is None:
        equal = grey >= top - _ONE_LEVEL * abs(top)
        level = top * (1 - _ONE_LEVEL) if equal.sum() >= _MANY else np.inf
    noise = 1.4826 * float(np.median(np.abs(on_ball - ground)))
    height = max(_LEAST_HEIGHT * (top - ground), min(_SIGNIFICANT * noise, 0.5 * (top - ground)))
    labels = np.zeros(grey.shape, np.int32)
    if not chrome:
        least = level if np.isfinite(level) else ground + _HALF * (top - ground)
        ndimage.label(grey >= least, np.ones((3, 3)), output=labels)
        brightest = labels[np.unravel_index(np.argmax(grey), grey.shape)]
        if np.isfinite(level):  # the largest saturated region
            brightest = 1 + np.bincount(labels.ravel())[1:].argmax()
        return [_spot(values, grey, labels == brightest, shown, outline, level)]
    ndimage.label(grey >= ground + height, np.ones((3, 3)), output=labels)
    spots = [
        _spot(values, grey, labels == k, shown, outline, level) for k in range(1, labels.max() + 1)
    ]
    spots.sort(key=lambda spot: -spot.brightness)
    return [s for s in spots if s.brightness >= _LEAST_BRIGHTNESS * spots[0].brightness]


def _spot(
    values: Float[np.ndarray, "height width channels"],
    grey: Float[np.ndarray, "height width"],
    area: Bool[np.ndarray, "height width"],
    shown: _Shown,
    outline: BallOutline,
    level: Number,
) -> Spot:
    """Measures a spot: its middle, weighted by brightness above the surroundings."""
    saturated = bool((grey[area] >= level).any())
    around = np.asarray(ndimage.binary_dilation(area, iterations=2)) & shown.mask & ~area
    ground = float(np.median(grey[around])) if around.any() else 0.0
    peak = float(min(level, grey[area].max()))
    # the pixels at the border that the spot covers in part belong to it by their share
    part = (area | around)[shown.mask]
    floor = ground if saturated else ground + _HALF * (peak - ground)
    height = np.maximum(grey[shown.mask][part] - floor, 0)
    weight = height / max(peak - floor, 1e-300)
    weight = np.minimum(weight, 1) if saturated else weight
    angles, mirrored = shown.solid_angles[part], shown.mirrored[part]
    places = np.column_stack([shown.columns[part], shown.rows[part]]) + 0.5
    total = float((weight * angles).sum())
    if not total > 0:
        weight, total = np.ones_like(weight), float(angles.sum())
    direction = (weight * angles) @ mirrored
    direction /= np.linalg.norm(direction)
    center = (weight * angles) @ places / total
    away = places - center
    # the weights at the border of a saturated spot, and all others, are rounded to whole pixels
    inner = np.asarray(ndimage.binary_erosion(area), bool)
    unsure = (area & ~inner)[shown.mask][part] if saturated else weight
    shares = (unsure * angles / total)[:, None] * away
    shift = (shares.T @ shares + np.eye(2) / max(len(weight), 1)) / 12
    by_center, by_ball = _derivatives(center, outline)
    covariance = by_center @ shift @ by_center.T + by_ball @ outline.covariance @ by_ball.T
    normal, _, _ = ball_hits(center[None], outline)
    return Spot(
        center,
        shift,
        float(weight.sum()),
        saturated,
        values[area].mean(0),
        float((height * angles).sum()),
        normal[0],
        direction,
        covariance,
        total,
    )


def _mirrored(outline: BallOutline, size: tuple[int, ...]) -> _Shown:
    """Computes the mirror directions of all pixels of a ball, and their solid angles."""
    pixels = ball_pixels(outline, (size[0], size[1]), margin=1.0)
    if not pixels.mask.any():
        raise InputError("picture: it does not show the ball; the outline lies outside of it")
    rows, columns = np.nonzero(pixels.mask)
    places = np.column_stack([columns, rows]) + 0.5
    sides = [_mirror(places + step, outline) for step in 0.5 * _AXES]
    across, down = sides[0] - sides[1], sides[2] - sides[3]
    angles = np.linalg.norm(np.cross(across, down), axis=1)
    return _Shown(pixels.mask, rows, columns, _mirror(places, outline), angles)


_AXES = np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])


def _mirror(places: Float[np.ndarray, "n 2"], outline: BallOutline) -> Float[np.ndarray, "n 3"]:
    normals, views, _ = ball_hits(places, outline)
    return 2 * (normals * views).sum(1, keepdims=True) * normals - views


def _derivatives(
    center: Float[np.ndarray, "2"], outline: BallOutline
) -> tuple[Float[np.ndarray, "3 2"], Float[np.ndarray, "3 3"]]:
    """Returns how the mirror direction moves with the spot and with (u, v, r) of the ball."""
    step = 1e-4
    sides = _mirror(center + step * _AXES, outline)
    by_center = np.column_stack([sides[0] - sides[1], sides[2] - sides[3]]) / (2 * step)
    columns = []
    for axis in np.eye(3):
        more, less = (
            _mirror(
                center[None], outline_of_numbers(outline.numbers + s * axis, outline.intrinsics)
            )[0]
            for s in (step, -step)
        )
        columns.append((more - less) / (2 * step))
    return by_center, np.column_stack(columns)
