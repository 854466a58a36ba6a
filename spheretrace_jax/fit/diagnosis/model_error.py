"""Model error: what a scene that does not explain its pictures does to the numbers found.

Where residuals are no white noise, standard deviations count three things more: how blocks of the
pictures pull (`block_jackknife.py`), how far the answer moves from one half of each object to the
other, and how far it moves if dark pixels count for more, as photon noise would have it. A model
that is right gives the same answer everywhere.
"""

import equinox as eqx
import numpy as np

from ..normal_equations.normal_equations import NormalEquations
from .block_jackknife import BlockJackknife, bright_halves
from .evidence import objects_at
from .residual_structure import structure
from .uncertainty import Uncertainty, square_of_free

# The brightness, as a part of the mean, below which pixels count no more than at it, if they count
# in inverse proportion to their brightness. A smaller one gives all weight to black pixels.
_DARKEST = 0.1


def with_model_error(uncertainty: Uncertainty, normal: NormalEquations) -> Uncertainty:
    """Returns an uncertainty with what the scene does not explain of the pictures.

    The same where residuals are white noise: where neighbours do not agree, and blocks pull no more
    than such noise would. That costs one step of the fit for each block, else two more.

    **Arguments:** `normal`: the normal equations at the solution.
    """
    problem, values, spectrum = uncertainty.problem, uncertainty.values, uncertainty.spectrum
    if not spectrum.rank or not np.isfinite(float(normal.cost)):
        return uncertainty
    held = np.asarray(problem.at_bounds(values))
    square = square_of_free(spectrum, held) * np.outer(spectrum.scale, spectrum.scale)
    objects = objects_at(problem, values)
    blocks = BlockJackknife(problem, values, square, objects, uncertainty.step)
    exposures = [exposure for _, exposure in problem.scenes_at(values)]
    pictures = list(zip(problem.targets, normal.pictures, exposures, strict=True))
    shared = any(structure(*picture).shared for picture in pictures)
    if not shared and not blocks.is_structured(uncertainty.noise):
        return uncertainty
    brightness = [np.abs(np.asarray(p) * np.asarray(e)).mean(axis=-1) for _, p, e in pictures]
    counts = [np.asarray(target.counts) for target in problem.targets]
    bright = [bright_halves(*of) for of in zip(brightness, counts, objects, strict=True)]
    weights = [_even(*of) for of in zip(brightness, counts, strict=True)]
    parts = [blocks.scatter, blocks.halves(bright), blocks.reweighted(weights)]
    return eqx.tree_at(lambda u: u.model_error, uncertainty, np.concatenate(parts, axis=1))


def _even(brightness: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Returns the factors of residuals whose variance grows with the brightness; mean square 1."""
    mean = brightness[counts].mean()
    if not mean > 0:
        return np.ones_like(brightness)
    factor = np.sqrt(1 / np.maximum(brightness / mean, _DARKEST))
    return factor / np.sqrt(np.mean(factor[counts] ** 2))
