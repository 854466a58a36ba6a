"""Scene text: the lecture's scene file, read. (`scene_writer.py` writes it.)

The grammar, with `//` comments to the end of the line and any white space between words:

    theta phi mu distance                 view: radians and world units, mu >= 0, distance > 0
    antialias                             0 or 1
    numlights                             then as many lines:
      Lx Ly Lz [LR LG LB] [directional] [falloff DISTANCE]
                                            a light's position and colour, white by default;
                                            of a directional light the direction toward it;
                                            with a fall-off it has its colour at DISTANCE, and at
                                            r that times (DISTANCE / r)^2
    numspheres                            then as many lines:
      cx cy cz radius R G B ka kd ks specExp kgr kt pic [ior]

and, in any order, lines that start with a keyword:

    texture FILE                          a picture; `pic` 1, 2, ... name them in their order
    background R G B                      the colour seen by rays that meet nothing
    background_image FILE                 a picture around the scene in its place: the starry sky
    back_plane R G B ka kd                the view plane made visible
    plane px py pz nx ny nz R G B ka kd ks specExp kgr [ior N] [checker R G B size]
                                          a plane through p with normal n, any number of them
    window HEIGHT                         of the window on the view plane, 512 by default
    look_at X Y Z                         what the eye looks at and turns around, 0 0 0 by default
    roll ANGLE                            of the camera about its axis, radians, 0 by default
    principal_point X Y                   of the axis: right and down of the picture's centre, in
                                          heights of the picture, 0 0 by default
    pixel_aspect A                        width of a pixel / its height, 1 by default
    orthographic                          rays are parallel, the window is of the world's size

Colours and ka, kd, ks, kgr, kt are in 0..1 (a light's colour only >= 0), specExp and DISTANCE >= 0,
ior and N >= 1 (1 by default: no coat), radius, HEIGHT, A and size > 0, normals and directions not
0. A directional light has no fall-off, and DISTANCE 0 is none. FILE is relative to the scene file;
a name with spaces stands in double quotes. Every lecture file is valid: the first six numbers may
stand on one line or many, and each light and sphere has one line.
"""

import os
import warnings
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ..base.errors import InputError, PictureError, SceneError, SceneWarning, printable
from ..scene.arrays import precision
from ..scene.camera import Camera
from ..scene.lights import Lights
from ..scene.planes import BackPlane, Planes
from ..scene.scene import Scene
from ..scene.spheres import Spheres
from ..scene.texture import Texture
from .tokens import Token, Tokens, decode

_COLOR = ("R", "G", "B")
_POSITION = ("Lx", "Ly", "Lz")
_LIGHT_WORDS = {"directional": 0, "falloff": 1}
SPHERE_COLUMNS = ("cx", "cy", "cz", "radius", *_COLOR, "ka", "kd", "ks", "specExp", "kgr", "kt")
_PLANE = ("px", "py", "pz", "nx", "ny", "nz", *_COLOR, "ka", "kd", "ks", "specExp", "kgr")
_CAMERA = {
    "look_at": ("X", "Y", "Z"),
    "roll": ("ANGLE",),
    "principal_point": ("X", "Y"),
    "pixel_aspect": ("A",),
}
_UNIT = {*_COLOR, "ka", "kd", "ks", "kgr", "kt"}
DEFAULT_WINDOW = 512.0


def load_scene(path: str | os.PathLike, dtype: Any = None) -> Scene:
    """Reads a scene file; see `spheretrace_jax.files.scene_text` for its grammar.

    **Arguments:** `dtype`: float32 or float64, by default JAX's default floating dtype.

    **Raises:** `SceneError`, with `file:line:column: what was expected, what stands there`.
    **Warns:** `SceneWarning` where ka + kd > 1, which the lecture rules out.
    """
    name, dtype = os.fspath(path), _dtype(dtype)
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise SceneError(f"{name}: cannot read the scene: {error.strerror}") from None
    return parse_scene(data, name, Path(path).parent, dtype)


