"""NFF: Eric Haines's Neutral File Format, that of his Standard Procedural Databases, read.

Entities, each started by its word; numbers may go on over several lines, and `#` starts a comment
up to the end of its line:

    v  from X Y Z  at X Y Z  up X Y Z  angle A  hither H  resolution W H
    b R G B                             the background
    l X Y Z [R G B]                     a light at a point, on one line
    f R G B Kd Ks Shine T index         how the objects that follow look
    s X Y Z radius                      a sphere
    p N  X Y Z ...                      a polygon of N vertices
    pp N  X Y Z NX NY NZ ...            a polygon of N vertices with normals
    c X Y Z radius  X Y Z radius        a cone or a cylinder

Coordinates are right-handed. `angle`, in degrees, is between the centres of the top and the bottom
row of pixels. Lights without a colour have 1/sqrt(their number). Ks weighs the highlight,
(R.V)^Shine, and the mirrored ray; T weighs the ray behind the surface. There is no ambient light.
(E. Haines, A Proposal for Standard Graphics Environments, IEEE CG&A 7(11), 1987, and the text on
NFF that comes with its programs.)

A scene here has neither polygons with edges nor cones, nor refraction. What becomes of these is
said in warnings with file and line; `nff_polygons.py` chooses the polygons that become planes.
"""

import os
import re
import warnings
from collections.abc import Iterable
from math import inf, radians, tan
from typing import Any, NamedTuple

import numpy as np

from ..base.errors import SceneWarning
from ..scene.lights import Lights
from ..scene.planes import Planes
from ..scene.scene import Scene
from ..scene.spheres import Spheres
from .nff_polygons import Polygon, bounding_planes
from .scene_text import scene_dtype
from .tokens import Token, Tokens, decode, read_bytes
from .view import camera_of, unit_vector

_POINT = ("X", "Y", "Z")
_COLOR = ("R", "G", "B")
_VIEW = ("from", "at", "up", "angle", "hither", "resolution")


class Fill(NamedTuple):
    """How the objects look that follow an `f`."""

    token: Token
    color: list[float]
    kd: float
    ks: float
    shine: float
    t: float
    ior: float


_NUMBER = r"[+-]?(?:\d{1,40}\.?\d{0,40}|\.\d{1,40})(?:[eE][+-]?\d{1,9})?"


class _NffTokens(Tokens):
    """The words of an NFF file: `#` starts a comment up to the end of the line.

    A sphere on one line, as nearly all are, is one word: word by word takes three times as long.
    """

    pattern = re.compile(
        r"#[^\r\n]*|(?P<newline>\r\n|\r|\n)"
        rf"|(?P<word>s(?:[ \t]+{_NUMBER}){{4}}(?=[ \t]*(?:[\r\n#]|\Z))|[^\s#]+)",
        re.ASCII,
    )


