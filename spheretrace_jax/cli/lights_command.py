"""The command `spheretrace lights`: where the lights of photographs of a ball are."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction, arg

from ..base.errors import InputError
from ..base.types import Colorspace
from .arguments import Compiling, channels_in, check_folder

_ENDINGS = (".csv", ".lp", ".txt")


@dataclass(kw_only=True)
class LightsCommand(Compiling):
    """Find the lights of photographs of a ball: direction, distance, colour, and their errors.

    Directions are unit vectors from the ball's centre: x right, y up, z toward the viewer.
    Distances are in radii of the ball, or in the unit of --radius. Photographs of one size show the
    ball in one place. Exit status 1: a light is not to be used.
    """

    photos: Positional[
        Annotated[tuple[Path, ...], arg(metavar="PHOTO", help="photographs, each with one light")]
    ]
    output: Annotated[
        UseAppendAction[tuple[Path, ...]],
        arg(aliases=["-o"], metavar="FILE",
            help="write the lights: .csv with all numbers, .lp, or .txt with a direction a line "
            "(light_directions.txt); may be given several times"),
    ] = ()  # fmt: skip
    ball: Annotated[
        str,
        arg(metavar="auto|MASK|X,Y,R", help="where the ball is: found, a picture that is white on "
            "the ball, or middle and radius in pixels from the left and top edge"),
    ] = "auto"  # fmt: skip
    focal: Annotated[float | None, arg(metavar="F", help="the camera's focal length in pixels")] = (
        None
    )
    orthographic: Annotated[
        bool, FlagCreatePairsOff, arg(help="parallel rays, as of a very long lens")
    ] = False
    principal_point: Annotated[
        str | None, arg(metavar="X,Y", help="of the camera in pixels; the middle by default")
    ] = None
    linear: Annotated[bool, FlagCreatePairsOff, arg(help="PHOTOs hold linear numbers")] = False
    srgb: Annotated[bool, FlagCreatePairsOff, arg(help="PHOTOs hold sRGB-encoded numbers")] = False
    chrome: Annotated[
        bool, FlagCreatePairsOff, arg(help="the ball is a mirror: its bright spots are lights")
    ] = False
    count: Annotated[int | None, arg(metavar="N", help="how many lights a chrome ball shows")] = (
        None
    )
    shared: Annotated[
        bool, FlagCreatePairsOff, arg(help="all PHOTOs show the ball with one material")
    ] = False
    mask: Annotated[
        Path | None, arg(metavar="IMAGE", help="black where pixels of the ball do not count")
    ] = None
    brightest: Annotated[
        float | None, arg(metavar="X", help="numbers from this on are saturated: do not count")
    ] = None
    darkest: Annotated[float | None, arg(metavar="X", help="numbers up to this do not count")] = (
        None
    )
    albedo: Annotated[
        str | None, arg(metavar="R,G,B", help="the ball's own colour; colours are divided by it")
    ] = None
    radius: Annotated[float, arg(metavar="R", help="of the ball, in any unit of length")] = 1.0
    intensities: Annotated[
        Path | None, arg(metavar="FILE", help="write the colours, one a line")
    ] = None
    page: Annotated[
        Path | None, arg(metavar="FILE.html", help="write a page with pictures of all fits")
    ] = None
    scenes: Annotated[
        Path | None, arg(metavar="DIR", help="write a scene file for each photograph")
    ] = None

    def run(self) -> int:
        """Finds the lights, prints a line for each, and writes the files."""
        from .. import lights, read_image, read_mask

        self._check()
        names = _names(self.photos)
        colorspace: Colorspace = "linear" if self.linear else "srgb" if self.srgb else "auto"
        pictures = [read_image(photo, colorspace) for photo in self.photos]
        albedo = channels_in("--albedo", self.albedo)
        found = lights(
            [np.asarray(picture, float) for picture in pictures],
            self._ball(),
            focal=np.inf if self.focal is None else self.focal,
            principal_point=self._point(),
            names=names,
            mask=None if self.mask is None else np.asarray(read_mask(self.mask)),
            brightest=self.brightest,
            darkest=self.darkest,
            albedo=(1.0, 1.0, 1.0) if albedo is None else np.broadcast_to(albedo, 3),
            radius=self.radius,
            chrome=self.chrome,
            count=self.count,
            shared=self.shared,
        )
        print(found)
        self._write(found)
        return int(any(light.grade == "not to be used" for light in found))

    def _check(self) -> None:
        """Checks what does not need the pictures. **Raises:** `InputError`."""
        if not self.photos:
            raise InputError("expected photographs of a ball, got none")
        if (self.focal is None) != self.orthographic:
            raise InputError(
                "expected --focal, the camera's focal length in pixels, or --orthographic; "
                "pixels are millimetres of the lens, divided by the sensor's width, times the "
                "picture's width"
            )
        if self.linear and self.srgb:
            raise InputError("expected --linear or --srgb, got both")
        for file in self.output:
            if file.suffix not in _ENDINGS:
                raise InputError(f"{file}: expected a name that ends in {', '.join(_ENDINGS)}")
        if self.chrome and self.scenes:
            raise InputError("--scenes: of a chrome ball no scene is made")
        from ..files.atomic import check_target

        for file in (*self.output, self.intensities, self.page):
            if file is not None:
                check_target(file)
        check_folder(self.scenes)

    def _ball(self):
        """Returns the ball as `lights` takes it."""
        from ..files.images import read_image

        if self.ball == "auto":
            return "auto"
        words = self.ball.split(",")
        if len(words) == 3:
            return _numbers("--ball", self.ball, 3)
        return np.asarray(read_image(self.ball, "linear"))[..., 0]

    def _point(self) -> tuple[float, float] | None:
        if self.principal_point is None:
            return None
        x, y = _numbers("--principal-point", self.principal_point, 2)
        return x, y

    def _write(self, found) -> None:
        """Writes the files that were asked for."""
        from ..calibration import light_files

        names, directions = [light.name for light in found], found.directions
        for file in self.output:
            if file.suffix == ".csv":
                light_files.write_lights(file, [light.record() for light in found])
            elif file.suffix == ".lp":
                light_files.write_lp(file, names, directions)
            else:
                light_files.write_rows(file, directions)
            print(f"wrote {file}")
        if self.intensities is not None:
            light_files.write_rows(self.intensities, np.stack([light.color for light in found]))
            print(f"wrote {self.intensities}")
        if self.page is not None:
            from ..display.lights_page import write_page

            write_page(self.page, found)
            print(f"wrote {self.page}")
        if self.scenes is not None:
            from .. import save_scene

            self.scenes.mkdir(parents=True, exist_ok=True)
            for k, light in enumerate(found):
                file = self.scenes / f"{light.name}.txt"
                save_scene(file, found.scene(k))
                print(f"wrote {file}")


def _names(photos: tuple[Path, ...]) -> list[str]:
    """Returns the photographs' names: those of the files, with their folders where alike."""
    names = [photo.stem for photo in photos]
    if len(set(names)) == len(names):
        return names
    return [str(photo.with_suffix("")).replace("/", "_") for photo in photos]


def _numbers(option: str, text: str, count: int) -> tuple[float, ...]:
    """Reads numbers with commas. **Raises:** `InputError`."""
    try:
        numbers = tuple(float(word) for word in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise InputError(f"{option}: expected {count} numbers with commas, got {text!r}")
    return numbers
