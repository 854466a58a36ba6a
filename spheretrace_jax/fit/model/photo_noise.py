"""Noise of photographs: of variance a + b I at level I, read-out noise and photon noise.

Estimated from the picture alone, by differences of neighbours in which shading cancels (Immerkaer,
"Fast Noise Variance Estimation", Computer Vision and Image Understanding 64, 1996), level by level
(Foi, Trimeche, Katkovnik and Egiazarian, "Practical Poissonian-Gaussian Noise Modeling and Fitting
for Single-Image Raw-Data", IEEE Transactions on Image Processing 17, 2008). So what a scene does
not explain is not taken for noise.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...base.errors import PictureError

# Second differences by rows of second differences by columns: what is linear or quadratic in one
# of both cancels. The sum of the squared weights is 36.
_DIFFERENCE = np.outer([1, -2, 1], [1, -2, 1])

# The numbers of one level's estimate, the levels at most, and the least numbers of all.
_OF_LEVEL, _MOST_LEVELS, _LEAST = 200, 24, 64

# The brightness, as a part of the mean, from which numbers tell of noise: black backgrounds of
# files have none.
_DARK = 0.05

# The least standard deviation, as a part of the largest number; 16 bits are rounded to less.
_LEAST_NOISE = 1e-4

# Rounds of least squares, each weighted by the variances of the one before.
_ROUNDS = 10

_SIGMA_OF_MEDIAN = 1.4826


class PhotoNoise(NamedTuple):
    """Noise of variance `constant + slope I` at level I."""

    constant: float
    slope: float

    def deviation(self, level: Any) -> Any:
        """Returns the standard deviation at a level."""
        return np.sqrt(self.constant + self.slope * np.maximum(level, 0))


def estimate_photo_noise(
    image: Float[np.ndarray, "height width 3"], counts: Bool[np.ndarray, "height width 3"]
) -> PhotoNoise:
    """Estimates the noise of a picture, whose channels are alike.

    **Arguments:** `counts`: which numbers are neither masked nor clipped.

    **Raises:** `PictureError` if too few numbers have neighbours that count.
    """
    mean = image[counts].mean() if counts.any() else 0.0
    # with no black neighbours either: outlines in front of black are no noise
    level, difference, inside = _shifted(image, counts & (image > _DARK * mean))
    level, size = level[inside], np.abs(difference[inside]) / 6
    if level.size < _LEAST:
        raise PictureError(
            f'noise "photo" needs {_LEAST} numbers with neighbours that count, got {level.size}'
        )
    order = np.argsort(level, kind="stable")
    parts = np.array_split(order, np.clip(level.size // _OF_LEVEL, 1, _MOST_LEVELS))
    levels = np.array([level[part].mean() for part in parts])
    variances = np.array([(_SIGMA_OF_MEDIAN * np.median(size[part])) ** 2 for part in parts])
    least = (_LEAST_NOISE * float(np.max(image, where=counts, initial=0))) ** 2
    return _line(levels, np.maximum(variances, least), least)


def _line(levels: np.ndarray, variances: np.ndarray, least: float) -> PhotoNoise:
    """Returns the line a + b I through variances, with a of some size and b of 0 at least.

    An estimate of a variance scatters in proportion to it, so squares count relative to the line.
    """
    fitted = variances
    constant, slope = least, 0.0
    for _ in range(_ROUNDS):
        weight = 1 / fitted**2
        ones = np.stack([np.ones_like(levels), levels], axis=1)
        square, right = (ones.T * weight) @ ones, (ones.T * weight) @ variances
        constant, slope = np.linalg.lstsq(square, right, rcond=None)[0]
        if slope < 0 or levels.size == 1:
            constant, slope = right[0] / square[0, 0], 0.0
        elif constant < least:
            slope = max((right[1] - least * square[0, 1]) / square[1, 1], 0.0)
            constant = least
        fitted = constant + slope * levels
    return PhotoNoise(float(constant), float(slope))


def _shifted(image: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns of 3 x 3 pixels their mean, their difference, and whether all of them count."""
    height, width, _ = image.shape
    if min(height, width) < 3:
        return image[:0], image[:0], counts[:0]
    level = np.zeros((height - 2, width - 2, 3))
    difference, inside = np.zeros_like(level), np.full(level.shape, True)
    for i in range(3):
        for j in range(3):
            part = np.s_[i : i + height - 2, j : j + width - 2]
            level += image[part] / 9
            difference += _DIFFERENCE[i, j] * image[part]
            inside &= counts[part]
    return level, difference, inside
