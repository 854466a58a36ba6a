"""Colour space: whether a picture fits better if its numbers were coded otherwise.

A picture of linear numbers that was read as sRGB, or the reverse, bends every shade, and no lights
and materials straighten it. On a sample of pixels lights are searched again, with the materials
that suit them best (`variable_projection.py`), for the numbers as they are, decoded and coded.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from ...base.srgb import MISREAD
from ..problem.problem import Problem
from ..solver.light_search import free_places, is_separable, light_constraints
from ..solver.variable_projection import SampledPixels, best_residual, refine_lights, sample_pixels

# The part of the residual's mean square that is left with other numbers, from which these are the
# right ones. Nearer to 1 other faults of a model are taken for those of the numbers.
_BETTER = 0.5


def better_numbers(problem: Problem, values: PyTree) -> str | None:
    """Returns as what a picture's numbers fit much better than as they are taken, if so.

    None where the pictures are not linear in materials, or exceed 0..1.
    """
    if not is_separable(problem):
        return None
    left = dict.fromkeys(("", *MISREAD), 0.0)
    for k, (scene, _) in enumerate(problem.scenes_at(values)):
        parameters, target = problem.parameters[k].starting_at(scene), problem.targets[k]
        image = np.asarray(target.image)
        if image.min() < 0 or image.max() > 1:
            return None
        even = eqx.tree_at(lambda t: t.weight, target, jnp.sign(target.weight))
        sample = sample_pixels(parameters, even, problem.settings[k])
        # any materials: only shades tell
        places = lambda s: (s.known, s.free)
        anything = jnp.zeros_like(sample.known), jnp.ones_like(sample.free)
        sample = eqx.tree_at(places, sample, anything)
        for words in left:
            numbers = np.asarray(sample.image, np.float64)
            numbers = MISREAD[words](numbers) if words else numbers
            changed = jnp.asarray(numbers, sample.image.dtype)
            changed = eqx.tree_at(lambda s: s.image, sample, changed)
            lights, free = scene.lights.position, free_places(parameters)
            lights = refine_lights(changed, lights, free, light_constraints(parameters))
            left[words] += _unexplained(changed, lights)
    best = min(left, key=lambda words: left[words])
    return best if best and left[best] < _BETTER * left[""] else None


def _unexplained(sample: SampledPixels, lights) -> float:
    """Returns the part of the variance that is left, whatever the numbers' contrast."""
    counts, image = np.asarray(sample.weight) > 0, np.asarray(sample.image, np.float64)
    spread = 0.0
    for number in np.unique(np.asarray(sample.sphere)):
        for c in range(3):
            of = image[..., c][(np.asarray(sample.sphere) == number) & counts[..., c]]
            spread += float(np.var(of) * of.size) if of.size else 0.0
    residual = np.asarray(best_residual(sample, lights), np.float64)
    return float(np.sum(residual**2)) / spread if spread else 0.0
