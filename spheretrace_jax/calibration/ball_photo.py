"""`BallPhoto`: what a photograph shows of a ball, prepared for the fit of its light."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ..base.errors import InputError
from ..fit.model.saturation import from_level, saturated
from .ball_pixels import BallPixels, ball_pixels
from .ball_radiance import BallSamples, radiance_terms
from .camera import Number
from .conic import BallOutline, outline_of_numbers
from .light_solver import SAMPLES, LightFit

# How far from the outline pixels are left out, in pixels: they show a part of the background.
_MARGIN = 1.5

# The share of the samples that are the brightest pixels: a sharp highlight is so small that evenly
# spread samples would miss it.
_BRIGHTEST = 8

#: The quantile of the ball's values that is 1 to the fit.
LEVEL_QUANTILE = 0.99

# The fewest pixels that tell a light.
_LEAST = 50


class BallPhoto(eqx.Module):
    """A photograph of a ball."""

    picture: Float[np.ndarray, "height width 3"]  #: linear
    counts: Bool[np.ndarray, "height width 3"]  #: which numbers of the ball's pixels count
    outline: BallOutline
    pixels: BallPixels
    level: float  #: what `BallSamples.values` are multiples of
    chosen: Int[np.ndarray, "2 samples"]  #: rows and columns of the samples; SAMPLES of them

    @property
    def samples(self) -> BallSamples:
        """Returns the samples by the outline."""
        return self.samples_by(self.outline)

    def samples_by(self, outline: BallOutline) -> BallSamples:
        """Returns the same pixels by another outline of the ball."""
        rows, columns = self.chosen
        size = self.picture.shape[:2]
        number = np.full(size, -1)
        pixels = self.pixels if outline is self.outline else ball_pixels(outline, _size(size))
        number[pixels.mask] = np.arange(len(pixels.normals))
        at = number[rows, columns]
        counts = self.counts[rows, columns] & (at >= 0)[:, None]
        # as many samples for every ball: what is missing does not count
        counts[self.counts.any(axis=2).sum() :] = False
        planes = (pixels.normals[at], pixels.views[at], self.picture[rows, columns] / self.level)
        values = np.where(counts, planes[2], 0)
        return BallSamples(*(jnp.asarray(x.T, float) for x in (*planes[:2], values, counts)))

    def shown(self, fit: LightFit) -> Float[np.ndarray, "height width 3"]:
        """Returns what a fit shows of all pixels of the ball; nan elsewhere."""
        normals, views = (jnp.asarray(x.T, float) for x in (self.pixels.normals, self.pixels.views))
        samples = BallSamples(normals, views, jnp.zeros_like(normals), jnp.zeros_like(normals))
        model = jax.tree.map(jnp.asarray, fit.model)
        terms = np.asarray(radiance_terms(jnp.asarray(fit.unknowns), samples, model), float)
        picture = np.full(self.picture.shape, np.nan)
        picture[self.pixels.mask] = self.level * (np.asarray(fit.amplitudes, float) @ terms).T
        return picture

    @property
    def moved(self) -> list[BallSamples]:
        """Returns the samples by outlines off by a standard deviation, along each axis."""
        size, vectors = np.linalg.eigh(self.outline.covariance)
        steps = vectors * np.sqrt(np.maximum(size, 0))
        numbers, intrinsics = self.outline.numbers, self.outline.intrinsics
        moved = [numbers + step for step, s in zip(steps.T, size, strict=True) if s > 0]
        return [self.samples_by(outline_of_numbers(x, intrinsics)) for x in moved]


class Exclusion(NamedTuple):
    """Which numbers of a photograph do not count."""

    mask: Bool[np.ndarray, "height width"] | None = None  #: which pixels may count
    brightest: Number | None = None  #: numbers from here on are saturated; None: told from them
    darkest: Number | None = None  #: numbers up to here are too dark


def ball_photo(
    name: str,
    picture: Float[np.ndarray, "height width 3"],
    outline: BallOutline,
    exclusion: Exclusion,
) -> BallPhoto:
    """Prepares a photograph. **Arguments:** `name`: for messages. `picture`: linear.

    **Raises:** `InputError` if too few pixels of the ball count.
    """
    pixels = ball_pixels(outline, _size(picture.shape), margin=_MARGIN)
    counts = np.isfinite(picture) & pixels.mask[..., None]
    if exclusion.mask is not None:
        if exclusion.mask.shape != picture.shape[:2]:
            raise InputError(
                f"{name}: expected a mask of {picture.shape[1]} x {picture.shape[0]} pixels, "
                f"got shape {exclusion.mask.shape}"
            )
        counts &= exclusion.mask[..., None]
    if exclusion.darkest is not None:
        counts &= picture > exclusion.darkest
    if exclusion.brightest is None:
        counts &= ~saturated(picture, counts)
    else:
        counts &= ~from_level(picture, exclusion.brightest)
    shown = np.asarray(counts.any(axis=2))
    found, ball = int(shown.sum()), int(pixels.mask.sum())
    if found < _LEAST:
        raise InputError(
            f"{name}: expected {_LEAST} pixels of the ball that are not saturated or masked, "
            f"got {found} of {ball}"
        )
    level = float(np.quantile(picture[counts], LEVEL_QUANTILE))
    if not level > 0:
        raise InputError(f"{name}: the ball is black, no light shows")
    return BallPhoto(picture, counts, outline, pixels, level, _choose(picture, shown))


def _choose(
    picture: Float[np.ndarray, "height width 3"], shown: Bool[np.ndarray, "height width"]
) -> Int[np.ndarray, "2 samples"]:
    """Chooses the samples: the brightest pixels, and others evenly."""
    places = np.argwhere(shown)
    if len(places) > SAMPLES:
        order = np.argsort(-np.nan_to_num(picture[shown]).sum(axis=1), kind="stable")
        bright = order[: SAMPLES // _BRIGHTEST]
        others = np.setdiff1d(np.arange(len(places)), bright)
        even = np.linspace(0, len(others) - 1, SAMPLES - len(bright)).astype(int)
        places = places[np.sort(np.concatenate([bright, others[even]]))]
    missing = SAMPLES - len(places)
    return np.concatenate([places, np.repeat(places[:1], missing, axis=0)]).T


def _size(shape: tuple[int, ...]) -> tuple[int, int]:
    return shape[0], shape[1]
