"""`ColorEncoding`: how the numbers of a file become linear Rec. 709, by what the file says.

The order is that of the PNG specification: a code of video (cICP), an ICC profile, then the words
of the format, which OpenImageIO reports. Files that say nothing hold sRGB in integers, and linear
floating numbers.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..base.errors import PictureError, printable
from .color_spaces import (
    PRIMARIES,
    VIDEO_CURVES,
    VIDEO_PRIMARIES,
    Curve,
    Matrix,
    linear,
    power,
    rec709,
    srgb,
    to_rec709,
)
from .icc_profile import read_profile
from .png import PngFile

# The errors below which curves and matrices are those of sRGB: profiles of sRGB round their
# numbers, each in its own way.
_SRGB_ERROR = 1e-3

# Limit of the name of a profile in a message, in characters.
_LONGEST_NAME = 80

# How many rows are decoded at once.
_STRIP = 64

# Other names of spaces that OpenImageIO's readers use.
_NAMES = {
    "sRGB": "srgb_rec709", "linear": "lin_rec709", "scene_linear": "lin_rec709",
    "lin_srgb": "lin_rec709", "srgb_texture": "srgb_rec709", "ACEScg": "lin_ap1",
    "ACES2065-1": "lin_ap0", "lin_rec709": "lin_rec709",
}  # fmt: skip

_UNSAID = ("", "unknown", "data", "raw")  # of which no coding is known
_UNCALIBRATED, _ADOBE_RGB = 0xFFFF, 2  # the field ColorSpace of Exif
_FLOATING = ("half", "float", "double")


@dataclass(frozen=True)
class ColorEncoding:
    """How coded numbers become linear Rec. 709: curves, then a matrix."""

    curves: tuple[Curve, ...] = (linear,) * 3  #: of red, green and blue
    matrix: Matrix | None = None
    doubt: str = ""  #: what the file does not say, in words

    @property
    def is_linear(self) -> bool:
        """Returns whether numbers may be multiplied by alpha before they are decoded."""
        return all(curve is linear for curve in self.curves)

    def decode(self, color: Float[np.ndarray, "height width 3"]) -> np.ndarray:
        """Converts coded numbers to linear Rec. 709 in float32."""
        if self.is_linear and self.matrix is None:
            return color
        decoded = np.empty(color.shape, np.float32)
        for row in range(0, len(color), _STRIP):  # curves take the memory of several pictures
            strip = color[row : row + _STRIP]
            if self.curves[1:] == self.curves[:-1]:
                strip = self.curves[0](strip)
            else:
                channels = (curve(strip[..., k]) for k, curve in enumerate(self.curves))
                strip = np.stack(tuple(channels), axis=-1)
            if self.matrix is not None:
                strip = strip @ self.matrix.T
            decoded[row : row + _STRIP] = strip
        return decoded


SRGB, LINEAR = ColorEncoding((srgb,) * 3), ColorEncoding()


def find_encoding(
    path: Path, spec: Any, format_name: str, png: PngFile | None, radiance: str
) -> ColorEncoding:
    """Finds how a file's numbers are coded.

    **Arguments:** `spec`, `format_name`: OpenImageIO's. `png`: the chunks of a PNG file.
    `radiance`: the header of a Radiance file.

    **Raises:** `PictureError` for codings that are not known.
    """
    try:
        return _snapped(_encoding(spec, format_name, png, radiance))
    except ValueError as error:
        raise PictureError(
            f"{path}: its colours are not read: {printable(str(error))}. Convert it to sRGB, or "
            "say how its numbers are coded with colorspace= (fit --colorspace)"
        ) from None


def _encoding(spec: Any, format_name: str, png: PngFile | None, radiance: str) -> ColorEncoding:
    """Finds the encoding. **Raises:** `ValueError` that says what is not known."""
    video, profile = spec.getattribute("CICP"), spec.getattribute("ICCProfile")
    if video is not None:
        return _of_video(*(int(x) for x in video))
    kind = next(
        (str(a.value) for a in spec.extra_attribs if a.name.endswith(":ColorSpace")
         and str(a.value).upper() in ("CMYK", "YCCK", "CIELAB", "ICCLAB", "ITULAB")), None
    )  # fmt: skip
    if kind is not None:
        raise ValueError(f"they are {kind}, of which every printer has its own")
    if profile is not None:
        name = str(spec.getattribute("ICCProfile:profile_description") or "")[:_LONGEST_NAME]
        try:
            curves, matrix = read_profile(np.asarray(profile, np.uint8).tobytes())
        except ValueError as error:
            raise ValueError(f"its ICC profile {name!r} {error}") from None
        return ColorEncoding(curves, matrix)
    floating = str(spec.format) in _FLOATING
    name = str(spec.getattribute("oiio:ColorSpace") or "")
    if format_name == "pnm" or name.lower() in _UNSAID:  # it says Rec709 of every PNM file
        found = LINEAR if floating else SRGB
    else:
        found = _of_name(name, spec.getattribute("oiio:Gamma"), format_name)
    primaries = spec.getattribute("chromaticities") or _radiance_primaries(radiance)
    primaries = png.chromaticities if png is not None else primaries
    if primaries is not None and found.matrix is None:
        found = ColorEncoding(found.curves, to_rec709(tuple(map(float, primaries))))
    exif = spec.getattribute("Exif:ColorSpace")
    if exif == _ADOBE_RGB:
        return ColorEncoding((power(563 / 256),) * 3, to_rec709(PRIMARIES["adobergb"]))
    if exif == _UNCALIBRATED:
        doubt = "its Exif data say that its colours are not sRGB, but not which: read as sRGB"
        return ColorEncoding(found.curves, found.matrix, doubt)
    return found


def _of_video(primaries: int, curve: int, _: int, full_range: int) -> ColorEncoding:
    """Returns the encoding of the numbers of H.273. **Raises:** `ValueError`."""
    if curve not in VIDEO_CURVES:
        name = {16: "PQ (16)", 18: "HLG (18)"}.get(curve, str(curve))
        raise ValueError(f"their curve is number {name} of H.273")
    if primaries not in VIDEO_PRIMARIES:
        raise ValueError(f"their primaries are number {primaries} of H.273")
    if full_range != 1:
        raise ValueError("they are of the narrow range of video")
    return ColorEncoding((VIDEO_CURVES[curve],) * 3, to_rec709(VIDEO_PRIMARIES[primaries]))


def _of_name(name: str, gamma: float | None, format_name: str) -> ColorEncoding:
    """Returns the encoding that OpenImageIO names. **Raises:** `ValueError`."""
    if name == "Rec709":
        return ColorEncoding((rec709,) * 3)
    match = re.fullmatch(
        r"(?:ocio:)?(lin|srgb|g(\d+))_(\w+?)(?:_(?:scene|display|tx))?", _NAMES.get(name, name)
    )
    if not match or match[3] not in PRIMARIES:
        raise ValueError(f"they are coded as {name}")
    if match[2]:
        gamma = gamma or int(match[2]) / 10
        curve = power(1 / gamma if format_name == "hdr" else gamma)  # there it is the inverse
    else:
        curve = {"lin": linear, "srgb": srgb}[match[1]]
    primaries = None if match[3] == "rec709" else to_rec709(PRIMARIES[match[3]])
    return ColorEncoding((curve,) * 3, primaries)


def _radiance_primaries(header: str) -> tuple[float, ...] | None:
    """Returns the primaries in the header of a Radiance file, if there are any."""
    line = re.search(r"^PRIMARIES=(.*)$", header, re.MULTILINE)
    numbers = line[1].split() if line else []
    return tuple(map(float, numbers)) if len(numbers) == 8 else None


def _snapped(encoding: ColorEncoding) -> ColorEncoding:
    """Returns sRGB's own curve and matrix in place of those that differ from them by rounding."""
    x = np.linspace(0, 1, 257)
    curves = tuple(
        next((known for known in (linear, srgb) if _near(curve(x), known(x))), curve)
        for curve in encoding.curves
    )
    matrix = encoding.matrix
    if matrix is not None and _near(matrix, np.eye(3)):
        matrix = None
    return ColorEncoding(curves, matrix, encoding.doubt)


def _near(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(np.abs(a - b).max() <= _SRGB_ERROR)
