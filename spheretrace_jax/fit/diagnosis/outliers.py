"""Outliers: numbers of a target that do not fit though the others do, and what rests on them.

A pixel on the wrong side of a shadow's edge, a highlight that a single ray meets: such numbers are
too few to matter to what remains of a picture. All that tells of an unknown may be among them.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree

from ...base.types import Picture
from ..model.target import SIGMA_OF_MEDIAN, Target
from ..problem.labels import labels_of
from ..problem.problem import Problem, normal_at, pictures_at
from .null_space import spectrum_of

# The residual from which a number is an outlier, in medians of the absolute residuals: 6 standard
# deviations of normal noise, which one of 5e8 numbers exceeds.
_OUTLYING = 6 * SIGMA_OF_MEDIAN

# The factor by which an unknown's standard deviation grows without the outliers if it rests on
# them. Leaving out as many other numbers of few may let it grow by less.
_GROWTH = 2

# The least share of J^T J that is left without the outliers; smaller ones are rounding errors.
_LEAST_SHARE = 1e-12


def find_outliers(problem: Problem, values: PyTree, cost: float) -> list[Bool[np.ndarray, "_ _ 3"]]:
    """Returns, of each picture, which numbers do not fit though the others do.

    Where pixels are areas there are none: residuals at covered edges are the error of coverage
    (docs/edges.md), and reported as such.

    **Arguments:** `cost`: the cost at `values`.
    """
    outliers, pictures = [], None
    for k, (target, settings) in enumerate(zip(problem.targets, problem.settings, strict=True)):
        # no number is further off than all of them
        if settings.antialias or np.sqrt(2 * cost) <= _rounding(target):
            outliers.append(np.zeros(target.image.shape, bool))
        else:
            pictures = pictures or pictures_at(problem, values)
            outliers.append(_outlying(target, *pictures[k]))
    return outliers


def _rounding(target: Target) -> float:
    """Returns the residual that rounding may leave; of a black picture as of a white one."""
    return float(4 * np.sqrt(np.finfo(target.image.dtype).eps) * (target.rms or 1.0))


def _outlying(
    target: Target, picture: Picture, exposure: Float[Array, " 3"]
) -> Bool[np.ndarray, "height width 3"]:
    misfit = np.abs(np.asarray(target.misfit(picture, exposure)))
    # misfits of 0 are black pixels', and no example of how well the others fit
    median = np.median(misfit[misfit > 0]) if misfit.any() else 0
    return misfit > max(_OUTLYING * median, _rounding(target))


def resting_on_outliers(
    outliers: list[Bool[np.ndarray, "_ _ 3"]], problem: Problem, values: PyTree
) -> list[str]:
    """Returns the labels of unknowns that outliers tell, and the other numbers hardly do."""
    if not any(x.any() for x in outliers):
        return []
    kept = [jnp.where(x, 0, t.weight) for x, t in zip(outliers, problem.targets, strict=True)]
    without = eqx.tree_at(lambda p: [t.weight for t in p.targets], problem, kept)
    square = np.asarray(normal_at(without, values).square, np.float64)
    spectrum = spectrum_of(np.asarray(normal_at(problem, values).square), problem.norm)
    # in these directions the picture has a J^T J of 1
    whitened = spectrum.known / np.sqrt(spectrum.values[: spectrum.rank]) / spectrum.scale[:, None]
    shares, vectors = np.linalg.eigh(whitened.T @ square @ whitened)
    half = whitened @ vectors / np.sqrt(np.maximum(shares, _LEAST_SHARE))
    rests = np.linalg.norm(half, axis=1) > _GROWTH * np.linalg.norm(whitened, axis=1)
    return list(dict.fromkeys(labels_of(problem)[rests]))
