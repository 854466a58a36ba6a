"""Words of POV-Ray's language, and its expressions: numbers, vectors and colours."""

import re
from collections.abc import Iterator
from math import pi
from typing import NoReturn

import numpy as np

from .tokens import Token, Tokens

#: A number, or the components of a vector or colour.
Value = float | tuple[float, ...]

_SKIPPED = re.compile(r"[^\S\r\n]+|//[^\r\n]*")
_NEWLINE = re.compile(r"\r\n|\r|\n")
_WORD = re.compile(
    r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|#?[^\W\d]\w*|\"[^\"\r\n]*\"?|[^\w\s]|\S", re.ASCII
)
_COMMENT = re.compile(r"/\*|\*/|\r\n|\r|\n")

#: How many brackets may be open at once, so that no file ends Python's stack.
_DEEPEST = 20

AXES: dict[str, Value] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
#: Colours' words: how many components each has, and which of them is the transmitted part.
COLORS = {"rgb": (3, None), "rgbt": (4, 3), "rgbf": (4, 3), "rgbft": (5, 4)}


class PovrayTokens(Tokens):
    """The words of a POV-Ray file; block comments may hold others."""

    def __init__(self, name: str, text: str, dtype: np.dtype):
        self.names: dict[str, Value] = {"pi": pi, **AXES}
        self.used: set[str] = set()  # names that were looked up
        self._depth = 0
        super().__init__(name, text, dtype)

    def scan(self, text: str) -> Iterator[Token]:
        """Yields all words of a text, then empty ones without end."""
        at, line, start = 0, 1, 0
        while at < len(text):
            if match := _SKIPPED.match(text, at):
                at = match.end()
            elif match := _NEWLINE.match(text, at):
                at = start = match.end()
                line += 1
            elif text.startswith("/*", at):
                opened, depth = Token("/*", line, at - start + 1), 0
                for match in _COMMENT.finditer(text, at):
                    if match[0] in ("/*", "*/"):
                        depth += 1 if match[0] == "/*" else -1
                        if depth == 0:
                            break
                    else:
                        line, start = line + 1, match.end()
                if depth:
                    self.fail(opened, "this comment has no end, */")
                assert match is not None
                at = match.end()
            else:
                match = _WORD.match(text, at)
                assert match is not None
                yield Token(match[0], line, at - start + 1)
                at = match.end()
        while True:
            yield Token("", line, len(text) - start + 1)

    def expect(self, word: str, where: str = "") -> Token:
        """Takes a word. **Raises:** `SceneError` for another one."""
        token = self.take()
        if token.text != word:
            self.fail_spelling(token, word + (f" {where}" if where else ""))
        return token

    def accept(self, *words: str) -> bool:
        """Takes the next word if it is one of `words`. **Returns:** whether it was."""
        if self.peek.text in words:
            self.take()
            return True
        return False

    def inside(self, opened: Token) -> bool:
        """Tells whether a block goes on; takes the `}` that ends it.

        **Arguments:** `opened`: the block's `{`, for the error.

        **Raises:** `SceneError` if the file ends first.
        """
        if self.accept("}"):
            return False
        if not self.peek.text:
            self.fail(opened, "this { has no }")
        return True

    def skip_block(self) -> None:
        """Skips a block from its `{` to the matching `}`, with all that is in it."""
        opened, depth = self.expect("{"), 1
        while depth:
            token = self.take()
            if not token.text:
                self.fail(opened, "this { has no }")
            depth += {"{": 1, "}": -1}.get(token.text, 0)

    def expression(self) -> Value:
        """Reads a sum of products. **Raises:** `SceneError`."""
        self._depth += 1
        if self._depth > _DEEPEST:
            self.fail(self.peek, f"more than {_DEEPEST} brackets are open")
        value = self._product()
        while self.peek.text in ("+", "-"):
            sign = self.take()
            value = self._combine(sign, value, self._product())
        self._depth -= 1
        return value

    def _product(self) -> Value:
        value = self._factor()
        while self.peek.text in ("*", "/"):
            sign = self.take()
            value = self._combine(sign, value, self._factor())
        return value

    def _factor(self) -> Value:
        negative = False
        while self.peek.text in ("+", "-"):
            negative ^= self.take().text == "-"
        value = self._atom()
        if not negative:
            return value
        return tuple(-x for x in value) if isinstance(value, tuple) else -value

    def _atom(self) -> Value:
        token = self.take()
        text = token.text
        if text[:1].isdigit() or (text[:1] == "." and len(text) > 1):
            return self.number(token, "a number")
        if text == "<":
            parts = [self.scalar()]
            while self.accept(","):
                parts.append(self.scalar())
            self.expect(">", f"or a comma, for the < on line {token.line}")
            if not 2 <= len(parts) <= 5:
                self.fail(token, f"a vector has 2 to 5 components, got {len(parts)}")
            return tuple(parts)
        if text == "(":
            value = self.expression()
            self.expect(")", f"for the ( on line {token.line}")
            return value
        if text in COLORS:
            return self._components(token, COLORS[text][0])
        if text in self.names:
            self.used.add(text)
            return self.names[text]
        self.fail_spelling(token, "a number, a vector or a name declared before")

    def _components(self, token: Token, count: int) -> Value:
        value = self.expression()
        if not isinstance(value, tuple):
            return (value,) * count
        if len(value) != count:
            self.fail(token, f"{token.text} has {count} components, got {len(value)}")
        return value

    def _combine(self, sign: Token, a: Value, b: Value) -> Value:
        """Computes `a sign b`, component by component; a number stands for equal components."""
        if not isinstance(a, tuple) and not isinstance(b, tuple):
            return self._compute(sign, a, b)
        long = max(len(v) for v in (a, b) if isinstance(v, tuple))
        parts = [v if isinstance(v, tuple) else (v,) * long for v in (a, b)]
        if len(parts[0]) != len(parts[1]):
            self.fail(sign, f"vectors of {len(parts[0])} and {len(parts[1])} components")
        return tuple(self._compute(sign, x, y) for x, y in zip(*parts, strict=True))

    def _compute(self, sign: Token, a: float, b: float) -> float:
        if sign.text == "/" and b == 0:
            self.fail(sign, "a division by 0")
        value = {"+": a + b, "-": a - b, "*": a * b}[sign.text] if sign.text != "/" else a / b
        if not abs(value) <= np.finfo(self.dtype).max:
            self.fail(sign, f"a result that is not finite in {self.dtype}")
        return value

    def scalar(self, what: str = "a number", low: float = -np.inf, high: float = np.inf) -> float:
        """Reads a number from `low` to `high`. **Raises:** `SceneError`."""
        token = self.peek
        value = self.expression()
        if isinstance(value, tuple):
            self.fail(token, f"expected {what}, got a vector")
        if not low <= value <= high:
            limits = f"at least {low:g}" if high == np.inf else f"in {low:g}..{high:g}"
            self.fail(token, f"{what} must be {limits}, got {value:g}")
        return value

    def vector(self, what: str) -> np.ndarray:
        """Reads three numbers; one stands for equal ones. **Raises:** `SceneError`."""
        token = self.peek
        value = self.expression()
        if isinstance(value, tuple) and len(value) != 3:
            self.fail(token, f"expected {what}, three numbers, got {len(value)}")
        return np.array(value) if isinstance(value, tuple) else np.full(3, value)

    def color(self) -> tuple[list[float], float]:
        """Reads a colour: `rgb <...>`, `rgbt <...>`, a vector, or a declared name.

        **Returns:** red, green and blue, and what is transmitted.
        """
        self.accept("color", "colour")
        token = self.peek
        through = COLORS.get(token.text, (0, None))[1]
        value = self.expression()
        value = value if isinstance(value, tuple) else (value,) * 3
        if len(value) not in (3, 4, 5):
            self.fail(token, f"expected a colour, got {len(value)} numbers")
        transmitted = value[through] if through is not None else value[-1] * (len(value) > 3)
        return list(value[:3]), transmitted

    def fail_unknown(self, token: Token, where: str, known: tuple[str, ...]) -> NoReturn:
        """Fails at a word that is none of those known. **Raises:** `SceneError`."""
        self.fail_spelling(token, f"one of {', '.join(known)} in {where}")
