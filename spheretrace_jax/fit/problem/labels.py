"""Labels of a fit's unknowns: their names in words, and their indices."""

import numpy as np

from ..model.parameters import LIGHTS, SPHERES
from .problem import Problem

CHANNELS = ("red", "green", "blue")


def labels_of(problem: Problem) -> np.ndarray:
    """Returns a label of each unknown, in the order of `ravel_pytree`."""
    labels = []
    for name, arrays in unknown_indices(problem).items():
        for k, array in enumerate(arrays):
            suffix = picture_suffix(k) if name in problem.per_picture else ""
            labels += [f"{_label(name, index)}{suffix}" for index in np.ndindex(array.shape)]
    return np.asarray(labels)


def _label(name: str, index: tuple[int, ...]) -> str:
    if name in SPHERES:
        return f"sphere {index[0] + 1}'s {name}"
    if name in LIGHTS:
        return f"light {index[0] + 1}'s {name.removeprefix('light_')}"
    return f"the {CHANNELS[index[0]]} exposure" if name == "exposure" else f"the camera's {name}"


def picture_suffix(picture: int) -> str:
    """Returns words for the number of a picture, counted from 1."""
    return f" of picture {picture + 1}"


def unknown_indices(problem: Problem) -> dict[str, list[np.ndarray]]:
    """Returns the indices of each name's numbers in the vector of unknowns, in their shape.

    An array for each picture for parameters that each picture has apart, else one array.
    """
    start, end, indices = problem.start(), 0, {}
    for name in sorted(start):
        indices[name] = []
        for array in start[name] if name in problem.per_picture else [start[name]]:
            size = int(np.size(array))
            indices[name].append(np.arange(end, end + size).reshape(np.shape(array)))
            end += size
    return indices


def joined(words: list[str]) -> str:
    """Joins words with commas, and "and" before the last."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
