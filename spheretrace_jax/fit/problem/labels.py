"""Labels of a fit's unknowns: their names in words, and their indices."""

from collections.abc import Iterator

import numpy as np

from ...scene.parameters import rows_of
from ..model.accessors import LIGHTS, SPHERES
from .problem import Problem

CHANNELS = ("red", "green", "blue")


def labels_of(problem: Problem) -> np.ndarray:
    """Returns a label of each unknown, in the order of `ravel_pytree`."""
    labels: dict[int, str] = {}
    for name, arrays in unknown_indices(problem).items():
        for k, array in enumerate(arrays):
            suffix = picture_suffix(k) if name in problem.per_picture else ""
            places: dict[int, list] = {}
            for index in np.ndindex(array.shape):
                places.setdefault(int(array[index]), []).append(index)
            places.pop(-1, None)
            labels |= {i: f"{_label(name, at)}{suffix}" for i, at in places.items()}
    return np.asarray([labels[i] for i in sorted(labels)])


def _label(name: str, places: list[tuple[int, ...]]) -> str:
    """Returns a label of one unknown, which tied numbers share."""
    index = places[0]
    if len(places) > 1:
        if name == "exposure":
            return f"the exposure of {joined([CHANNELS[i] for (i,) in places])}"
        numbers = joined([str(at[0] + 1) for at in places])
        kind = "sphere" if name in SPHERES else "light"
        return f"the {name.removeprefix('light_')} of {kind}s {numbers}"
    if name in SPHERES:
        return f"sphere {index[0] + 1}'s {name}"
    if name in LIGHTS:
        return f"light {index[0] + 1}'s {name.removeprefix('light_')}"
    return f"the {CHANNELS[index[0]]} exposure" if name == "exposure" else f"the camera's {name}"


def picture_suffix(picture: int) -> str:
    """Returns words for the number of a picture, counted from 1."""
    return f" of picture {picture + 1}"


def free_lights(problem: Problem, name: str) -> Iterator[tuple[int, int, str]]:
    """Yields the lights whose place is free: picture, light, and words for the picture.

    **Arguments:** `name`: one of `LIGHT_PLACES`, which only lights of its kind have. Lights that
    all pictures share count once, as of picture 0.
    """
    if name not in problem.parameters[0].free:
        return
    apart = name in problem.per_picture
    for k, parameters in enumerate(problem.parameters if apart else problem.parameters[:1]):
        free = parameters.free_numbers(name).any(axis=1) & rows_of(parameters.scene, name)
        for i in np.flatnonzero(free).tolist():
            yield k, i, picture_suffix(k) if apart else ""


def unknown_indices(problem: Problem) -> dict[str, list[np.ndarray]]:
    """Returns the indices of each name's numbers in the vector of unknowns, in their shape.

    -1 for numbers that are held. An array for each picture for parameters that each picture has
    apart, else one array.
    """
    start, end, indices = problem.start(), 0, {}
    for name in sorted(start):
        indices[name] = []
        for k, array in enumerate(start[name] if name in problem.per_picture else [start[name]]):
            size = int(np.size(array))
            unknown = np.arange(size).reshape(np.shape(array))
            if name in problem.parameters[k].constraints:
                unknown = np.asarray(problem.parameters[k].constraints[name].unknown)
            indices[name].append(np.where(unknown < 0, -1, end + unknown))
            end += size
    return indices


def joined(words: list[str]) -> str:
    """Joins words with commas, and "and" before the last."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