class NffReader:
    """The entities of an NFF file, each number checked where it stands."""

    def __init__(self, name: str, text: str, dtype: np.dtype):
        self.tokens = _NffTokens(name, text, dtype)
        self.view: dict[str, list[float]] = {}
        self.background: list[float] = [0.0, 0.0, 0.0]
        self.lights: list[tuple[list[float], list[float] | None]] = []
        self.fills: list[Fill] = []
        self.sphere_starts: list[Token] = []
        self.sphere_numbers: list[float] = []
        self.sphere_fills: list[int] = []
        self.polygons: list[Polygon] = []
        self.warnings: list[tuple[int, str]] = []
        self.given: dict[str, int] = {}

    @np.errstate(over="ignore")  # numbers too large for float32 become inf, and are refused
    def read(self) -> "NffReader":
        """Reads the whole file. **Returns:** self. **Raises:** `SceneError`."""
        tokens = self.tokens
        if not tokens.peek.text:
            tokens.fail(tokens.peek, "expected an NFF scene, starting with v, got an empty file")
        while (word := tokens.take()).text:
            if len(word.text) > 8 and word.text[0] == "s" and word.text[1] in " \t":
                self._add_sphere(word, map(float, word.text[1:].split()))
                continue
            read = self._ENTITIES.get(word.text)
            if read is None:
                tokens.fail_spelling(word, f"one of {', '.join(self._ENTITIES)}")
            read(self, word)
        self.spheres = self._sphere_table()
        if not self.view:
            tokens.fail(word, "expected a view, v, got the end of the file")
        return self

    def say(self, token: Token, message: str) -> None:
        """Notes what is not carried over from a token's line, and what was done instead."""
        self.warnings.append((token.line, message))

    def _numbers(self, names: Iterable[str]) -> list[float]:
        return [self.tokens.number(self.tokens.take(), name) for name in names]

    def _between(self, names: Iterable[str], high: float = 1.0) -> list[float]:
        return [self.tokens.between(self.tokens.take(), name, 0, high) for name in names]

    def _once(self, token: Token) -> None:
        line = self.given.setdefault(token.text, token.line)
        if line != token.line:
            self.tokens.fail(token, f"{token.text} was given before, on line {line}")

    def _read_view(self, start: Token) -> None:
        """Reads the words of a view, in any order."""
        tokens = self.tokens
        self._once(start)
        places = {}
        while tokens.peek.text in _VIEW:
            word = tokens.take()
            if word.text in places:
                tokens.fail(word, f"{word.text} was given before, on line {places[word.text].line}")
            places[word.text] = word
            if word.text == "angle":
                self.view["angle"] = self._between(["angle"], 180.0)
                if not 0 < self.view["angle"][0] < 180:
                    tokens.fail(tokens.last, "angle must be between 0 and 180 degrees")
            elif word.text == "hither":
                self.view["hither"] = self._numbers(["hither"])
            elif word.text == "resolution":
                sides = [tokens.count(tokens.take(), f"the {x}") for x in ("width", "height")]
                if 0 in sides:
                    tokens.fail(word, "resolution must be above 0")
                self.view["resolution"] = [float(x) for x in sides]
            else:
                self.view[word.text] = self._numbers(_POINT)
        for name in ("from", "at", "up", "angle"):
            if name not in places:
                tokens.fail(tokens.peek, f"expected {name} of the view, got {tokens.peek}")
        eye, at, up = (np.array(self.view[name]) for name in ("from", "at", "up"))
        if not (at - eye).any():
            tokens.fail(places["at"], "at must not be where from is")
        forward = unit_vector(at - eye)
        if not up.any() or np.linalg.norm(np.cross(forward, unit_vector(up))) < 1e-9:
            tokens.fail(places["up"], "up must not be 0 0 0 or along the view")

    def _read_background(self, start: Token) -> None:
        self._once(start)
        self.background = self._between(_COLOR, inf)

    def _read_light(self, start: Token) -> None:
        row = self.tokens.rest((3, 6), "a light")
        position = [self.tokens.number(t, n) for t, n in zip(row, _POINT, strict=False)]
        color = [
            self.tokens.between(t, n, 0, inf) for t, n in zip(row[3:], _COLOR, strict=False)
        ]  # fmt: skip
        self.lights.append((position, color or None))

    def _read_fill(self, start: Token) -> None:
        color, (kd, ks) = self._between(_COLOR), self._between(("Kd", "Ks"))
        (shine,), (t,) = self._between(["Shine"], inf), self._between(["T"])
        (ior,) = self._numbers(["the index of refraction"])
        if t and ior not in (0, 1):
            self.say(start, f"index of refraction {ior:g}: rays go straight on")
        self.fills.append(Fill(start, color, kd, ks, shine, t, ior))

    def _fill(self, start: Token, fill: int | None = None) -> int:
        fill = len(self.fills) - 1 if fill is None else fill
        if fill < 0:
            self.tokens.fail(start, f"expected f, a fill, before the first {start.text.split()[0]}")
        return fill

    def _read_sphere(self, start: Token) -> None:
        self._add_sphere(start, self._numbers((*_POINT, "the radius")))

    def _add_sphere(self, start: Token, row: Iterable[float]) -> None:
        self.sphere_starts.append(start)
        self.sphere_numbers += row
        self.sphere_fills.append(len(self.fills) - 1)

    def _sphere_table(self) -> np.ndarray:
        """Returns centres and radii. **Raises:** `SceneError` at the first sphere that is none."""
        table = np.array(self.sphere_numbers).reshape(-1, 4)
        finite = (np.abs(table) <= np.finfo(self.tokens.dtype).max).all(axis=1)
        wrong = ~finite | (table[:, 3] == 0) | (np.array(self.sphere_fills, int) < 0)
        if wrong.any():
            k = int(np.argmax(wrong))
            self._fill(self.sphere_starts[k], self.sphere_fills[k])
            row = "X Y Z and the radius of a sphere must be finite in "
            message = "the radius of a sphere must not be 0"
            self.tokens.fail(
                self.sphere_starts[k], message if finite[k] else f"{row}{self.tokens.dtype}"
            )
        return table

    def _read_cone(self, start: Token) -> None:
        self._fill(start)
        for _ in range(2):
            self._numbers((*_POINT, "a radius"))
        self.say(start, "c, a cone or cylinder: left out")

    def _read_polygon(self, start: Token) -> None:
        tokens, fill = self.tokens, self._fill(start)
        count = tokens.count(tokens.take(), "the number of vertices")
        if count < 3:
            tokens.fail(tokens.last, f"a polygon has 3 vertices or more, got {count}")
        columns = _POINT if start.text == "p" else (*_POINT, "NX", "NY", "NZ")
        rows = [self._numbers(columns) for _ in range(count)]
        self.polygons.append(Polygon(start, fill, np.array(rows)))

    # the entities by their words; `v` stands first, as in files
    _ENTITIES = {  # noqa: RUF012
        "v": _read_view,
        "b": _read_background,
        "l": _read_light,
        "f": _read_fill,
        "s": _read_sphere,
        "p": _read_polygon,
        "pp": _read_polygon,
        "c": _read_cone,
    }