def parse_scene(
    data: bytes, name: str, folder: str | os.PathLike = ".", dtype: Any = None
) -> Scene:
    """Reads the content of a scene file.

    **Arguments:** `name`: of the file, for messages. `folder`: to which textures are relative.
    `dtype`, raises, warns: as `load_scene`.
    """
    dtype = _dtype(dtype)
    reader = _Reader(name, decode(name, data), dtype).read()
    for message in reader.warnings:
        warnings.warn(message, SceneWarning, stacklevel=3)
    return _build(reader, Path(folder), dtype)


def _dtype(dtype: Any) -> np.dtype:
    """Returns a scene's dtype, by default JAX's. **Raises:** `InputError`."""
    default = jax.dtypes.canonicalize_dtype(float)
    chosen = precision(default if dtype is None else dtype)
    if chosen == np.float64 and default != np.float64:
        raise InputError(
            "a float64 scene needs 64-bit JAX: jax.config.update('jax_enable_x64', True)"
        )
    return chosen


def check_text(name: str, text: str, dtype: np.dtype) -> None:
    """Checks a scene's text, without its textures. **Raises:** `SceneError`."""
    _Reader(name, text, dtype).read()


def _camera_line(name: str) -> Any:
    """Returns the method that reads a keyword's numbers of the camera."""

    def read(reader: "_Reader", row: list[Token]) -> None:
        values = reader._values(row, _CAMERA[name])
        reader.camera[name] = values if len(values) > 1 else values[0]

    return read


