"""`Target`: a picture to fit, the weights of its numbers, and the loss.

The residual of a number is weight (exposure picture - target), bent by a robust loss if asked for:
Gauss-Newton on r~(r) with r~^2 / 2 = rho(r) minimises the sum of rho. See Triggs et al., "Bundle
Adjustment - A Modern Synthesis", 2000, section 4.3.
"""

import math
import warnings
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Shaped

from ...base.errors import InputError, PictureError, PictureWarning
from ...base.safe_math import larger
from ...base.types import Picture
from ...scene.numbers import whole_number
from .photo_noise import estimate_photo_noise
from .picture_numbers import linear_numbers, yes_or_no
from .saturation import from_level, saturated

Loss = Literal["square", "huber", "cauchy"]

#: The word for noise that is estimated from the picture.
PHOTO = "photo"

#: The residual at which a loss leaves the square, in standard deviations of the noise. A smaller
#: one passes over more outliers and is less efficient without them: these are 95 % efficient on
#: normal noise (Huber 1964; Holland and Welsch 1977).
_THRESHOLDS = {"square": 1.0, "huber": 1.345, "cauchy": 2.385}

# The brightness, as a part of the picture's mean, from which pixels take part in the estimate of
# the noise: black backgrounds fit without noise, and would pull the median down.
_DARK = 0.1

# The least noise, as a part of the picture's largest number: not the target's, which may be an
# outlier. It keeps robust losses finite where a target fits exactly; 16 bits are rounded to less.
_LEAST_NOISE = 1e-4

# The part of the numbers that `trimmed` leaves out. Those on the wrong side of a shadow's edge,
# for which it is there, must be fewer; of the rest as few as possible should go.
_TRIMMED = 0.05

#: The standard deviation of normal noise, in medians of its absolute values.
SIGMA_OF_MEDIAN = 1.4826


