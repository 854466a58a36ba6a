"""Checks of numbers that are known, as those of scene files; traced ones are not looked at."""

import operator
import warnings
from typing import Any

import jax
import jax.core
import numpy as np
from jaxtyping import Shaped

from ..base.errors import InputError, SceneWarning

#: Arrays whose numbers are above 0: of a sphere of no size there is no normal.
_POSITIVE = frozenset(
    f"{owner}.{name}"
    for owner, names in {
        "spheres": ("radius",),
        "camera": ("distance", "window", "pixel_aspect"),
    }.items()
    for name in names
)

#: Colours that say how much of the light is reflected: more than all of it is unusual.
_REFLECTED = frozenset(("spheres.color", "planes.color", "planes.checker_color"))


def check_numbers(arrays: dict[str, Any]) -> None:
    """Checks the numbers of a scene that are known: finite, and above 0 where they are lengths.

    **Arguments:** `arrays`: by their names, such as `spheres.kd`.

    **Warns:** `SceneWarning`, once, for colours of objects out of 0..1.

    **Raises:** `InputError`, which names the array and the object.
    """
    known = {name: np.asarray(x) for name, x in arrays.items() if _is_known(x)}
    # all at once: array by array takes four times as long, half a millisecond for nine spheres
    if known and not np.isfinite(np.concatenate([x.ravel() for x in known.values()])).all():
        for name, numbers in known.items():
            _refuse(name, numbers, ~np.isfinite(numbers), "finite")
    for name in _POSITIVE & known.keys():
        _refuse(name, known[name], known[name] <= 0, "greater than 0")
    for name in _REFLECTED & known.keys():
        outside = known[name][(known[name] < 0) | (known[name] > 1)]
        if outside.size:
            # at one place, so that Python says it once
            warnings.warn(f"{name} is out of 0..1: {outside[0]:g}", SceneWarning, stacklevel=1)


def _is_known(array: Any) -> bool:
    """Tells whether numbers are known in this process: not traced, and not of another process."""
    traced = isinstance(array, jax.core.Tracer)
    return not traced and getattr(array, "is_fully_addressable", True)


def _refuse(name: str, numbers: Shaped[np.ndarray, "*shape"], wrong: Any, expected: str) -> None:
    """Refuses the first wrong number. **Raises:** `InputError`, if there is one."""
    if not wrong.any():
        return
    at = tuple(map(int, np.argwhere(wrong)[0]))
    place = f"{name}[{', '.join(map(str, at))}]" if at else name
    raise InputError(f"{place} must be {expected}, got {numbers[at]:g}")


def whole_number(name: str, value: Any) -> int:
    """Returns a whole number. **Raises:** `InputError` for words, fractions, True and False."""
    try:
        if not isinstance(value, bool | np.bool_):
            return operator.index(value)
    except TypeError:
        pass
    raise InputError(f"{name} must be a whole number, got {value!r}")
