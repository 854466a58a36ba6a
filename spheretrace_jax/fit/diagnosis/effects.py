"""Effects: what standard deviations mean for lights and materials, in words."""

from collections.abc import Iterator

import numpy as np

from ...scene.parameters import LIGHT_PLACES
from ..model.products import PRODUCTS
from ..problem.labels import free_lights
from ..problem.problem import Problem
from .uncertainty import Uncertainty

# The standard deviation of a distance, as a part of it, from which it says nothing.
_UNKNOWN = 0.5


def effects(problem: Problem, uncertainty: Uncertainty) -> tuple[str, ...]:
    """Returns for each light, and for the materials together, by how much they may be off."""
    return (*_of_lights(problem, uncertainty), *_of_others(problem, uncertainty))


def _of_lights(problem: Problem, uncertainty: Uncertainty) -> Iterator[str]:
    for name in LIGHT_PLACES:
        for k, i, suffix in free_lights(problem, name):
            angle, distance = uncertainty.of_light(k, i)
            if not np.isfinite(angle):
                continue
            words = f"light {i + 1}'s direction{suffix} by {np.degrees(angle):.2g} degrees"
            if 0 < distance < _UNKNOWN:
                words += f", its distance by {distance:.2g} of it"
            yield words


def _of_others(problem: Problem, uncertainty: Uncertainty) -> Iterator[str]:
    """Yields one list of the largest standard deviation of each name; products show of colours."""
    names = [n for n in problem.parameters[0].free if n not in LIGHT_PLACES]
    deviations = uncertainty.standard_deviations
    largest = {n: _largest(deviations[n]) for n in names}
    if "color" in names:
        for name in {"ka", "kd"} & set(names):
            largest[f"{name} color"] = _largest(uncertainty.of(PRODUCTS[f"{name}*color"]))
            largest.pop(name)
            largest.pop("color", None)
    words = [f"{name} by {x:.2g}" for name, x in sorted(largest.items()) if x > 0]
    if words:
        yield f"{', '.join(words)} at most"


def _largest(deviations: np.ndarray) -> float:
    """Returns the largest of those that are finite."""
    return float(np.max(deviations, where=np.isfinite(deviations), initial=0))
