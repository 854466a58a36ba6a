"""`SceneReader`: the tables of a scene file, each number checked where it stands."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from .tokens import Token, Tokens

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


def _camera_line(name: str) -> Any:
    """Returns the method that reads a keyword's numbers of the camera."""

    def read(reader: "SceneReader", row: list[Token]) -> None:
        values = reader.values(row, _CAMERA[name])
        reader.camera[name] = values if len(values) > 1 else values[0]

    return read


class SceneReader:
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
    def read(self) -> "SceneReader":
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
        values = self.values(row[:13], SPHERE_COLUMNS)
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

    def values(self, row: list[Token], names: tuple[str, ...]) -> list[float]:
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
        self.background = self.values(row, _COLOR)

    def _background_image(self, row: list[Token]) -> None:
        self.sky = self._file(row[0])

    def _back_plane(self, row: list[Token]) -> None:
        self.back_plane = self.values(row, (*_COLOR, "ka", "kd"))

    def _plane(self, row: list[Token]) -> None:
        values = self.values(row[:14], _PLANE)
        if not any(values[3:6]):
            self.tokens.fail(row[3], "the normal nx ny nz of a plane must not be 0 0 0")
        options = {14: (), 16: ("ior",), 19: ("checker",), 21: ("ior", "checker")}[len(row)]
        for token, word in zip(row[14::2], options, strict=False):
            if token.text != word:
                self.tokens.fail(token, f"expected {word} or the end of the line, got {token}")
        ior = self._value(row[15], "ior") if "ior" in options else 1.0
        checker = [0.0, 0.0, 0.0, 0.0]
        if "checker" in options:
            checker = self.values(row[-4:], (*_COLOR, "size"))
        self.planes.append([*values, *checker, ior])

    def _window(self, row: list[Token]) -> None:
        (self.window,) = self.values(row, ("HEIGHT",))

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
