"""Standard input and output: files that the command line names `-`."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ..base.errors import InputError, PictureError

#: The name of standard input where a file is read, of standard output where one is written.
STANDARD = Path("-")


def read_scene(path: Path, dtype: Any = None):
    """Reads a scene file, or the lecture's scene text from standard input.

    **Arguments, raises:** as `load_scene`. Textures are then relative to the current folder.
    """
    from ..files import formats
    from ..files.scene_text import parse_scene

    if path != STANDARD:
        return formats.load_scene(path, dtype)
    return parse_scene(sys.stdin.buffer.read(), "standard input", ".", dtype)


@contextmanager
def file_to_read(path: Path) -> Iterator[Path]:
    """Yields the file to read: `path`, or a temporary one with the content of standard input."""
    if path != STANDARD:
        yield path
        return
    with TemporaryDirectory() as folder:
        file = Path(folder) / "standard input"
        file.write_bytes(sys.stdin.buffer.read())
        try:
            yield file
        except PictureError as error:
            raise PictureError(str(error).replace(f"{folder}/", "")) from None


def check_one_reader(*paths: Path) -> None:
    """Checks that one file at most is standard input. **Raises:** `InputError`."""
    if paths.count(STANDARD) > 1:
        raise InputError("only one file can be read from standard input (-)")


@contextmanager
def file_to_write(path: Path, ending: str, *, binary: bool = False) -> Iterator[Path]:
    """Yields the file to write: `path`, or a temporary one that then goes to standard output.

    **Arguments:** `ending`: of the temporary file, with its dot. `binary`: whether the content is
    none that a terminal can show.

    **Raises:** `InputError` for binary content on a terminal.
    """
    if path != STANDARD:
        yield path
        return
    if binary and sys.stdout.isatty():
        raise InputError("standard output is a terminal: send the picture to a file or a program")
    with TemporaryDirectory() as folder:
        file = Path(folder) / f"standard output{ending}"
        yield file
        print(end="", flush=True)
        sys.stdout.buffer.write(file.read_bytes())
        sys.stdout.buffer.flush()


def say(output: Path, *lines: object) -> None:
    """Prints lines, beside a file that goes to standard output as messages."""
    print(*lines, sep="\n", file=sys.stderr if output == STANDARD else sys.stdout)
