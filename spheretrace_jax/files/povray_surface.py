"""Surfaces of POV-Ray's objects, read: pigments and finishes."""

from dataclasses import dataclass, field

import numpy as np

from ..base.types import Highlight
from .povray_tokens import PovrayTokens
from .tokens import Token

_SHARP = 1e9  # roughness from which POV-Ray's highlight is constant, exponent 0
_FINISH = ("ambient", "diffuse", "phong", "phong_size", "specular", "roughness", "reflection")


@dataclass
class Surface:
    """How an object of POV-Ray looks, by default as POV-Ray's objects do."""

    color: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    kt: float = 0.0
    image: str = ""  #: name of a declared bitmap
    other_color: list[float] | None = None  #: of a checker
    squares: np.ndarray | None = None  #: the checker's axes and its origin, rows
    ambient: float = 0.1
    diffuse: float = 0.6
    ks: float = 0.0
    exponent: float = 20.0  #: as `Spheres` has it where nothing shows it
    highlight: Highlight | None = None
    kgr: float = 0.0


def read_texture(tokens: PovrayTokens, surface: Surface) -> None:
    """Reads a block of `pigment` and `finish` after `texture`."""
    opened = tokens.expect("{")
    while tokens.inside(opened):
        if not read_surface_word(tokens, surface):
            tokens.take()
            tokens.fail_unknown(tokens.last, "a texture", ("pigment", "finish", "}"))


def read_surface_word(tokens: PovrayTokens, surface: Surface) -> bool:
    """Reads a `texture`, `pigment` or `finish`, if it stands next. **Returns:** whether it did."""
    readers = {"texture": read_texture, "pigment": _read_pigment, "finish": _read_finish}
    read = readers.get(tokens.peek.text)
    if read is not None:
        tokens.take()
        read(tokens, surface)
    return read is not None


def _read_pigment(tokens: PovrayTokens, surface: Surface) -> None:
    """Reads a colour, a checker of two, or a bitmap around a sphere."""
    tokens.expect("{")
    if tokens.accept("checker"):
        surface.color, _ = tokens.color()
        tokens.accept(",")
        surface.other_color, _ = tokens.color()
        surface.squares = np.array([*np.eye(3), np.zeros(3)])
        if tokens.accept("matrix"):
            surface.squares = _matrix(tokens)
    elif tokens.accept("Wrapped"):
        tokens.expect("(")
        surface.image = tokens.take().text
        numbers = []
        while tokens.accept(","):
            numbers.append(tokens.scalar())
        tokens.expect(")")
        if len(numbers) != 6:
            tokens.fail(tokens.last, f"Wrapped has a name and 6 numbers, got {len(numbers)}")
        surface.color, surface.kt = numbers[2:5], _part(tokens, tokens.last, numbers[5])
        if tokens.accept("translate"):
            tokens.vector("a translation")  # to the sphere's centre
    else:
        start = tokens.peek
        surface.color, kt = tokens.color()
        surface.kt = _part(tokens, start, kt)
    if not tokens.accept("}"):
        tokens.take()
        tokens.fail_spelling(tokens.last, "the end of the pigment, }")


def _matrix(tokens: PovrayTokens) -> np.ndarray:
    """Reads POV-Ray's matrix: three axes and the origin."""
    opened = tokens.expect("<")
    numbers = [tokens.scalar()]
    while tokens.accept(","):
        numbers.append(tokens.scalar())
    tokens.expect(">")
    if len(numbers) != 12:
        tokens.fail(opened, f"a matrix has 12 numbers, got {len(numbers)}")
    return np.array(numbers).reshape(4, 3)


def _part(tokens: PovrayTokens, token: Token, kt: float) -> float:
    if not 0 <= kt < 1:
        tokens.fail(token, f"the transmitted part must be at least 0 and below 1, got {kt:g}")
    return kt


def _read_finish(tokens: PovrayTokens, surface: Surface) -> None:
    """Reads the coefficients of a surface."""
    opened = tokens.expect("{")
    numbers: dict[str, float] = {}
    place: dict[str, Token] = {}
    while tokens.inside(opened):
        word = tokens.take()
        if word.text not in _FINISH:
            tokens.fail_unknown(word, "a finish", (*_FINISH, "}"))
        braces = word.text == "reflection" and tokens.accept("{")
        (red, *others), _ = tokens.color()
        if any(x != red for x in others):
            tokens.fail(word, f"{word.text} must be a number: colours are those of pigments")
        if red < 0:
            tokens.fail(word, f"{word.text} must be at least 0, got {red:g}")
        if braces:
            tokens.expect("}", f"after the number of the {word.text}")
        numbers[word.text], place[word.text] = red, word
    surface.ambient = numbers.get("ambient", surface.ambient)
    surface.diffuse = numbers.get("diffuse", surface.diffuse)
    surface.kgr = numbers.get("reflection", surface.kgr)
    phong, specular = numbers.get("phong", 0.0), numbers.get("specular", 0.0)
    if phong and specular:
        tokens.fail(place["specular"], "a surface has one highlight, phong or specular, not both")
    if phong:
        surface.ks, surface.highlight = phong, "phong"
        surface.exponent = numbers.get("phong_size", 40.0)
    elif specular:
        roughness = numbers.get("roughness", 0.05)
        if roughness == 0:
            tokens.fail(place["roughness"], "roughness must be above 0")
        constant = roughness >= _SHARP
        surface.ks, surface.highlight = specular, None if constant else "blinn"
        surface.exponent = 0.0 if constant else 1 / roughness
