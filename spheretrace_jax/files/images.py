"""Pictures read and written through OpenImageIO, on the host.

Inside the program a picture is linear Rec. 709 RGB. OpenImageIO's built-in colour configuration
converts files: EXR and HDR hold linear numbers, other formats sRGB-coded numbers, unless the caller
says otherwise.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, get_args
from unicodedata import category

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from ..base.errors import InputError, PictureError, printable
from .atomic import check_target, replacing, reserve
from .picture_formats import PICTURE_FORMATS, PictureFormat

Colorspace = Literal["auto", "linear", "srgb"]

_LINEAR, _SRGB = "lin_rec709_scene", "srgb_rec709_scene"
_CONFIG = "ocio://default"  # the built-in configuration, whatever the user's $OCIO names

# Room for a file's header, in bytes: more than any header takes.
_HEADER_BYTES = 1 << 16

# Limit of the text in metadata, in bytes, for formats without long texts: JPEG's library ends the
# program on a text of 64 kB, and TIFF's library cuts the text off.
_MOST_TEXT = 60_000

#: Limit of a picture, in pixels. Larger pictures are refused before any memory is taken, as a
#: header may promise any size.
MOST_PIXELS = 1 << 28

# Limits of the pixels per byte of a file, by format. Black pictures have fewer: deflate compresses
# one bit a pixel by 1032 to 1, and JPEG's blocks of 64 pixels take a bit. For a truncated JPEG,
# libjpeg makes up all pixels that the header promises.
_MOST_PIXELS_PER_BYTE, _OF_FORMAT = 10_000, {"jpeg": 1000}


def _is_linear(path: Path, colorspace: Colorspace) -> bool:
    """Tells whether a file holds linear numbers. **Raises:** `InputError` for unknown spaces."""
    if colorspace not in get_args(Colorspace):
        spaces = ", ".join(get_args(Colorspace))
        raise InputError(f"colorspace must be one of {spaces}, got {colorspace!r}")
    known = PICTURE_FORMATS.get(path.suffix.lower())
    return colorspace == "linear" or (colorspace == "auto" and known is not None and known.linear)


def read_image(
    path: str | os.PathLike, colorspace: Colorspace = "auto"
) -> Float[np.ndarray, "height width 3"]:
    """Reads a picture as linear RGB in float32, row 0 at the top.

    OpenImageIO reads many formats; only GIF is refused. A picture of one channel is grey. Colours
    are multiplied by alpha, which composes the picture over black. Numbers that are nan or inf in a
    floating file stay nan or inf.

    **Arguments:** `colorspace`: how the file's numbers are coded: `"linear"`, `"srgb"`, or
    `"auto"` for linear in EXR and HDR files and sRGB in all others.

    **Raises:** `PictureError` if the file is missing or cannot be read as a picture.
    """
    import OpenImageIO as oiio

    path = Path(path)
    linear = _is_linear(path, colorspace)
    _check_name(path)
    if os.path.isdir(path):  # unlike Path's, bears names of any length
        raise PictureError(f"{path}: expected a picture, this is a folder")
    if not os.path.isfile(path):
        raise PictureError(f"{path}: there is no such picture")
    try:
        with open(path, "rb") as file:
            start = file.read(4)
    except OSError as error:
        raise PictureError(f"{path}: cannot be read as a picture: {error.strerror}") from None
    if start == b"GIF8":  # OpenImageIO allocates the size in the header before it can be checked
        raise PictureError(f"{path}: cannot be read as a picture: GIF files are not read")
    hint = oiio.ImageSpec()
    hint.attribute("oiio:UnassociatedAlpha", 1)  # decode colours before multiplying by alpha
    with _silence():
        source = oiio.ImageInput.open(str(path), hint)
    if source is None:
        raise PictureError(f"{path}: cannot be read as a picture: {_reason(oiio)}")
    try:
        spec = source.spec()
        _check_size(path, source)
        with _silence():
            pixels = source.read_image(oiio.FLOAT)
        if pixels is None or source.has_error:  # a truncated JPEG gives both
            raise PictureError(f"{path}: cannot be read as a picture: {_reason(source)}")
    except MemoryError:
        raise PictureError(f"{path}: there is not enough memory for this picture") from None
    finally:
        source.close()
    pixels = np.asarray(pixels, np.float32).reshape(spec.height, spec.width, spec.nchannels)
    premultiplied = spec.alpha_channel >= 0 and not spec.getattribute("oiio:UnassociatedAlpha")
    alpha = pixels[..., spec.alpha_channel, None] if spec.alpha_channel >= 0 else None
    if spec.nchannels < 3:
        color = np.repeat(pixels[..., :1], 3, axis=-1)
    else:
        color = np.ascontiguousarray(pixels[..., :3])
    if not linear:
        color = _convert(color, _SRGB, _LINEAR)
    return color if alpha is None or premultiplied else color * alpha


def _check_name(path: Path) -> None:
    """**Raises:** `PictureError` for names that are no UTF-8, as OpenImageIO takes no others."""
    if any(category(c) == "Cs" for c in str(path)):
        raise PictureError(f"{printable(str(path))}: the name of a picture must be UTF-8")


def _check_size(path: Path, source: Any) -> None:
    """Checks the size that a file's header promises, before any memory is taken.

    **Raises:** `PictureError` for sizes beyond the limits, or too large for the file's length.
    """
    spec = source.spec()
    pixels, channels = spec.width * spec.height, spec.nchannels
    per_byte = _OF_FORMAT.get(source.format_name(), _MOST_PIXELS_PER_BYTE)
    most = min(MOST_PIXELS, per_byte * os.path.getsize(path))
    if (
        min(spec.width, spec.height, channels) < 1
        or pixels > most
        or pixels * channels > 4 * MOST_PIXELS
        or spec.depth > 1
    ):
        size = f"{spec.width} x {spec.height} x {spec.depth}"
        of = f" of {channels} numbers" if channels > 4 else ""
        reason = "" if most == MOST_PIXELS else ", as the file is short"
        raise PictureError(
            f"{path}: expected a picture of at most {most} pixels{reason}, got {size}{of}"
        )


def write_image(
    path: str | os.PathLike,
    image: ArrayLike,
    *,
    colorspace: Colorspace = "auto",
    bits: int | None = None,
    scene: str | None = None,
) -> None:
    """Writes linear RGB as EXR, HDR, PNG, PPM, TIFF or JPEG, whole or not at all.

    **Arguments:**

    - `image`: linear RGB of shape `(height, width, 3)`, row 0 at the top. Integer formats clip it
      to 0..1.
    - `colorspace`: how to code the file's numbers, as for `read_image`.
    - `bits`: 8 (default) or 16 for PNG, PPM and TIFF; TIFF and EXR also 32, floating, which is the
      default for EXR.
    - `scene`: the text of a scene file for the picture's metadata, which also hold the program's
      version and the colour space. PPM and HDR hold no text, TIFF and JPEG none above 60 kB.

    **Raises:** `PictureError` for formats, bits, shapes and dtypes that cannot be written;
    `OSError` if the file cannot be written.
    """
    import OpenImageIO as oiio

    from .. import __version__

    path, pixels = Path(path), np.asarray(image)
    format_, number_type = check_writable(path, bits)
    if pixels.ndim != 3 or pixels.shape[2] != 3 or 0 in pixels.shape:
        raise PictureError(
            f"{path}: expected a picture of shape (height, width, 3), got {pixels.shape}"
        )
    if not jnp.issubdtype(pixels.dtype, jnp.floating):
        raise PictureError(f"{path}: expected linear floating numbers, got {pixels.dtype}")
    pixels = pixels.astype(np.float32)
    linear = _is_linear(path, colorspace)
    if not linear:
        pixels = _convert(pixels, _LINEAR, _SRGB)
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, number_type)
    spec.attribute("oiio:ColorSpace", _LINEAR if linear else _SRGB)
    spec.attribute("Software", f"spheretrace_jax {__version__}")
    for name, value in format_.attributes.items():
        spec.attribute(name, value)
    text = "" if scene is None else scene
    if text and (format_.long_text or len(text.encode()) <= _MOST_TEXT):
        spec.attribute("ImageDescription", text)
    with replacing(path) as temporary:
        # on a full disk PNG's library would say nothing, and JPEG's would end the program
        reserve(temporary, 2 * spec.image_bytes() + len(text.encode()) + _HEADER_BYTES)
        sink = oiio.ImageOutput.create(str(temporary))
        if sink is None or not sink.open(str(temporary), spec):
            raise PictureError(f"{path}: cannot be written: {_reason(oiio)}")
        if not (sink.write_image(np.ascontiguousarray(pixels)) and sink.close()):
            raise PictureError(f"{path}: cannot be written: {_reason(sink)}")


def check_writable(path: str | os.PathLike, bits: int | None = None) -> tuple[PictureFormat, str]:
    """Checks early that `write_image` can write a file, before a picture is computed.

    **Returns:** the file's format, and OpenImageIO's name of the number type.

    **Raises:** `PictureError` for unknown formats, and bits that the format does not have;
    `OSError` if the folder takes no file.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in PICTURE_FORMATS:
        formats = ", ".join(PICTURE_FORMATS)
        raise PictureError(f"{path}: expected a picture file ({formats}), got {ending!r}")
    format_ = PICTURE_FORMATS[ending]
    bits = format_.bits[0] if bits is None else bits
    if bits not in format_.bits:
        raise PictureError(
            f"{path}: {ending} files have {' or '.join(map(str, format_.bits))} bits, got {bits}"
        )
    check_target(path)
    _check_name(path.resolve())
    return format_, format_.number_type(bits)