class _Reader:
    """The tables of a scene file, each number checked, without the textures' pixels."""

    def __init__(self, name: str, text: str, dtype: np.dtype):
        self.tokens = Tokens(name, text, dtype)
        self.files: list[tuple[Token, str]] = []
        self.sky: tuple[Token, str] | None = None
        self.planes: list[list[float]] = []
        self.background = [0.0, 0.0, 0.0]
        self.back_plane: list[float] | None = None
        self.window = DEFAULT_WINDOW
        self.camera: dict[str, Any] = {}
        self.pics: list[tuple[Token, int]] = []
        self.warnings: list[str] = []

    @np.errstate(over="ignore")  # numbers too large for float32 become inf, and are refused
    def read(self) -> "_Reader":
        """Reads the whole file. **Returns:** self."""
        tokens = self.tokens
        if not tokens.peek.text:
            tokens.fail(tokens.peek, "expected a scene, starting with theta, got an empty file")
        view = {"theta": -np.inf, "phi": -np.inf, "mu": 0.0}
        self.view = [tokens.between(tokens.take(), name, low, np.inf) for name, low in view.items()]
        self.view.append(tokens.positive(tokens.take(), "distance"))
        flag = tokens.take()
        self.antialias = tokens.count(flag, "antialias")
        if self.antialias > 1:
            tokens.fail(flag, f"antialias must be 0 or 1, got {flag}")
        rows = self._rows("numlights", "light", (3, 6), _LIGHT_WORDS)
        self.lights = [self._light(row) for row in rows]
        self.spheres = [self._sphere(row) for row in self._rows("numspheres", "sphere", (14, 15))]
        self._keywords()
        for token, pic in self.pics:
            if pic > len(self.files):
                tokens.fail(
                    token, f"pic must be in 0..{len(self.files)}, the number of textures, got {pic}"
                )
        return self

    def _rows(
        self,
        count_name: str,
        row: str,
        counts: tuple[int, ...],
        words: dict[str, int] | None = None,
    ) -> Iterator[list[Token]]:
        """Yields the tokens of each row, as many rows as a count says.

        **Arguments:** `words`: those that may follow the columns of a row, and how many numbers
        come after each.
        """
        tokens = self.tokens
        token = tokens.take()
        count = tokens.count(token, count_name)
        tokens.end_line(f"{count_name} {count}")
        for i in range(count):
            name = f"{row} {i + 1} of {count}"
            if not tokens.peek.text or tokens.peek.text in self._KEYWORDS:
                tokens.fail(tokens.peek, f"expected {name}, got {tokens.peek}")
            yield [tokens.take(), *tokens.rest(counts, name, had=1, words=words)]

    def _light(self, row: list[Token]) -> tuple[list[float], bool]:
        """Reads a light, by default white: its numbers, and whether it is directional."""
        tokens, numbers = self.tokens, row
        words = {token.text: k for k, token in enumerate(row) if token.text in _LIGHT_WORDS}
        numbers = row[: min(words.values(), default=len(row))]
        values = [tokens.number(t, name) for t, name in zip(numbers, _POSITION, strict=False)]
        for token, name in zip(numbers[3:], ("LR", "LG", "LB"), strict=False):
            values.append(tokens.between(token, name, 0, np.inf))
        values = values if len(values) == 6 else [*values, 1.0, 1.0, 1.0]
        directional, falloff = "directional" in words, 0.0
        if "falloff" in words:
            token = row[words["falloff"] + 1]
            falloff = tokens.between(token, "DISTANCE", 0, np.inf)
            if directional and falloff:
                tokens.fail(row[words["falloff"]], "a directional light has no falloff")
        if directional and not any(values[:3]):
            tokens.fail(row[0], "the direction Lx Ly Lz of a directional light must not be 0 0 0")
        return [*values, falloff], directional

    def _sphere(self, row: list[Token]) -> list[float]:
        """Reads a sphere, and warns if ka + kd > 1."""
        values = self._values(row[:13], SPHERE_COLUMNS)
        ior = self._value(row[14], "ior") if len(row) == 15 else 1.0
        total = values[7] + values[8]
        if total > 1 + 1e-6:
            position = f"{self.tokens.name}:{row[7].line}:{row[7].column}"
            self.warnings.append(
                f"{position}: ka + kd is {total:.6g}, the lecture's rule is at most 1"
            )
        self.pics.append((row[13], self.tokens.count(row[13], "pic")))
        return [*values, ior]

    def _value(self, token: Token, name: str) -> float:
        """Reads a number within the range of its name."""
        if name in _UNIT:
            return self.tokens.between(token, name, 0, 1)
        if name == "specExp":
            return self.tokens.between(token, name, 0, np.inf)
        if name == "ior":
            return self.tokens.between(token, name, 1, np.inf)
        if name in ("radius", "size", "HEIGHT", "A"):
            return self.tokens.positive(token, name)
        return self.tokens.number(token, name)

    def _values(self, row: list[Token], names: tuple[str, ...]) -> list[float]:
        return [self._value(token, name) for token, name in zip(row, names, strict=True)]

    def _keywords(self) -> None:
        """Reads the lines that start with a keyword, up to the end of the file."""
        tokens = self.tokens
        seen: dict[str, int] = {}
        while (word := tokens.take()).text:
            if word.text not in self._KEYWORDS:
                known = ", ".join(self._KEYWORDS)
                n = len(self.spheres)
                after = "after 1 sphere" if n == 1 else f"after {n} spheres"
                tokens.fail_spelling(word, f"the end of the file {after}, or one of {known}")
            if word.text in seen and word.text not in ("texture", "plane"):
                tokens.fail(word, f"{word.text} was given before, on line {seen[word.text]}")
            seen[word.text] = word.line
            counts, read = self._KEYWORDS[word.text]
            read(self, tokens.rest(counts, word.text))

    def _file(self, token: Token) -> tuple[Token, str]:
        """Reads the name of a picture, without its quotes."""
        name = token.text
        if name.startswith('"'):
            if len(name) == 1 or not name.endswith('"'):
                self.tokens.fail(token, f"expected a closing quote, got {token}")
            name = name[1:-1]
        if not name:
            self.tokens.fail(token, f"expected the name of a picture, got {token}")
        return token, name

    def _texture(self, row: list[Token]) -> None:
        self.files.append(self._file(row[0]))

    def _background(self, row: list[Token]) -> None:
        self.background = self._values(row, _COLOR)

    def _background_image(self, row: list[Token]) -> None:
        self.sky = self._file(row[0])

    def _back_plane(self, row: list[Token]) -> None:
        self.back_plane = self._values(row, (*_COLOR, "ka", "kd"))

    def _plane(self, row: list[Token]) -> None:
        values = self._values(row[:14], _PLANE)
        if not any(values[3:6]):
            self.tokens.fail(row[3], "the normal nx ny nz of a plane must not be 0 0 0")
        options = {14: (), 16: ("ior",), 19: ("checker",), 21: ("ior", "checker")}[len(row)]
        for token, word in zip(row[14::2], options, strict=False):
            if token.text != word:
                self.tokens.fail(token, f"expected {word} or the end of the line, got {token}")
        ior = self._value(row[15], "ior") if "ior" in options else 1.0
        checker = [0.0, 0.0, 0.0, 0.0]
        if "checker" in options:
            checker = self._values(row[-4:], (*_COLOR, "size"))
        self.planes.append([*values, *checker, ior])

    def _window(self, row: list[Token]) -> None:
        (self.window,) = self._values(row, ("HEIGHT",))

    # the grammar of the keywords: the possible numbers of columns, and the method that reads them
    _KEYWORDS = {  # noqa: RUF012
        "texture": ((1,), _texture),
        "background": ((3,), _background),
        "background_image": ((1,), _background_image),
        "back_plane": ((5,), _back_plane),
        "plane": ((14, 16, 19, 21), _plane),
        "window": ((1,), _window),
        **{name: ((len(columns),), _camera_line(name)) for name, columns in _CAMERA.items()},
        "orthographic": ((0,), lambda self, _: self.camera.update(orthographic=True)),
    }


