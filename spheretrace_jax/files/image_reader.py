"""Reading a picture file through OpenImageIO, on the host: checks, layer, window, orientation.

Nothing here changes the state of the process: no environment, no file descriptors.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from unicodedata import category

import numpy as np
from jaxtyping import Float

from ..base.errors import PictureError, printable
from .color_encoding import LINEAR, SRGB, ColorEncoding, find_encoding
from .layers import Layer, choose_layer
from .png import SIGNATURE, PngFile, read_png

#: Limit of a picture, in pixels. Larger pictures are refused before any memory is taken, as a
#: header may promise any size.
MOST_PIXELS = 1 << 28

# Limits of the pixels per byte of a file, by format. Black pictures have fewer: deflate compresses
# one bit a pixel by 1032 to 1, and JPEG's blocks of 64 pixels take a bit. For a truncated JPEG,
# libjpeg makes up all pixels that the header promises.
_MOST_PIXELS_PER_BYTE, _OF_FORMAT = 10_000, {"jpeg": 1000}

# Formats whose colours are multiplied by alpha, unless OpenImageIO says otherwise.
_MULTIPLIED = ("openexr", "tiff", "rla", "iff")

# Formats that know a display window beside the pixels they hold.
_WINDOWED = ("openexr", "tiff")

# The largest number of a picture that is known as clipped, give or take rounding.
_CLIPPED = 1 + 5e-5

# Limit of the header of a Radiance file, in bytes.
_RADIANCE_HEADER = 1 << 14

# The error of the ratio of a pixel's sides below which it is a square: resolutions are rounded.
_SQUARE = 0.01


class ImageData(NamedTuple):
    """A picture that was read."""

    color: Float[np.ndarray, "height width 3"]  #: linear Rec. 709, over black
    alpha: Float[np.ndarray, "height width"] | None
    remarks: list[str]  #: what the user should know of the file, each on one line
    encoding: ColorEncoding
    as_stored: bool  #: whether the file holds just these pixels: upright, opaque
    saturated: int  #: how many pixels are saturated, if the converted numbers do not show it


def read_file(
    path: Path, encoding: ColorEncoding | None = None, layer: str | None = None
) -> ImageData:
    """Reads a picture.

    **Arguments:** `encoding`: of the file's numbers, if not what the file says. `layer`: the name
    of a layer, if not the one that is taken to be the whole picture.

    **Raises:** `PictureError` if the file is missing or cannot be read as a picture.
    """
    check_name(path)
    png, radiance = _look_at_start(path)
    try:
        with _opened(path) as source:
            chosen, remark = choose_layer(path, source, layer)
        with _opened(path) as source:  # again: not every reader finds back to the first part
            image = _read(path, source, encoding, chosen, png, radiance)
    except MemoryError:
        raise PictureError(f"{path}: there is not enough memory for this picture") from None
    remarks = [f"{path}: {r}" for r in (remark, *image.remarks) if r]
    return image._replace(remarks=remarks)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Opens a file through OpenImageIO. **Raises:** `PictureError`."""
    import OpenImageIO as oiio

    hint = oiio.ImageSpec()
    hint.attribute("oiio:UnassociatedAlpha", 1)  # decode colours before multiplying by alpha
    source = oiio.ImageInput.open(str(path), hint)
    if source is None:
        raise PictureError(f"{path}: cannot be read as a picture: {reason(oiio)}")
    try:
        yield source
    finally:
        source.close()


def is_plain(path: Path, linear: bool) -> bool:
    """Returns whether programs that only decode a file's pixels read the same picture.

    **Arguments:** `linear`: whether they take the numbers to be linear, and not sRGB.

    **Raises:** `PictureError` as `read_file`.
    """
    image, taken = read_file(path), LINEAR if linear else SRGB
    same_colors = image.encoding.curves == taken.curves and image.encoding.matrix is None
    return image.as_stored and same_colors and not image.remarks