class Target(eqx.Module):
    """A picture to fit and which of its numbers count."""

    image: Picture
    weight: Float[Array, "height width 3"]  #: 0 where a number does not count
    noise: Float[Array, ""]  #: the scale of the weighted residuals, for robust losses
    loss: Loss = eqx.field(static=True)
    #: constant and slope of the variance, if it was estimated from the picture (`photo_noise.py`)
    photo_noise: Float[Array, " 2"] | None = None

    @property
    def counts(self) -> Bool[Array, "height width"]:
        """Returns which pixels have numbers that count."""
        return jnp.any(self.weight > 0, axis=-1)

    @property
    def counted(self) -> int:
        """Returns how many numbers count."""
        return int(np.sum(np.asarray(self.weight) > 0))

    @property
    def norm(self) -> float:
        """Returns the Euclidean norm of the weighted numbers."""
        numbers = np.asarray(self.image * self.weight).reshape(-1)
        return float(np.sqrt(numbers @ numbers))

    @property
    def rms(self) -> float:
        """Returns the root-mean-square of the weighted numbers that count."""
        return self.norm / np.sqrt(self.counted)

    def box_means(self, side: int) -> "Target":
        """Returns the means of boxes of pixels, at their middles; no other pixels count.

        **Arguments:** `side`: how many pixels wide and high the boxes are, an odd number.
        """
        rows, columns = (n // side for n in self.weight.shape[:2])

        def boxes(x: Picture) -> Float[Array, "rows side columns side 3"]:
            return x[: rows * side, : columns * side].reshape(rows, side, columns, side, 3)

        def at_middles(x: Float[Array, "rows columns 3"]) -> Picture:
            middles = (slice(side // 2, n * side, side) for n in (rows, columns))
            return jnp.zeros_like(self.weight).at[*middles].set(x)

        weights = boxes(self.weight)
        # of a mean of n numbers the noise is sqrt(n) times less
        weight = jnp.where(jnp.all(weights > 0, axis=(1, 3)), weights.mean(axis=(1, 3)) * side, 0)
        image = at_middles(boxes(self.image).mean(axis=(1, 3)))
        return Target(image, at_middles(weight), self.noise, self.loss)

    def misfit(self, picture: Picture, exposure: Float[Array, " 3"]) -> Picture:
        """Returns weight (exposure picture - target)."""
        return self.weight * (picture * exposure[None, None, :] - self.image)

    def residual(self, picture: Picture, exposure: Float[Array, " 3"]) -> Picture:
        """Returns the numbers whose squares are added up: the misfit, bent by the loss."""
        r = self.misfit(picture, exposure)
        if self.loss == "square":
            return r
        k = self.noise * _THRESHOLDS[self.loss]
        x = jnp.abs(r) / k
        if self.loss == "huber":
            bent = jnp.sqrt(2 * larger(x, 1) - 1)
            return jnp.where(x <= 1, r, jnp.sign(r) * k * bent)
        # smaller misfits stay as they are: their squares may underflow, where the root has no slope
        bends = x > jnp.sqrt(jnp.finfo(x.dtype).eps)
        log = jnp.log1p(jnp.where(bends, x * x, 1))
        return jnp.where(bends, jnp.sign(r) * k * jnp.sqrt(log), r)

    def slopes(self, picture: Picture, exposure: Float[Array, " 3"]) -> tuple[Picture, Picture]:
        """Returns the derivatives of the residuals by the picture's numbers and by exposures."""
        one = jnp.ones_like
        _, by_picture = jax.jvp(lambda p: self.residual(p, exposure), (picture,), (one(picture),))
        _, by_exposure = jax.jvp(lambda e: self.residual(picture, e), (exposure,), (one(exposure),))
        return by_picture, by_exposure

    def with_estimated_noise(self, picture: Picture, exposure: Float[Array, " 3"]) -> "Target":
        """Returns the target with the noise estimated from the median residual.

        Outliers do not move a median. Only pixels take part where the picture shows something:
        black backgrounds fit without any noise.
        """
        r = jnp.abs(self.misfit(picture, exposure))
        counts, brightness = self.weight > 0, jnp.abs(picture * exposure[None, None, :])
        mean = jnp.mean(brightness, where=counts)
        shown = counts & (brightness >= _DARK * mean)
        median = jnp.nanmedian(jnp.where(shown, r, jnp.nan))
        least = _LEAST_NOISE * jnp.max(brightness * self.weight)
        noise = jnp.maximum(SIGMA_OF_MEDIAN * median, least)
        return eqx.tree_at(lambda t: t.noise, self, jnp.where(noise > 0, noise, 1))

    def trimmed(self, picture: Picture, exposure: Float[Array, " 3"]) -> "Target":
        """Returns the target without the numbers that fit worst (least trimmed squares)."""
        r = jnp.abs(self.misfit(picture, exposure))
        limit = jnp.nanquantile(jnp.where(self.weight > 0, r, jnp.nan), 1 - _TRIMMED)
        return eqx.tree_at(lambda t: t.weight, self, jnp.where(r > limit, 0, self.weight))


def make_target(
    image: ArrayLike,
    dtype: np.dtype,
    *,
    mask: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    noise: ArrayLike | str | None = None,
    darkest: float | None = None,
    brightest: Any = None,
    loss: Loss = "square",
    shrink: int = 1,
) -> Target:
    """Checks a target picture and leaves out what is clipped.

    A picture none of whose numbers exceeds 1 and some of which are 1 was clipped, as 8- and 16-bit
    files are: the numbers at 1 say "at least 1" and do not count. So do those at a level at which
    a channel is clipped (`saturation.py`), unless `brightest` says from where numbers are. Half
    precision is promoted.

    **Arguments:** as for `fit`.

    **Warns:** `PictureWarning` of numbers that are scaled, and of grey pictures.

    **Raises:** `PictureError` for shapes that are no picture's, for nan and inf where the picture
    counts, for types other than floating numbers, uint8 and uint16, and if nothing counts;
    `InputError` for masks, weights and noise of other shapes or values out of range.
    """
    pixels, said = linear_numbers(_promoted(image))
    if said:
        warnings.warn(said, PictureWarning, stacklevel=2)
    if loss not in _THRESHOLDS:
        raise InputError(f"loss must be one of {', '.join(_THRESHOLDS)}, got {loss!r}")
    weight = np.ones(pixels.shape, dtype)
    if mask is not None:
        weight = np.where(yes_or_no(_per_number(mask, pixels, "mask")), weight, 0)
    if weights is not None:
        weights = _per_number(weights, pixels, "weights")
        if not (np.isfinite(weights) & (weights >= 0)).all():
            raise InputError("the weights must be finite and at least 0")
        # a weight counts squares, as a number of equal pixels would
        weight = weight * np.sqrt(weights)
    if isinstance(noise, str) and noise != PHOTO:
        raise InputError(f'noise must hold numbers or be "{PHOTO}", got {noise!r}')
    if noise is not None and not isinstance(noise, str):
        noise = _per_number(noise, pixels, "noise")
        if not (np.isfinite(noise) & (noise > 0)).all():
            raise InputError("the noise must be finite and greater than 0")
        weight = weight / noise
    bad = int(np.count_nonzero(~np.isfinite(pixels) & (weight > 0)))
    if bad:
        raise PictureError(f"the target must be finite, got {bad} numbers that are nan or inf")
    pixels = np.where(weight > 0, pixels, 0)
    counts = weight > 0
    clipped = saturated(pixels, counts) if brightest is None else from_level(pixels, brightest)
    if clipped[counts].all() and counts.any():
        raise PictureError("every number of the target is clipped: there is nothing to fit")
    weight = np.where(clipped, 0, weight)
    if darkest is not None:
        if np.isnan(darkest):
            raise InputError("darkest must be a number, got nan")
        weight = np.where(pixels <= darkest, 0, weight)
    if not (weight > 0).any():
        raise PictureError("no number of the target counts: there is nothing to fit")
    photo = None
    if isinstance(noise, str):
        estimated = estimate_photo_noise(pixels, weight > 0)
        weight, photo = weight / estimated.deviation(pixels), jnp.asarray(estimated, dtype)
    pixels, weight = _shrunk(pixels, weight, shrink)
    if noise is not None:  # of a mean of n numbers the noise is sqrt(n) times less
        weight = weight * shrink
    image_, weight = jnp.asarray(pixels, dtype), jnp.asarray(weight, dtype)
    return Target(image_, weight, jnp.ones((), dtype), loss, photo)


def _shrunk(pixels: np.ndarray, weight: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Averages boxes of pixels, of which those count whose numbers all count.

    **Raises:** `InputError` for sides that do not divide the picture, `PictureError` if no box
    counts.
    """
    height, width, _ = pixels.shape
    side = whole_number("shrink", side)
    if side < 1 or height % side or width % side:
        divisors = [str(n) for n in common_divisors(width, height)]
        known = f"such as {', '.join(divisors[:6])}" if divisors else "but none does"
        raise InputError(
            f"shrink must divide width and height of {width} x {height} pixels, {known}; got {side}"
        )
    if side == 1:
        return pixels, weight
    counts = mean_of_boxes(weight > 0, side) == 1
    if not counts.any():
        raise PictureError(f"no box of {side} x {side} pixels counts: there is nothing to fit")
    variance = mean_of_boxes(np.where(weight > 0, weight, 1.0) ** -2, side)
    return mean_of_boxes(pixels, side), np.where(counts, variance**-0.5, 0)


def mean_of_boxes(
    image: Shaped[np.ndarray, "height width 3"], side: int
) -> Float[np.ndarray, "rows columns 3"]:
    """Returns the means of boxes of `side` x `side` pixels, which divide the picture."""
    height, width, _ = image.shape
    return image.reshape(height // side, side, width // side, side, 3).mean(axis=(1, 3))


def common_divisors(width: int, height: int) -> list[int]:
    """Returns the whole numbers from 2 on that divide both."""
    most = math.gcd(width, height)
    return [n for n in range(2, most + 1) if most % n == 0]


def _promoted(value: ArrayLike) -> np.ndarray:
    """Converts to NumPy; half precision, which many EXR pictures have, becomes float32."""
    array = np.asarray(value)
    half = jnp.issubdtype(array.dtype, jnp.floating) and array.dtype.itemsize < 4
    return array.astype(np.float32) if half else array


def _per_number(value: ArrayLike, pixels: np.ndarray, name: str) -> np.ndarray:
    """Broadcasts one number for all, one per pixel or one per channel to one per channel."""
    array = _promoted(value)
    if array.dtype.kind not in "biuf":
        raise InputError(f"{name} must hold numbers, got {array.dtype}")
    if array.shape == pixels.shape[:2]:
        array = array[..., None]
    if array.shape not in ((), (*pixels.shape[:2], 1), pixels.shape):
        raise InputError(
            f"{name} must be one number or have the target's shape {pixels.shape} with or without "
            f"its channels, got shape {array.shape}"
        )
    return np.broadcast_to(array, pixels.shape)