def _build(reader: _Reader, folder: Path, dtype: np.dtype) -> Scene:
    """Builds the scene of the reader, and reads its textures from the files."""

    def table(rows: list[list[float]], columns: int) -> np.ndarray:
        return np.asarray(rows, dtype).reshape(len(rows), columns)

    spheres = table(reader.spheres, 14)
    lights = table([numbers for numbers, _ in reader.lights], 7)
    directional = [far for _, far in reader.lights]
    planes, back = table(reader.planes, 19), reader.back_plane
    pics = [pic for _, pic in reader.pics]
    texture = partial(_read_texture, reader.tokens, folder)
    view = {n: x if x is True else np.asarray(x, dtype) for n, x in reader.camera.items()}
    return Scene(
        Spheres(
            spheres[:, :3],
            spheres[:, 3],
            spheres[:, 4:7],
            *spheres[:, 7:13].T,
            pic=pics,
            ior=spheres[:, 13],
        ),
        Lights(lights[:, :3], lights[:, 3:6], directional, lights[:, 6]),
        Camera(*(np.asarray(value, dtype) for value in (*reader.view, reader.window)), **view),
        Planes(
            planes[:, :3],
            planes[:, 3:6],
            planes[:, 6:9],
            *planes[:, 9:14].T,
            checker_color=planes[:, 14:17],
            checker_size=planes[:, 17],
            ior=planes[:, 18],
        ),
        textures=[texture(*file) for file in reader.files],
        background=np.asarray(reader.background, dtype),
        sky=None if reader.sky is None else texture(*reader.sky),
        back_plane=None
        if back is None
        else BackPlane(np.asarray(back[:3], dtype), *table([back], 5)[0, 3:]),
        antialias=reader.antialias,
    )


def _read_texture(tokens: Tokens, folder: Path, token: Token, name: str) -> Texture:
    """Reads the texture that `token` names. **Raises:** `SceneError` at the token."""
    from .images import read_texture

    file = os.path.abspath(folder / name)
    try:
        image = read_texture(file)
        if not np.isfinite(image).all():
            raise PictureError("it holds numbers that are nan or inf")
        return Texture(image, file)
    except PictureError as error:
        reason = str(error).removeprefix(f"{file}: ")
        tokens.fail(token, f"expected a picture, got {printable(name)}: {reason}")