def _look_at_start(path: Path) -> tuple[PngFile | None, str]:
    """Looks at the first bytes of a file. **Returns:** a PNG file's chunks; a Radiance header.

    **Raises:** `PictureError` for files that OpenImageIO should not see.
    """
    if os.path.isdir(path):  # unlike Path's, bears names of any length
        raise PictureError(f"{path}: expected a picture, this is a folder")
    if not os.path.isfile(path):
        raise PictureError(f"{path}: there is no such picture")
    try:
        with open(path, "rb") as file:
            start = file.read(_RADIANCE_HEADER)
        png = read_png(path) if start.startswith(SIGNATURE) else None
    except OSError as error:
        raise PictureError(f"{path}: cannot be read as a picture: {error.strerror}") from None
    if start.startswith(b"GIF8"):  # OpenImageIO allocates the size in the header unchecked
        raise PictureError(f"{path}: cannot be read as a picture: GIF files are not read")
    header = start.partition(b"\n\n")[0] if start.startswith(b"#?") else b""
    return png, header.decode("latin-1")


def _read(
    path: Path,
    source: Any,
    encoding: ColorEncoding | None,
    layer: Layer,
    png: PngFile | None,
    radiance: str,
) -> ImageData:
    """Reads a picture from an open file."""
    import OpenImageIO as oiio

    source.seek_subimage(layer.part, 0)
    spec, format_name = source.spec(), source.format_name()
    if spec.deep:
        raise PictureError(
            f"{path}: it is a deep picture, with several samples to a pixel: flatten it first "
            "(oiiotool deep.exr --flatten -o flat.exr)"
        )
    _check_size(path, spec, format_name)
    if png is not None:
        png.check_pixels()
    found = find_encoding(path, spec, format_name, png, radiance) if encoding is None else encoding
    wants = (*layer.color, *(() if layer.alpha is None else (layer.alpha,)))
    first, end = min(wants), max(wants) + 1
    pixels = source.read_image(layer.part, 0, first, end, oiio.FLOAT)
    if pixels is None or source.has_error:  # a truncated JPEG gives both
        raise PictureError(f"{path}: cannot be read as a picture: {reason(source)}")
    pixels = np.asarray(pixels, np.float32).reshape(spec.height, spec.width, end - first)
    pixels = _upright(_windowed(pixels, spec, format_name), spec.getattribute("Orientation"))
    alpha = None if layer.alpha is None else pixels[..., layer.alpha - first]
    if layer.color == (first, first + 1, first + 2):
        coded = pixels[..., :3]
    else:
        channels = layer.color if len(layer.color) == 3 else layer.color * 3
        coded = np.stack([pixels[..., channel - first] for channel in channels], axis=-1)
    straight = bool(spec.getattribute("oiio:UnassociatedAlpha")) or format_name not in _MULTIPLIED
    with np.errstate(invalid="ignore", over="ignore"):  # nan and inf stay what they are
        color = _over_black(coded, alpha, straight, found)
        exposure = spec.getattribute("hdr:exposure")
        if encoding is None and exposure:
            color = color / np.float32(exposure)
    color = np.ascontiguousarray(color)
    as_stored = (
        spec.getattribute("Orientation") in (None, 0, 1)
        and color.shape[:2] == (spec.height, spec.width)
        and (alpha is None or bool((alpha == 1).all()))
        and not exposure
    )
    remarks = [found.doubt, *_remarks(spec, png)]
    hidden = _hidden_saturation(coded, color, found)
    return ImageData(color, alpha, remarks, found, as_stored, hidden)


