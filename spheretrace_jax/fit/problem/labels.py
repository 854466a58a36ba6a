"""What the unknowns of a fit are called, and where they are."""

import numpy as np

from ..model.parameters import LIGHTS, SPHERES
from .problem import Problem

CHANNELS = ("red", "green", "blue")


def labels_of(problem: Problem) -> np.ndarray:
    """What each unknown is, in the order of `ravel_pytree`."""
    names = []
    for name, arrays in unknown_places(problem).items():
        for k, array in enumerate(arrays):
            picture = picture_suffix(k) if name in problem.own else ""
            indices = np.ndindex(array.shape)
            names += [f"{_object(name, index)}{picture}" for index in indices]
    return np.asarray(names)


def _object(name: str, index: tuple[int, ...]) -> str:
    if name in SPHERES:
        return f"sphere {index[0] + 1}'s {name}"
    if name in LIGHTS:
        return f"light {index[0] + 1}'s {name.removeprefix('light_')}"
    return f"the {CHANNELS[index[0]]} exposure" if name == "exposure" else f"the camera's {name}"


def picture_suffix(picture: int) -> str:
    """Which picture something is of, counted from 1."""
    return f" of picture {picture + 1}"


def unknown_places(problem: Problem) -> dict[str, list[np.ndarray]]:
    """Where each name's numbers are in the vector of unknowns, in their shape.

    An array for each picture for what pictures have of their own, else one.
    """
    start, end, places = problem.start(), 0, {}
    for name in sorted(start):
        places[name] = []
        for array in start[name] if name in problem.own else [start[name]]:
            size = int(np.size(array))
            places[name].append(np.arange(end, end + size).reshape(np.shape(array)))
            end += size
    return places


def joined(parts: list[str]) -> str:
    """Parts with commas, and "and" before the last."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
