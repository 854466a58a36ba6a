"""The session of a window: a scene, what is shown of it, and how messages of the page change it."""

import math
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...base.errors import InputError
from ...files.scene_writer import save_scene
from ...rendering.layers import render_layers
from ...scene.needs import needs, together
from ...scene.parameters import FITTED, LIGHT_PLACES, Range, rows_of
from ...scene.scene import Scene
from ...scene.settings import MOST_BRANCHINGS
from ...scene.values import replace, values
from .frames import Frame, Shown, draw_frame

# The scenes that can be undone, the last ones.
_MOST_UNDONE = 100

#: The parameters of a sphere that have a slider, those of lights, and those of the camera.
SLIDERS = {
    "spheres": ("color", "ka", "kd", "ks", "exponent", "kgr", "kt", "ior", "center", "radius"),
    "lights": ("light_position", "light_direction", "light_color"),
    "camera": ("theta", "phi", "mu", "distance", "roll"),
}


class _Limits(NamedTuple):
    """What a number may be."""

    holds: Callable[[float], bool]
    words: str


_LIMITS: dict[Range, _Limits] = {
    "unit": _Limits(lambda x: 0 <= x <= 1, "in 0..1"),
    "positive": _Limits(lambda x: x > 0, "greater than 0"),
    "nonnegative": _Limits(lambda x: x >= 0, "at least 0"),
    "refraction": _Limits(lambda x: x >= 1, "at least 1"),
    "any": _Limits(lambda x: True, "finite"),
}