def _check_size(path: Path, spec: Any, format_name: str) -> None:
    """Checks the size that a file's header promises, before any memory is taken.

    **Raises:** `PictureError` for sizes beyond the limits, or too large for the file's length.
    """
    width, height = spec.width, spec.height
    if format_name in _WINDOWED:
        width, height = max(width, spec.full_width), max(height, spec.full_height)
    pixels, channels = width * height, spec.nchannels
    per_byte = _OF_FORMAT.get(format_name, _MOST_PIXELS_PER_BYTE)
    most = min(MOST_PIXELS, per_byte * os.path.getsize(path))
    if (
        min(spec.width, spec.height, channels) < 1
        or pixels > most
        or pixels * channels > 4 * MOST_PIXELS
        or spec.depth > 1
    ):
        size = f"{width} x {height} x {spec.depth}"
        of = f" of {channels} numbers" if channels > 4 else ""
        short = "" if most == MOST_PIXELS else ", as the file is short"
        raise PictureError(
            f"{path}: expected a picture of at most {most} pixels{short}, got {size}{of}"
        )


def _windowed(pixels: np.ndarray, spec: Any, format_name: str) -> np.ndarray:
    """Returns the display window: black and transparent where the file holds no pixels."""
    x, y = spec.x - spec.full_x, spec.y - spec.full_y
    width, height = spec.full_width, spec.full_height
    same = (x, y, spec.width, spec.height) == (0, 0, width, height)
    if same or format_name not in _WINDOWED or min(width, height) < 1:
        return pixels
    window = np.zeros((height, width, pixels.shape[-1]), pixels.dtype)
    inside = pixels[max(-y, 0) : max(height - y, 0), max(-x, 0) : max(width - x, 0)]
    y, x = max(y, 0), max(x, 0)
    window[y : y + inside.shape[0], x : x + inside.shape[1]] = inside
    return window


def _upright(pixels: np.ndarray, orientation: int | None) -> np.ndarray:
    """Turns a picture upright. **Arguments:** `orientation`: of Exif and TIFF, 1 to 8."""
    if orientation in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return pixels


def _over_black(
    coded: np.ndarray, alpha: np.ndarray | None, straight: bool, encoding: ColorEncoding
) -> np.ndarray:
    """Decodes colours and composes them over black.

    **Arguments:** `straight`: whether the file's colours are not multiplied by alpha.
    """
    if alpha is None or (not straight and encoding.is_linear):
        return encoding.decode(coded)
    alpha = alpha[..., None]
    if straight:
        return encoding.decode(coded) * alpha
    shown = alpha > 0
    plain = np.where(shown, coded / np.where(shown, alpha, 1), coded)
    return encoding.decode(plain) * np.where(shown, alpha, 1)


def _hidden_saturation(coded: np.ndarray, color: np.ndarray, encoding: ColorEncoding) -> int:
    """Counts the saturated pixels of a picture in wide primaries, if its numbers do not show them.

    Without greater numbers, those that are 1 show that a picture was clipped.
    """
    if encoding.matrix is None or coded.max() != 1 or color.max() <= _CLIPPED:
        return 0
    return int(np.count_nonzero((coded == 1).any(axis=-1)))


def _remarks(spec: Any, png: PngFile | None) -> list[str]:
    """Lists what a picture of square pixels that stand still would not be."""
    remarks = []
    aspect = float(spec.getattribute("PixelAspectRatio") or 1)
    if abs(aspect - 1) > _SQUARE:
        remarks.append(f"its pixels are {aspect:.3g} times as wide as high: read as squares")
    if png is not None and png.frames > 1:
        remarks.append(f"of its {png.frames} frames read the first")
    return remarks


def check_name(path: Path) -> None:
    """**Raises:** `PictureError` for names that are no UTF-8, as OpenImageIO takes no others."""
    if any(category(c) == "Cs" for c in str(path)):
        raise PictureError(f"{printable(str(path))}: the name of a picture must be UTF-8")


def reason(failed: Any) -> str:
    """Returns the first line of the error message of OpenImageIO or one of its objects."""
    try:
        message = failed.geterror()
    except UnicodeDecodeError as error:  # it quotes bytes of a broken file
        message = error.object.decode(errors="replace")
    lines = message.strip().splitlines() or ["unknown format"]
    return printable(lines[0])
