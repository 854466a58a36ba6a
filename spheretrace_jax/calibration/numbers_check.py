"""A check of a photograph's numbers: whether they fit better as linear or as sRGB-encoded ones.

A picture of linear numbers that was read as sRGB, or the reverse, bends every shade, and turns
lights by degrees. (`fit/diagnosis/color_space.py` does the same for scenes.)
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..base.srgb import MISREAD
from .ball_photo import LEVEL_QUANTILE, BallPhoto
from .ball_radiance import LOBES, BallSamples
from .light_fit import FoundLight, best_of, lane_from, solve_lanes, unexplained_part
from .light_solver import LANES, LightFit, rows_at

# The part of the rms that is left with other numbers, from which these are the right ones. Of 12
# photographs by another renderer the right numbers leave at most 0.8 of what others do, mostly 0.3.
_BETTER = 0.7

# The part of the rms that is left from which the numbers are looked at: photographs with the right
# ones leave 0.015 to 0.03, with others 0.05 to 0.08. It takes half as long as the fit.
_SUSPECT = 0.03


def better_numbers(photo: BallPhoto, found: FoundLight) -> str | None:
    """Returns as what a photograph's numbers fit much better than as they are taken, if so.

    None where numbers exceed 0..1, of which no file of whole numbers is made.
    """
    samples = found.samples
    counts, values = (np.asarray(x, float) for x in (samples.counts, samples.values))
    numbers = values * photo.level
    shown = numbers[counts > 0]
    if shown.max() > 1 or shown.min() < -0.1:
        return None
    left = unexplained_part(rows_at(found.fit, samples), samples)
    if left < _SUSPECT:
        return None
    best, words = _BETTER * left, None
    for as_what, curve in MISREAD.items():
        other = curve(np.clip(numbers, 0, 1))
        other = other / np.quantile(other[counts > 0], LEVEL_QUANTILE)
        changed = jnp.asarray(np.where(counts > 0, other, 0), samples.values.dtype)
        part = _left(eqx.tree_at(lambda s: s.values, samples, changed), found.fit)
        if part < best:
            best, words = part, as_what
    return words


def _left(samples: BallSamples, fit: LightFit) -> float:
    """Returns what is left of other numbers' rms, with the best light for them."""
    falloff = bool(fit.model.falloff)
    lobes = (list(range(len(LOBES))) * 2)[:LANES]
    fits = solve_lanes(samples, [lane_from(fit, lobe, falloff) for lobe in lobes])
    return unexplained_part(rows_at(best_of(fits), samples), samples)
