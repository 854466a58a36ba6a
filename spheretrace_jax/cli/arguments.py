"""Arguments that several commands of the program share, and how their words are read."""

import math
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from tyro.conf import FlagCreatePairsOff, Positional, arg

from ..base.errors import InputError
from ..base.types import Highlight

SceneFile = Positional[
    Annotated[Path, arg(metavar="SCENE", help="the scene file, - for standard input")]
]
Dtype = Annotated[Literal["float32", "float64"], arg(help="the precision")]
HighlightModel = Annotated[Highlight, arg(help="(R.V)^n or (H.N)^n")]
_BOUNCES = arg(metavar="N", help="reflections and transmissions at most")
Bounces = Annotated[int, _BOUNCES]
OptionalBounces = Annotated[int | None, _BOUNCES]
Size = Annotated[str, arg(metavar="WxH", help="width and height in pixels")]
Samples = Annotated[
    int, arg(metavar="K", help="each pixel is the mean of K x K parts, as the antialias flag says")
]
CacheFolder = Annotated[
    Path | None,
    arg(metavar="DIR", help="keep compiled programs in this folder, not in the user's cache"),
]
NoCache = Annotated[bool, FlagCreatePairsOff, arg(help="keep no compiled programs, and use none")]


@dataclass(kw_only=True)
class Command:
    """A command of the program."""

    always_double: ClassVar[bool] = False  #: works in float64, whatever the picture's precision

    def run(self) -> int:
        """Runs the command. **Returns:** the exit status of the program."""
        raise NotImplementedError


@dataclass(kw_only=True)
class Compiling(Command):
    """A command that compiles programs."""

    cache: CacheFolder = None
    no_cache: NoCache = False


@dataclass(kw_only=True)
class Sized(Command):
    """A command that draws pictures of a given size."""

    size: Size = "512x512"

    @property
    def width_height(self) -> dict[str, Any]:
        """Returns the size as arguments of `render`. **Raises:** `InputError`."""
        from ..files.image_reader import MOST_PIXELS

        match = re.fullmatch(r"([1-9]\d{0,8})x([1-9]\d{0,8})", self.size, re.ASCII)
        if not match:
            raise InputError(
                f"--size must be WIDTHxHEIGHT in pixels, such as 512x512, got {self.size!r}"
            )
        width, height = int(match[1]), int(match[2])
        if width * height > MOST_PIXELS:
            raise InputError(f"--size must be at most {MOST_PIXELS} pixels in all, got {self.size}")
        return {"width": width, "height": height}


@dataclass(kw_only=True)
class Tracing(Command):
    """A command that follows rays."""

    highlight: HighlightModel = "phong"
    bounces: Bounces = 5

    @property
    def settings(self) -> dict[str, Any]:
        """Returns the settings of pictures as arguments of `render`."""
        return {"highlight": self.highlight, "bounces": self.bounces}


@dataclass(kw_only=True)
class Sampling(Tracing):
    """A command that follows rays through the samples of pixels."""

    samples: Samples = 1

    @property
    def settings(self) -> dict[str, Any]:
        """Returns the settings of pictures as arguments of `render`."""
        return super().settings | {"samples": self.samples}


def names_in(text: str) -> tuple[str, ...]:
    """Splits names at commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def channels_in(option: str, text: str | None) -> float | tuple[float, ...] | None:
    """Reads one number, or three with commas. **Raises:** `InputError`."""
    if text is None:
        return None
    try:
        one, *others = (float(word) for word in text.split(","))
    except ValueError:
        one, others = math.nan, []
    if any(map(math.isnan, [one, *others])) or len(others) not in (0, 2):
        raise InputError(f"{option} must be one number, or three with commas, got {text!r}")
    return (one, *others) if others else one


def objects_in(option: str, text: str) -> dict[str, bool | list[int]]:
    """Reads names with commas, each with the numbers of objects if not of all: `color:1,3-5,kd`.

    Objects are counted from 1, as in scene files and messages, and returned from 0.

    **Returns:** for each name its objects' numbers, True for all.

    **Raises:** `InputError`.
    """
    found: dict[str, bool | list[int]] = {}
    places: list[int] | None = None  # of the name before, if it lists objects
    for word in names_in(text):
        name, colon, numbers = (x.strip() for x in word.partition(":"))
        if colon:
            places = []
            _once(option, found, name)[name] = places
        elif word[0].isdigit():
            numbers = name
        else:
            places = None
            _once(option, found, name)[name] = True
            continue
        match = re.fullmatch(r"([1-9]\d{0,8})(?:-([1-9]\d{0,8}))?", numbers, re.ASCII)
        if not match or places is None or int(match[2] or match[1]) < int(match[1]):
            raise InputError(
                f"{option}: expected NAME or NAME:1,3-5, objects counted from 1, got {word!r}"
            )
        places += range(int(match[1]) - 1, int(match[2] or match[1]))
    return found


def _once(option: str, found: dict, name: str) -> dict:
    if name in found:
        raise InputError(f"{option} must name {name} once")
    return found


def pairs_in(option: str, text: str | None, between: str) -> dict[str, tuple[float, float]]:
    """Reads pairs of numbers by name: `radius:50..120,kd:..0.9`, of which each may be left out.

    **Arguments:** `between`: what is between the numbers, `..` or `+-`.

    **Raises:** `InputError`.
    """
    found: dict[str, tuple[float, float]] = {}
    for word in names_in(text or ""):
        name, colon, pair = word.partition(":")
        low, dots, high = pair.partition(between)
        try:
            numbers = (float(low or "-inf"), float(high or "inf"))
        except ValueError:
            numbers = (math.nan, math.nan)
        if not (colon and dots) or any(map(math.isnan, numbers)):
            raise InputError(f"{option}: expected NAME:X{between}Y, got {word!r}")
        _once(option, found, name.strip())[name.strip()] = numbers
    return found


def check_report(report: Path | None) -> None:
    """Checks early that a report can be written: a page, or a folder. **Raises:** `InputError`."""
    from ..files.atomic import check_target

    if report is not None and report.suffix == ".html":
        check_target(report)
    elif report is not None and report.suffix:
        raise InputError(f"{report}: expected a name that ends in .html, or a folder")
    else:
        check_folder(report)


def check_folder(folder: Path | None) -> None:
    """Checks early that a folder can be written to, or made. **Raises:** `InputError`."""
    if folder is None:
        return
    existing = next(f for f in (folder, *folder.parents) if f.exists())
    if not existing.is_dir():
        file = "this" if existing == folder else existing
        raise InputError(f"{folder}: expected a folder to write to, {file} is a file")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise InputError(f"{folder}: the folder {existing} cannot be written to")
