"""Numbers of a target that do not fit though the others do, and what is known from them alone.

A pixel on the wrong side of a shadow's edge, a highlight that a single ray meets: such numbers are
too few to matter to what remains of a picture, but all that tells of something may be among them.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree

from ...base.types import Picture
from ...rendering.render import draw_everywhere
from ..model.target import Target
from ..problem.labels import labels_of
from ..problem.problem import Problem, normal_at
from .uncertainty import spectrum_of

# Numbers that are off by more standard deviations than this, as the median has them, are strays.
_FAR = 6 * 1.4826

# Standard deviations that grow as much without the strays rest on them.
_GROWTH = 2

# What of J^T J is no more than rounding.
_NOTHING = 1e-12


def find_outliers(problem: Problem, values: PyTree, cost: float) -> list[Bool[np.ndarray, "_ _ 3"]]:
    """Of each picture the numbers that do not fit though the others do.

    Where pixels are areas there are none: what is left at covered edges is their own error
    (docs/edges.md), and said to be that. **Arguments:** `cost`: what is known to be left.
    """
    found = []
    for k, (target, settings) in enumerate(zip(problem.targets, problem.settings, strict=True)):
        # no number is further off than all of them
        if settings.antialias or np.sqrt(2 * cost) <= _least(target):
            found.append(np.zeros(target.image.shape, bool))
        else:
            scene, exposure = problem.place(values)[k]
            found.append(_far(target, draw_everywhere(scene, settings), exposure))
    return found


def _least(target: Target) -> float:
    """What numbers may be off by for reasons of rounding; of a black picture as of a white one."""
    return float(4 * np.sqrt(np.finfo(target.image.dtype).eps) * (target.size or 1.0))


def _far(
    target: Target, picture: Picture, exposure: Float[Array, " 3"]
) -> Bool[np.ndarray, "height width 3"]:
    off = np.abs(np.asarray(target.misfit(picture, exposure)))
    # what is 0 is black, and no example of how well the others fit
    typical = np.median(off[off > 0]) if off.any() else 0
    return off > max(_FAR * typical, _least(target))


def resting_on_outliers(
    find_outliers: list[Bool[np.ndarray, "_ _ 3"]], problem: Problem, values: PyTree
) -> list[str]:
    """The names of what is known from strays, and hardly from the others."""
    if not any(x.any() for x in find_outliers):
        return []
    kept = [jnp.where(x, 0, t.weight) for x, t in zip(find_outliers, problem.targets, strict=True)]
    others = eqx.tree_at(lambda p: [t.weight for t in p.targets], problem, kept)
    square = np.asarray(normal_at(others, values).square, np.float64)
    spectrum = spectrum_of(np.asarray(normal_at(problem, values).square), problem.length)
    # in these directions the picture has a J^T J of 1
    one = spectrum.known / np.sqrt(spectrum.values[: spectrum.rank]) / spectrum.scale[:, None]
    shares, vectors = np.linalg.eigh(one.T @ square @ one)
    half = one @ vectors / np.sqrt(np.maximum(shares, _NOTHING))
    named = np.linalg.norm(half, axis=1) > _GROWTH * np.linalg.norm(one, axis=1)
    return list(dict.fromkeys(labels_of(problem)[named]))
