"""Rows of a fit's parameters: before, after, and standard deviation, object by object."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..fit import Fit
from ..fit.model.accessors import CAMERA, value
from ..fit.model.parameters import bounding_sphere


class ParameterRow(NamedTuple):
    """The numbers of a free parameter of one object, in words."""

    name: str
    owner: str  #: the camera, or an object with its number, and its picture's if it has its own
    before: str
    after: str
    spread: str  #: the standard deviation; `-` where a number is not determined
    colors: tuple[np.ndarray, np.ndarray] | None  #: before and after, of a colour


def parameter_rows(fit: Fit) -> Iterator[ParameterRow]:
    """Returns the free parameters of a fit, a row for each object that is not held.

    A light whose distance does not show is at infinity, in a direction and at some distance at
    least.
    """
    deviations = fit.uncertainty.standard_deviations
    for name in fit.problem.parameters[0].free:
        if name == "exposure":
            continue
        own = name in fit.problem.per_picture
        for k in range(len(fit.scenes) if own else 1):
            spread = deviations[name][k] if own else deviations[name]
            of = f"picture {k + 1}, " if own and len(fit.scenes) > 1 else ""
            yield from _rows(fit, name, k, spread, of)


def _rows(fit: Fit, name: str, k: int, spread: np.ndarray, of: str) -> Iterator[ParameterRow]:
    """Returns a parameter's rows of picture k."""
    before, after = (np.asarray(value(s[k], name)) for s in (fit.starts, fit.scenes))
    if before.ndim == 0 or name in CAMERA:
        words = number_words(before), number_words(after), number_words(spread)
        yield ParameterRow(name, f"{of}camera", *words, None)
        return
    light = name.startswith("light")
    free = fit.problem.parameters[k].free_numbers(name).reshape(len(before), -1).any(axis=1)
    for i in map(int, np.flatnonzero(free)):
        owner = f"{of}{'light' if light else 'sphere'} {i + 1}"
        words = number_words(before[i]), number_words(after[i]), number_words(spread[i])
        if name == "light_position" and fit.uncertainty.light_distance(i, k).infinite:
            words = words[0], *_far(fit, k, i)
        colors = (before[i], after[i]) if name.endswith("color") else None
        yield ParameterRow(name, owner, *words, colors)


def _far(fit: Fit, k: int, light: int) -> tuple[str, str]:
    """Returns where a light at infinity is, and how well its direction is known."""
    scene = fit.scenes[k]
    middle, _ = bounding_sphere(scene)
    offset = np.asarray(scene.lights.position[light] - middle, np.float64)
    direction = number_words(offset / np.linalg.norm(offset))
    least = fit.uncertainty.light_distance(light, k).least
    angle, _ = fit.uncertainty.of_light(k, light)
    degrees = f"{np.degrees(angle):.2g} degrees" if np.isfinite(angle) else "-"
    return f"at infinity (at least {least:.3g}, 95 %), toward {direction}", degrees


def number_words(numbers: np.ndarray | np.floating) -> str:
    """Returns finite numbers with six digits, others as `-`."""
    finite = lambda x: f"{float(x):.6g}" if np.isfinite(x) else "-"
    return " ".join(finite(x) for x in np.atleast_1d(numbers))