def read_nff(path: str | os.PathLike[str], dtype: Any = None) -> Scene:
    """Reads an NFF file; see the grammar above.

    **Arguments:** `dtype`: float32 or float64, by default JAX's default floating dtype.

    **Returns:** a scene of single rays (antialias 0).

    **Raises:** `SceneError`, with `file:line:column: what was expected, what stands there`.

    **Warns:** `SceneWarning` for each line that is not carried over as it is, and what was done.
    """
    name, dtype = os.fspath(path), scene_dtype(dtype)
    reader = NffReader(name, decode(name, read_bytes(path)), dtype).read()
    scene = _build(reader, dtype)
    for line, message in sorted(reader.warnings, key=lambda said: said[0]):
        warnings.warn(f"{name}:{line}: {message}", SceneWarning, stacklevel=3)
    return scene


def _build(reader: NffReader, dtype: np.dtype) -> Scene:
    """Builds the scene of what was read, and notes what it changes."""
    eye, at, up = (np.array(reader.view[name]) for name in ("from", "at", "up"))
    forward = unit_vector(at - eye)
    right = unit_vector(np.cross(forward, unit_vector(up)))
    rows = reader.view.get("resolution", [0.0, 0.0])[1]
    # the angle is between the centres of the outermost rows, the window between their outer edges
    outer = rows / (rows - 1) if rows > 1 else 1.0
    height = 2 * tan(radians(reader.view["angle"][0]) / 2) * outer * np.linalg.norm(at - eye)
    spheres = np.column_stack([reader.spheres[:, :3], np.abs(reader.spheres[:, 3])])
    for k in np.flatnonzero(reader.spheres[:, 3] < 0):
        token = reader.sphere_starts[k]
        if not np.linalg.norm(spheres[k, :3] - eye) < spheres[k, 3]:
            reader.tokens.fail(
                token, "only the inside of this sphere is visible, and the eye is outside of it"
            )
        reader.say(token, "negative radius: the sphere is visible from outside, too")
    positions = np.array([position for position, _ in reader.lights]).reshape(-1, 3)
    solid = np.concatenate([np.append(eye, 0)[None], np.pad(positions, ((0, 0), (0, 1))), spheres])
    planes = bounding_planes(reader.polygons, solid, reader.say)
    for polygon, _, _ in planes:
        if reader.fills[polygon.fill].t:
            reader.say(polygon.token, "T of a polygon: the plane is opaque")
    _say_hither(reader, eye, spheres, [(point, normal) for _, point, normal in planes])
    even = [1 / np.sqrt(max(len(reader.lights), 1))] * 3
    colors = [even if color is None else color for _, color in reader.lights]
    number = lambda values, *shape: np.asarray(values, dtype).reshape(-1, *shape)
    return Scene(
        Spheres(
            number(spheres[:, :3], 3), number(spheres[:, 3]),
            **_materials(reader.fills, reader.sphere_fills, dtype, kt=True),
        ),
        Lights(number(positions, 3), number(colors, 3)),
        camera_of(eye, at, right, forward, dtype, window=float(height)),
        Planes(
            number([point for _, point, _ in planes], 3),
            number([normal for _, _, normal in planes], 3),
            **_materials(reader.fills, [p.fill for p, _, _ in planes], dtype),
        ),
        background=np.asarray(reader.background, dtype),
    )  # fmt: skip


def _materials(
    fills: list[Fill], chosen: list[int], dtype: np.dtype, *, kt: bool = False
) -> dict[str, Any]:
    """Returns the materials of objects by the numbers of their fills."""
    columns = {
        "color": [fill.color for fill in fills],
        "kd": [fill.kd for fill in fills],
        "ks": [fill.ks for fill in fills],
        "exponent": [fill.shine for fill in fills],
        "kgr": [fill.ks for fill in fills],
    }
    if kt:
        columns["kt"] = [fill.t for fill in fills]
    which = np.array(chosen, int)
    tables = {name: np.array(values, dtype)[which] for name, values in columns.items() if fills}
    return {"ka": np.zeros(len(which), dtype), **tables}


def _say_hither(reader: NffReader, eye: np.ndarray, spheres: np.ndarray, planes: list) -> None:
    """Notes a plane of clipping before the eye, if it may clip anything."""
    (hither,) = reader.view.get("hither", [0.0])
    near = np.linalg.norm(spheres[:, :3] - eye, axis=1) - spheres[:, 3]
    heights = [abs((eye - point) @ normal) for point, normal in planes]
    if min([*near, *heights], default=inf) < hither:
        line = reader.given["v"]
        reader.warnings.append((line, f"hither {hither:g}: nothing is clipped before the eye"))