def to_srgb(image: ArrayLike) -> Float[np.ndarray, "height width 3"]:
    """Converts linear RGB to sRGB numbers, for display."""
    return _convert(np.asarray(image, np.float32), _LINEAR, _SRGB)


def _convert(pixels: np.ndarray, source: str, target: str) -> np.ndarray:
    """Converts colours from one of OpenImageIO's colour spaces to another."""
    import OpenImageIO as oiio

    # OpenColorIO's fast powers have errors of 2.5e-5, more than a step of 16 bits
    os.environ.setdefault("OCIO_OPTIMIZATION_FLAGS", "0")
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, "float")
    buffer = oiio.ImageBuf(spec)
    buffer.set_pixels(oiio.ROI(), np.ascontiguousarray(pixels))
    converted = oiio.ImageBufAlgo.colorconvert(buffer, source, target, colorconfig=_CONFIG)
    if converted.has_error:
        raise PictureError(f"cannot convert colours: {_reason(converted)}")
    return np.asarray(converted.get_pixels(oiio.FLOAT), np.float32)


@contextmanager
def _silence() -> Iterator[None]:
    """Silences libpng's message on the terminal, which the raised error repeats."""
    try:
        terminal = os.dup(2)
    except OSError:  # there is none
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(terminal, 2)
        os.close(terminal)
        os.close(nowhere)


def _reason(failed: Any) -> str:
    """Returns the first line of the error message of OpenImageIO or one of its objects."""
    try:
        message = failed.geterror()
    except UnicodeDecodeError as error:  # it quotes bytes of a broken file
        message = error.object.decode(errors="replace")
    lines = message.strip().splitlines() or ["unknown format"]
    return printable(lines[0])
