"""Summaries of a scene in words: what is in it, and the ranges of its numbers.

A scene is any object with the fields of `Scene`, whose module imports this one.
"""

from collections.abc import Sized
from typing import Any

import numpy as np
from jaxtyping import ArrayLike

from .arrays import is_traced
from .camera import DEFAULTS

# Limit of the lights that a summary lists, the first ones.
_MOST_LIGHTS = 4


def summary(scene: Any) -> str:
    """Returns a summary of at most ten lines."""
    if is_traced(scene):
        return f"{contents(scene)}, {scene.dtype}: its numbers are traced"
    lights, spheres = scene.lights, scene.spheres
    lines = [f"{contents(scene)}, {scene.dtype}, antialias {scene.antialias}", camera_line(scene)]
    for i in range(min(len(lights), _MOST_LIGHTS)):
        lines.append(light_line(scene, i))
    if len(lights) > _MOST_LIGHTS:
        lines.append(f"and {len(lights) - _MOST_LIGHTS} more lights")
    if len(spheres):
        names = ("radius", "ka", "kd", "ks", "exponent", "kgr", "kt")
        if np.any(np.asarray(spheres.ior) != 1):
            names += ("ior",)
        ranges = (f"{name} {_range(getattr(spheres, name))}" for name in names)
        lines.append(f"spheres: {', '.join(ranges)}")
    return "\n".join(lines)


def contents(scene: Any) -> str:
    """Returns how many objects of each kind a scene has."""
    counts = (
        _counted(scene.spheres, "sphere"),
        _counted(scene.lights, "light"),
        _counted(scene.planes, "plane"),
        _counted(scene.textures, "texture"),
    )
    return ", ".join(counts) + (", the back plane" if scene.back_plane is not None else "")


def camera_line(scene: Any) -> str:
    """Returns the numbers of the camera that are set."""
    names = ("theta", "phi", "mu", "distance", "window", *DEFAULTS)
    numbers = {n: x for n in names if (x := getattr(scene.camera, n)) is not None}
    words = [f"{n} {short(x)}" for n, x in numbers.items()]
    return f"camera: {', '.join(words + ['orthographic'] * scene.camera.orthographic)}"


def light_line(scene: Any, light: int) -> str:
    """Returns a light's number, from 1, its position or direction, its colour and fall-off."""
    lights = scene.lights
    where = "toward" if lights.directional[light] else "at"
    line = f"light {light + 1}: {where} {short(lights.position[light])}"
    line += f", color {short(lights.color[light])}"
    falloff = float(lights.falloff[light])
    return f"{line} at a distance of {falloff:g}" if falloff else line


def short(value: ArrayLike) -> str:
    """Returns numbers with six digits."""
    return " ".join(f"{float(x):g}" for x in np.atleast_1d(np.asarray(value)))


def _counted(things: Sized, name: str) -> str:
    return f"{len(things)} {name}{'' if len(things) == 1 else 's'}"


def _range(value: ArrayLike) -> str:
    least, most = (float(f(np.asarray(value))) for f in (np.min, np.max))
    return f"{least:g}" if least == most else f"{least:g} to {most:g}"