class Session:
    """A scene that is looked at and changed.

    A frame is drawn by the features that the session has needed so far. So a drag or a slider
    compiles once at most for each feature: where it is switched on for the first time. All of them
    from the start would make frames two to three times as slow.
    """

    def __init__(self, scene: Scene, size: tuple[int, int], target: np.ndarray | None = None):
        """Takes a scene. **Arguments:** `size`: width and height. `target`: a picture of the size.

        **Raises:** `InputError` for scenes that cannot be drawn.
        """
        self.scene, self.size, self.target = scene, size, target
        self.kind: Any = "picture"
        self.bounces = 5
        self.parameter, self.row, self.column = "color", 0, 0
        self.sphere = 0 if len(scene.spheres) else -1
        self._needs = needs(scene)
        self._undone: list[Scene] = []

    def frame(self, rough: bool = False) -> partial[Frame]:
        """Returns the drawing of the present state, which may be done in another thread.

        **Arguments:** `rough`: draw single rays, whatever the antialias flag is.
        """
        derived = self.kind == "derivative"
        free = (self.parameter,) if derived else ()
        self._needs = together(self._needs, needs(self.scene, free=free))
        number = (self.parameter, self.row, self.column) if derived else ("", 0, 0)
        shown = Shown(self.kind, self.size, self.bounces, self._needs, *number)
        scene = self.scene.with_antialias(0) if rough else self.scene
        return partial(draw_frame, scene, shown, self.target)

    # --- messages -----------------------------------------------------------------------------

    def take(self, message: dict[str, Any]) -> None:
        """Changes the session by a message of the page, whose numbers may be anything.

        **Raises:** `InputError` for what cannot be; the session is then as before.
        """
        takes: dict[str, Callable[..., None]] = {
            "set": self._set, "camera": self._camera, "light": self._move_light,
            "show": self._show, "options": self._options, "pick": self._pick,
            "begin": self._begin, "undo": self._undo, "sphere": self._choose,
        }  # fmt: skip
        kind = message.get("type")
        if not isinstance(kind, str) or kind not in takes:
            raise InputError(f"unknown message {kind!r}")
        for name in ("row", "column"):
            if not isinstance(number := message.get(name, 0), int) or number < 0:
                raise InputError(f"{kind}: {name} must be a whole number from 0, got {number!r}")
        try:
            takes[kind](**{k: v for k, v in message.items() if k != "type"})
        except (TypeError, ValueError, IndexError, KeyError, OverflowError) as error:
            raise InputError(f"{kind}: {error}") from None

    def _set(self, name: Any, value: Any, row: Any = 0, column: Any = 0) -> None:
        """Sets one number of a parameter."""
        if name not in FITTED:
            raise InputError(f"unknown parameter {name}")
        array = np.array(values(self.scene, name)[name])
        at = (row, column)[: array.ndim]
        number = float(value)
        limits = _LIMITS[FITTED[name].range]
        if not (math.isfinite(number) and limits.holds(number)):
            raise InputError(f"{name} must be {limits.words}, got {number:g}")
        array[at] = number
        self.scene = replace(self.scene, {name: array})

    def _camera(self, **numbers: Any) -> None:
        """Sets several numbers of the camera at once."""
        unknown = set(numbers) - set(SLIDERS["camera"])
        if unknown:
            raise InputError(f"unknown parameter {', '.join(sorted(unknown))}")
        self.scene = replace(self.scene, numbers)

    def _move_light(self, row: Any, x: Any, y: Any) -> None:
        """Moves a light to a place of the picture, in the plane parallel to the view plane.

        **Arguments:** `x`, `y`: pixels from the left and top edge.
        """
        handle = self.handles()[row]
        if handle is None:
            raise InputError(f"light {row + 1} cannot be dragged: it is behind the eye or far away")
        K, R, t = (np.asarray(m, np.float64) for m in self.scene.camera.opencv(self.size))
        depth = handle[2]
        place = R.T @ (np.linalg.solve(K, [x - 0.5, y - 0.5, 1]) * depth - t)
        positions = np.array(self.scene.lights.position)
        positions[row] = place
        self.scene = replace(self.scene, {"light_position": positions})

    def _show(self, kind: Any, parameter: Any = "", row: Any = 0, column: Any = 0) -> None:
        """Chooses what is shown: the picture, the derivative by one number, or the residual."""
        if kind not in ("picture", "derivative", "residual"):
            raise InputError(f"cannot show {kind}")
        if kind == "residual" and self.target is None:
            raise InputError("there is no target: start with --target PICTURE")
        if kind == "derivative":
            if parameter not in FITTED:
                raise InputError(f"unknown parameter {parameter}")
            shape = values(self.scene, parameter)[parameter].shape
            if any(not 0 <= i < n for i, n in zip((row, column), shape, strict=False)):
                raise InputError(f"{parameter} has shape {shape}, no number {row}, {column}")
            self.parameter, self.row, self.column = parameter, row, column
        self.kind = kind

    def _options(self, antialias: Any = None, bounces: Any = None) -> None:
        """Sets the antialias flag and the bounces."""
        if bounces is not None:
            if not 0 <= int(bounces) <= MOST_BRANCHINGS:
                raise InputError(f"bounces must be in 0..{MOST_BRANCHINGS}, got {bounces}")
            self.bounces = int(bounces)
        if antialias is not None:
            self.scene = self.scene.with_antialias(antialias)

    def _pick(self, x: Any, y: Any) -> None:
        """Chooses the sphere at a pixel."""
        width, height = self.size
        if not (0 <= x < width and 0 <= y < height):
            return
        flat = self.scene.with_antialias(0)
        object_ = int(render_layers(flat, width=width, height=height).object[int(y), int(x)])
        if 0 <= object_ < len(self.scene.spheres):
            self._choose(object_)

    def _choose(self, row: Any) -> None:
        """Chooses a sphere."""
        if not 0 <= row < len(self.scene.spheres):
            raise InputError(f"there is no sphere {row + 1}")
        self.sphere = row
        if self.parameter in SLIDERS["spheres"]:
            self.row = row

    def _begin(self) -> None:
        """Remembers the scene, before a drag or a slider changes it."""
        if not self._undone or self._undone[-1] is not self.scene:
            self._undone = [*self._undone[1 - _MOST_UNDONE :], self.scene]

    def _undo(self) -> None:
        """Goes back to the scene before the last drag or slider."""
        while self._undone:
            scene = self._undone.pop()
            if scene is not self.scene:
                self.scene = scene
                return

    # --- what the page shows ------------------------------------------------------------------

    def handles(self) -> list[tuple[float, float, float] | None]:
        """Returns where lights are in the picture, x, y in pixels and their depth.

        None for lights behind the eye, at infinity, and in parallel views.
        """
        lights = self.scene.lights
        if self.scene.camera.orthographic:
            return [None] * len(lights)
        K, R, t = (np.asarray(m, np.float64) for m in self.scene.camera.opencv(self.size))
        found: list[tuple[float, float, float] | None] = []
        for position, far in zip(np.asarray(lights.position), lights.directional, strict=True):
            seen = R @ position + t
            if far or not seen[2] > 0:
                found.append(None)
                continue
            x, y, _ = K @ (seen / seen[2])
            found.append((float(x) + 0.5, float(y) + 0.5, float(seen[2])))
        return found

    def state(self) -> dict[str, Any]:
        """Returns what the page shows besides the frame: numbers, handles and choices."""
        scene = self.scene
        numbers = values(scene, [name for names in SLIDERS.values() for name in names])
        lights = {n: rows_of(scene, n).tolist() for n in LIGHT_PLACES}
        return {
            "values": {name: np.asarray(x).tolist() for name, x in numbers.items()},
            "ranges": {name: FITTED[name].range for name in numbers},
            "sliders": SLIDERS,
            "lights": lights,
            "handles": self.handles(),
            "size": self.size,
            "sphere": self.sphere,
            "antialias": scene.antialias,
            "bounces": self.bounces,
            "kind": self.kind,
            "parameter": [self.parameter, self.row, self.column],
            "target": self.target is not None,
            "extent": _extent(scene),
            "undo": len(self._undone),
        }

    def save(self, path: Path, overwrite: bool = False) -> str:
        """Writes the scene. **Returns:** words for what was done.

        **Raises:** `InputError` for a file that exists, unless it may be overwritten, and for
        scenes that cannot be written; `OSError` if the file cannot be written.
        """
        if path.exists() and not overwrite:
            raise InputError(f"{path} exists: choose another name, or allow to overwrite it")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            save_scene(path, self.scene)
        return f"saved {path}"


def _extent(scene: Scene) -> float:
    """Returns a length of the scene, for the ranges of sliders."""
    centers, radii = np.asarray(scene.spheres.center), np.asarray(scene.spheres.radius)
    reach = (np.abs(centers).max(axis=1) + radii).max() if len(radii) else 0.0
    return float(max(reach, abs(float(scene.camera.mu)), 1e-6))
