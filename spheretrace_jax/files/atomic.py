"""Atomic writing: files are written whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yields a temporary file in the folder of `path`, which replaces `path` on success.

    The temporary file has the ending of `path`.

    **Raises:** `OSError`, which names `path`, if the file cannot be written.
    """
    check_target(path)
    target = Path(os.path.realpath(path))  # a link stays a link
    # named before creation, so that no interrupt leaves the file behind
    temporary = target.parent / f".{target.stem[:32]}.{uuid4().hex}{target.suffix}"
    try:
        temporary.touch(exist_ok=False)
        yield temporary
        temporary.replace(target)
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, os.fspath(path)) from error
    finally:
        temporary.unlink(missing_ok=True)


def check_target(path: str | os.PathLike[str]) -> None:
    """Checks early that a file can be written to `path`, before its content is computed.

    **Raises:** `OSError` for missing and write-protected folders, and for folders, devices and
    pipes.
    """
    path = Path(path)
    folder = Path(os.path.realpath(path)).parent
    if path.is_dir():
        raise IsADirectoryError(f"{path}: expected a file to write, this is a folder")
    if path.exists() and not path.is_file():
        raise OSError(f"{path}: expected a file to write, this is a device or a pipe")
    if not folder.is_dir():
        raise FileNotFoundError(f"{path}: there is no folder {path.parent} to write to")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(f"{path}: the folder {path.parent} cannot be written to")


def reserve(file: Path, size: int) -> None:
    """Reserves `size` bytes on the disk, for libraries that cannot handle a full disk.

    **Raises:** `OSError` if the disk is full.
    """
    if hasattr(os, "posix_fallocate"):  # not on macOS and Windows
        with open(file, "r+b") as opened:
            os.posix_fallocate(opened.fileno(), 0, size)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Writes a text file atomically."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
