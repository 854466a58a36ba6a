"""Tokens: the words of a text file with their positions, and numbers in ranges."""

import codecs
import os
import re
import unicodedata
from collections.abc import Iterator
from math import isfinite
from pathlib import Path
from typing import NoReturn

import numpy as np

from ..base.errors import SceneError, printable

_WORD = re.compile(
    r'//[^\r\n]*|(?P<newline>\r\n|\r|\n)|(?P<word>"[^"\r\n]*"?|(?:[^\s"/]+|/(?!/))+)'
)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_COUNT = re.compile(r"\+?\d{1,18}", re.ASCII)
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f]")


class Token:
    """A word of a file, with its line and column, both from 1."""

    __slots__ = ("column", "line", "text")

    def __init__(self, text: str, line: int, column: int):
        self.text, self.line, self.column = text, line, column

    def __str__(self) -> str:
        if not self.text:
            return "the end of the file"
        if len(self.text) <= 32:
            return printable(self.text)
        return f"{printable(self.text[:24])}... ({len(self.text)} characters)"


class Tokens:
    """The words of a text, one by one; `//` starts a comment up to the end of the line."""

    pattern = _WORD  #: what is a comment, a `newline` or a `word`

    def __init__(self, name: str, text: str, dtype: np.dtype):
        self.name, self.dtype = name, dtype
        self._words = self.scan(text)
        self.peek = next(self._words)  # the next token; its text is empty at the end of the file
        self.last = Token("", 1, 1)  # the latest token taken

    def scan(self, text: str) -> Iterator[Token]:
        """Yields all words of a text, then empty ones without end."""
        line, start = 1, 0
        for match in self.pattern.finditer(text):
            if match["newline"]:
                line, start = line + 1, match.end()
            elif match["word"]:
                yield Token(match["word"], line, match.start() - start + 1)
        while True:
            yield Token("", line, len(text) - start + 1)

    def take(self) -> Token:
        """Takes the next token."""
        self.last, self.peek = self.peek, next(self._words)
        return self.last

    def fail(self, token: Token, message: str) -> NoReturn:
        """Fails at a token. **Raises:** `SceneError` with the position of `token`."""
        raise SceneError(f"{self.name}:{token.line}:{token.column}: {message}")

    def fail_spelling(self, token: Token, wanted: str) -> NoReturn:
        """Fails at a token that is not what was expected.

        Characters that look like others, or like none, are named: a minus sign of typesetting.

        **Raises:** `SceneError` with the position of the first such character, or of `token`.
        """
        for place, character in enumerate(token.text):
            if not character.isascii():
                name = unicodedata.name(character, "a control character")
                odd = Token(token.text, token.line, token.column + place)
                self.fail(
                    odd, f"expected {wanted}, got {token} with U+{ord(character):04X} ({name})"
                )
        self.fail(token, f"expected {wanted}, got {token}")

    @property
    def line_ends(self) -> bool:
        """Tells whether the latest token is the last one of its line."""
        return not self.peek.text or self.peek.line != self.last.line

    def end_line(self, row: str) -> None:
        """Expects the end of the line after a `row`. **Raises:** `SceneError` otherwise."""
        if not self.line_ends:
            self.fail(self.peek, f"expected the end of the line after {row}, got {self.peek}")

    def rest(
        self,
        counts: tuple[int, ...],
        row: str,
        had: int = 0,
        words: dict[str, int] | None = None,
    ) -> list[Token]:
        """Takes the remaining tokens of the line.

        **Arguments:** `counts`: the possible numbers of columns of the `row`. `had`: the number of
        columns taken before. `words`: those that may follow the columns, each once, and how many
        numbers come after each.

        **Raises:** `SceneError` for other numbers of columns.
        """
        tokens, most, words = [], max(counts) - had, words or {}
        while len(tokens) < most and not self.line_ends and self.peek.text not in words:
            tokens.append(self.take())
        if not words or self.peek.text not in words:
            self.end_line(row)
        if had + len(tokens) not in counts:
            end = Token("", self.last.line, self.last.column + len(self.last.text))
            wanted = "1 column" if counts == (1,) else f"{' or '.join(map(str, counts))} columns"
            self.fail(end, f"expected {wanted} for {row}, got {had + len(tokens)}")
        return [*tokens, *self._words_after(words, row)]

    def _words_after(self, words: dict[str, int], row: str) -> list[Token]:
        """Takes the words that follow the columns of a row, and their numbers."""
        tokens, left = [], dict(words)
        while left and not self.line_ends:
            if self.peek.text not in left:
                self.fail_spelling(self.peek, f"{' or '.join(left)} or the end of the line")
            word = self.take()
            tokens.append(word)
            for _ in range(left.pop(word.text)):
                if self.line_ends:
                    self.fail(self.peek, f"expected a number after {word}, got {self.peek}")
                tokens.append(self.take())
        self.end_line(row)
        return tokens

    def number(self, token: Token, name: str) -> float:
        """Reads a finite number, rounded to the file's dtype. **Raises:** `SceneError`."""
        if len(token.text) > 400 or not _NUMBER.fullmatch(token.text):
            self.fail_spelling(token, f"{name}, a number")
        value = float(self.dtype.type(float(token.text)))
        if not isfinite(value):
            self.fail(token, f"{name} must be finite in {self.dtype}, got {token}")
        return value

    def between(self, token: Token, name: str, low: float | int, high: float | int) -> float:
        """Reads a number from `low` to `high`. **Raises:** `SceneError`."""
        value = self.number(token, name)
        if not low <= value <= high:
            limits = f"at least {low:g}" if high == np.inf else f"in {low:g}..{high:g}"
            self.fail(token, f"{name} must be {limits}, got {token}")
        return value

    def positive(self, token: Token, name: str) -> float:
        """Reads a number above 0. **Raises:** `SceneError`."""
        value = self.number(token, name)
        if not value > 0:
            self.fail(token, f"{name} must be greater than 0, got {token}")
        return value

    def count(self, token: Token, name: str) -> int:
        """Reads a whole number from 0. **Raises:** `SceneError`."""
        if not _COUNT.fullmatch(token.text):
            self.fail_spelling(token, f"{name}, a whole number from 0")
        return int(token.text)


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """Reads a scene's file. **Raises:** `SceneError`, also for files that cannot be opened."""
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise SceneError(f"{os.fspath(path)}: cannot read the scene: {error.strerror}") from None


def decode(name: str, data: bytes) -> str:
    """Decodes a file in UTF-8; comments may be in Latin-1.

    **Raises:** `SceneError` for UTF-16, UTF-32 and binary data.
    """
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) or _is_wide(data):
        raise SceneError(
            f"{name}:1:1: expected text in UTF-8, got UTF-16 or UTF-32: save the file as UTF-8"
        )
    control = _CONTROL.search(data)
    if control:
        line = data.count(b"\n", 0, control.start()) + 1
        column = control.start() - data.rfind(b"\n", 0, control.start())
        byte = data[control.start()]
        raise SceneError(
            f"{name}:{line}:{column}: expected text, got binary data (byte 0x{byte:02x})"
        )
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _is_wide(data: bytes) -> bool:
    """Tells whether every other byte of a text's start is 0, as in UTF-16 and UTF-32."""
    start = data[:64]
    return len(start) > 1 and any(not any(part) for part in (start[::2], start[1::2]))
