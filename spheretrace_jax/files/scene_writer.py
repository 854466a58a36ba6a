"""The writer of scene text, in the grammar of `scene_text.py`."""

import os
from pathlib import Path
from typing import Any
from unicodedata import category

import numpy as np

from ..base.errors import SceneError
from ..scene.camera import DEFAULTS
from ..scene.scene import Scene, known_scene
from ..scene.texture import Texture
from .atomic import write_text
from .scene_reader import DEFAULT_WINDOW, SPHERE_COLUMNS
from .scene_text import check_text


def save_scene(path: str | os.PathLike[str], scene: Scene) -> None:
    """Writes a scene file atomically; reading the file in the same dtype gives the same scene.

    (Only the checker colour of a plane without squares, which no picture shows, is lost.)

    **Raises:** `SceneError` for numbers that no scene file may hold (a negative radius, nan), and
    for textures that are in no file. `InputError` for scenes whose arrays do not fit.
    `OSError` if the file cannot be written.
    """
    write_text(path, checked_text(scene, os.fspath(path), Path(path).parent))


def checked_text(scene: Scene, name: str, folder: str | os.PathLike[str] = ".") -> str:
    """Returns the text that `save_scene` writes. **Arguments, raises:** as `parse_scene`."""
    scene = known_scene(scene)
    text = scene_text(scene, folder)
    try:
        check_text(name, text, scene.dtype)
    except SceneError as error:
        raise SceneError(f"cannot write a scene that could not be read: {error}") from None
    return text


def scene_text(scene: Scene, folder: str | os.PathLike[str] = ".") -> str:
    """Returns the text of a scene file in `folder`, with the shortest numbers that read exactly."""
    s, c, planes = scene.spheres, scene.camera, scene.planes
    lines = [
        f"{_words(c.theta, c.phi, c.mu, c.distance)} // theta phi mu distance",
        f"{scene.antialias} // antialias",
        f"{len(scene.lights)} // numlights",
    ]
    white = np.ones(3)
    lights = scene.lights
    rows = zip(lights.position, lights.color, lights.directional, lights.falloff, strict=True)
    for position, color, directional, falloff in rows:
        line = _words(position) + ("" if np.array_equal(color, white) else " " + _words(color))
        line += " directional" if directional else ""
        lines.append(line + (f" falloff {_words(falloff)}" if falloff else ""))
    coated = " ior" if np.any(np.asarray(s.ior) != 1) else ""
    lines += [f"{len(s)} // numspheres", f"//{' '.join(SPHERE_COLUMNS)} pic{coated}"]
    columns = (s.center, s.radius, s.color, s.ka, s.kd, s.ks, s.exponent, s.kgr, s.kt)
    for *row, pic, ior in zip(*(np.asarray(x) for x in (*columns, s.pic, s.ior)), strict=True):
        lines.append(f"{_words(*row)} {pic}" + (f" {_words(ior)}" if ior != 1 else ""))
    lines += [f"texture {_file_name(t, folder)}" for t in scene.textures]
    if (words := _words(scene.background)) != "0.0 0.0 0.0":
        lines.append(f"background {words}")
    if scene.sky is not None:
        lines.append(f"background_image {_file_name(scene.sky, folder)}")
    if (back := scene.back_plane) is not None:
        lines.append(f"back_plane {_words(back.color, back.ka, back.kd)}")
    columns = (planes.point, planes.normal, planes.color, planes.ka, planes.kd, planes.ks)
    columns += (planes.exponent, planes.kgr, planes.ior, planes.checker_color, planes.checker_size)
    for *row, ior, color, size in zip(*(np.asarray(x) for x in columns), strict=True):
        coat = f" ior {_words(ior)}" if ior != 1 else ""
        checker = f" checker {_words(color, size)}" if size else ""
        lines.append(f"plane {_words(*row)}{coat}{checker}")
    if float(c.window) != DEFAULT_WINDOW:
        lines.append(f"window {_words(c.window)}")
    optional = {name: getattr(c, name) for name in DEFAULTS}
    lines += [f"{name} {_words(x)}" for name, x in optional.items() if x is not None]
    lines += ["orthographic"] * c.orthographic
    return "\n".join(lines) + "\n"


def _words(*values: Any) -> str:
    """Returns all numbers of the values, with spaces between them."""
    return " ".join(str(x) for value in values for x in np.asarray(value).reshape(-1))


def _file_name(texture: Texture, folder: str | os.PathLike[str]) -> str:
    """Returns a texture's file name relative to a folder, quoted if it has spaces."""
    if not texture.file:
        raise SceneError("a texture is in no file: write it with write_image and name that file")
    name = Path(os.path.relpath(texture.file, folder)).as_posix()
    if any(c == '"' or category(c) in ("Cc", "Cs") for c in name):
        raise SceneError(
            f"a scene file cannot name the picture {name!r}: it has a quote or a control character"
        )
    return f'"{name}"' if any(c.isspace() for c in name) else name
