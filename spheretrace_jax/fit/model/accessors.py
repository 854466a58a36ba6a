"""Accessors: from a scene to the arrays that the names of free parameters stand for, and back."""

from collections.abc import Callable, Iterable
from typing import Any

from jaxtyping import Array, Float

from ...scene.parameters import FITTED, light_places, with_optional
from ...scene.scene import Scene

Values = dict[str, Float[Array, "..."]]


def _accessors(owner: str) -> dict[str, Callable[[Scene], Any]]:
    return {name: p.value for name, p in FITTED.items() if p.owner == owner}


#: From the scene to the parameters of spheres, lights and the camera.
SPHERES, LIGHTS, CAMERA = (_accessors(owner) for owner in ("spheres", "lights", "camera"))
ACCESSORS = SPHERES | LIGHTS | CAMERA

#: The names of parameters that may be free. The exposure is a picture's, not the scene's.
NAMES = (*ACCESSORS, "exposure")

#: Those whose change is seen only by where edges are.
GEOMETRY = frozenset(name for name, p in FITTED.items() if p.moves_silhouettes)


def value(scene: Scene, name: str) -> Array:
    """Returns the array of a scene that a free parameter's name stands for.

    Optional numbers that are unset are at their defaults.
    """
    return ACCESSORS[name](with_optional(scene, (name,)))


def default_free(scene: Scene) -> tuple[str, ...]:
    """Returns what is free by default: materials but exponents, and where the lights are."""
    return ("color", "ka", "kd", "ks", *light_places(scene))


def distinct(names: Iterable[str]) -> dict[str, Callable[[Scene], Any]]:
    """Returns the accessors of parameters by their names, those of one array only once."""
    found: dict[str, str] = {}
    for name in names:
        found.setdefault(array_name(name), name)
    return {name: ACCESSORS[name] for name in found.values()}


def array_name(name: str) -> str:
    """Returns the name of the array that a parameter's name stands for."""
    parameter = FITTED[name]
    return f"{parameter.owner}.{parameter.attribute or name}"
