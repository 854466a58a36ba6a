"""The search for exponents: where they are free, a few are tried with the lights.

Pictures are linear in ka color, kd color and ks, but not in exponents: with an exponent far off a
light moves to imitate the highlight's width.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..model.parameters import Parameters
from .variable_projection import SampledPixels, best_residual

# The exponents that are tried, beside the scene's. Neighbours differ by so little that a fit finds
# its way from the best; each one more takes the time of a search.
_EXPONENTS = (4.0, 16.0, 64.0, 256.0)


def with_exponents(sample: SampledPixels, parameters: Parameters) -> list[SampledPixels]:
    """Returns the sample, and where exponents are free the same with each that is tried."""
    if not _searched(parameters):
        return [sample]
    free = parameters.free_numbers("exponent")
    own = np.asarray(sample.scene.spheres.exponent)
    others = [np.where(free, exponent, own) for exponent in _EXPONENTS]
    return [sample, *(_with(sample, exponents) for exponents in others)]


def with_best_exponents(sample: SampledPixels, parameters: Parameters, lights) -> SampledPixels:
    """Returns the sample with the exponent of each sphere that suits known lights best."""
    if not _searched(parameters) or parameters.constraints.get("exponent") is not None:
        return sample
    tried = with_exponents(sample, parameters)
    sphere, count = np.asarray(sample.sphere), len(sample.scene.spheres)
    squares = [np.sum(np.asarray(best_residual(one, lights)) ** 2, axis=1) for one in tried]
    costs = np.stack([np.bincount(sphere, square, minlength=count) for square in squares])
    exponents = np.stack([np.asarray(one.scene.spheres.exponent) for one in tried])
    best = exponents[costs.argmin(axis=0), np.arange(count)]
    # of what is not seen the start is kept
    seen = np.isin(np.arange(count), sphere)
    return _with(sample, np.where(seen, best, np.asarray(parameters.scene.spheres.exponent)))


def _searched(parameters: Parameters) -> bool:
    """Tells whether exponents are free, without bounds."""
    if "exponent" not in parameters.free:
        return False
    constraint = parameters.constraints.get("exponent")
    if constraint is None:
        return True
    limits = np.asarray(constraint.lower), np.asarray(constraint.upper)
    return not np.isfinite(np.concatenate([x.ravel() for x in limits])).any()


def _with(sample: SampledPixels, exponents: np.ndarray) -> SampledPixels:
    changed = jnp.asarray(exponents, sample.scene.dtype)
    return eqx.tree_at(lambda s: s.scene.spheres.exponent, sample, changed)
