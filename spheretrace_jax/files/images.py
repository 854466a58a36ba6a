"""Pictures read and written through OpenImageIO, on the host.

Inside the program a picture is linear Rec. 709 RGB. Files are converted by OpenImageIO's own
colour configuration: EXR and HDR hold linear numbers, other formats sRGB-coded ones, unless the
caller says otherwise.
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
from .atomic import check_place, replacing, reserve

Colorspace = Literal["auto", "linear", "srgb"]

_LINEAR, _SRGB = "lin_rec709_scene", "srgb_rec709_scene"
_CONFIG = "ocio://default"  # whatever the user's $OCIO says
_FLOATING = (".exr", ".hdr")
_WRITABLE = (".exr", ".hdr", ".png", ".ppm", ".tif", ".tiff", ".jpg", ".jpeg")
_WRITING = {
    ".exr": {"compression": "zip"},
    ".jpg": {"compression": "jpeg:95", "jpeg:subsampling": "4:4:4"},
    ".jpeg": {"compression": "jpeg:95", "jpeg:subsampling": "4:4:4"},
    ".ppm": {"pnm:pfmflip": 0},  # OpenImageIO 3.2 would write integer PPM upside down as well
}
_HEADERS = 1 << 16  # bytes: more than any header takes
_ANY_TEXT = (".exr", ".png")
_SHORT_TEXT = 60_000  # bytes: JPEG ends the program on a text of 64 kB, TIFF cuts it off

#: Larger pictures are refused before any memory is taken: a header may promise anything.
MOST_PIXELS = 1 << 28

# Pixels per byte, more than black pictures have: one bit each, and deflate's 1032 to 1; JPEG's
# blocks of 64 take a bit. Of a JPEG that is cut short libjpeg makes up what its header promises.
_DENSE, _DENSEST = 10_000, {"jpeg": 1000}


def _is_linear(path: Path, colorspace: Colorspace) -> bool:
    if colorspace not in get_args(Colorspace):
        spaces = ", ".join(get_args(Colorspace))
        raise InputError(f"colorspace must be one of {spaces}, got {colorspace!r}")
    return colorspace == "linear" or (colorspace == "auto" and path.suffix.lower() in _FLOATING)


def read_image(
    path: str | os.PathLike, colorspace: Colorspace = "auto"
) -> Float[np.ndarray, "height width 3"]:
    """Reads a picture as linear RGB in float32, row 0 at the top.

    OpenImageIO knows many formats, of which GIF is refused. A picture of one channel is grey. Alpha
    means over black: colours are multiplied by it. Numbers that are nan or inf in a floating file
    stay what they are.

    **Arguments:** `colorspace`: how the file's numbers are coded: `"linear"`, `"srgb"`, or
    `"auto"` for linear in EXR and HDR files and sRGB in all others.

    **Raises:** `PictureError` if there is no such file or it cannot be read as a picture.
    """
    import OpenImageIO as oiio

    path = Path(path)
    linear = _is_linear(path, colorspace)
    _check_name(path)
    if os.path.isdir(path):  # which, unlike Path's, knows no name that is too long
        raise PictureError(f"{path}: expected a picture, this is a folder")
    if not os.path.isfile(path):
        raise PictureError(f"{path}: there is no such picture")
    try:
        with open(path, "rb") as file:
            start = file.read(4)
    except OSError as error:
        raise PictureError(f"{path}: cannot be read as a picture: {error.strerror}") from None
    if start == b"GIF8":  # OpenImageIO takes what memory its header promises before we can look
        raise PictureError(f"{path}: cannot be read as a picture: GIF files are not read")
    hint = oiio.ImageSpec()
    hint.attribute("oiio:UnassociatedAlpha", 1)  # colour is decoded first, alpha multiplied after
    with _silence():
        source = oiio.ImageInput.open(str(path), hint)
    if source is None:
        raise PictureError(f"{path}: cannot be read as a picture: {_reason(oiio)}")
    try:
        spec = source.spec()
        _check_size(path, source)
        with _silence():
            pixels = source.read_image(oiio.FLOAT)
        if pixels is None or source.has_error:  # of a JPEG cut short it gives pixels and an error
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
    if any(category(c) == "Cs" for c in str(path)):  # which OpenImageIO cannot be told
        raise PictureError(f"{printable(str(path))}: the name of a picture must be UTF-8")


def _check_size(path: Path, source: Any) -> None:
    """Refuses what a file's header promises and cannot be true, before any memory is taken."""
    spec = source.spec()
    pixels, channels = spec.width * spec.height, spec.nchannels
    most = min(MOST_PIXELS, _DENSEST.get(source.format_name(), _DENSE) * os.path.getsize(path))
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
    - `scene`: the text of a scene file to keep in the picture's metadata, beside the program's
      version and the colour space. PPM and HDR hold no text, TIFF and JPEG none above 60 kB.

    **Raises:** `PictureError` for formats, bits, shapes and dtypes that do not go; `OSError` if the
    file cannot be written.
    """
    import OpenImageIO as oiio

    from .. import __version__

    path, pixels = Path(path), np.asarray(image)
    ending = path.suffix.lower()
    check_writable(path, bits)
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
    kind = _kind(path, ending, bits)
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, kind)
    spec.attribute("oiio:ColorSpace", _LINEAR if linear else _SRGB)
    spec.attribute("Software", f"spheretrace_jax {__version__}")
    for name, value in _WRITING.get(ending, {}).items():
        spec.attribute(name, value)
    text = "" if scene is None else scene
    if text and (ending in _ANY_TEXT or len(text.encode()) <= _SHORT_TEXT):
        spec.attribute("ImageDescription", text)
    with replacing(path) as temporary:
        # on a full disk PNG's library would say nothing, and JPEG's would end the program
        reserve(temporary, 2 * spec.image_bytes() + len(text.encode()) + _HEADERS)
        sink = oiio.ImageOutput.create(str(temporary))
        if sink is None or not sink.open(str(temporary), spec):
            raise PictureError(f"{path}: cannot be written: {_reason(oiio)}")
        if not (sink.write_image(np.ascontiguousarray(pixels)) and sink.close()):
            raise PictureError(f"{path}: cannot be written: {_reason(sink)}")


def check_writable(path: str | os.PathLike, bits: int | None = None) -> None:
    """Says early whether `write_image` can write such a file, before anything is computed.

    **Raises:** `PictureError` for formats and bits that do not go; `OSError` if there is no place
    for the file.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in _WRITABLE:
        formats = ", ".join(_WRITABLE)
        raise PictureError(f"{path}: expected a picture file ({formats}), got {ending!r}")
    _kind(path, ending, bits)
    check_place(path)
    _check_name(path.resolve())


def to_srgb(image: ArrayLike) -> Float[np.ndarray, "height width 3"]:
    """Linear RGB as sRGB numbers, for showing."""
    return _convert(np.asarray(image, np.float32), _LINEAR, _SRGB)


def _kind(path: Path, ending: str, bits: int | None) -> str:
    """OpenImageIO's name of the number type."""
    allowed = {
        ".exr": (32, 16), ".hdr": (32,), ".tif": (8, 16, 32), ".tiff": (8, 16, 32),
        ".png": (8, 16), ".ppm": (8, 16), ".jpg": (8,), ".jpeg": (8,),
    }[ending]  # fmt: skip
    bits = allowed[0] if bits is None else bits
    if bits not in allowed:
        raise PictureError(
            f"{path}: {ending} files have {' or '.join(map(str, allowed))} bits, got {bits}"
        )
    if bits == 32:
        return "float"
    return "half" if ending == ".exr" else f"uint{bits}"


def _convert(pixels: np.ndarray, source: str, target: str) -> np.ndarray:
    import OpenImageIO as oiio

    # OpenColorIO's fast powers are wrong by 2.5e-5, more than a step of 16 bits
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
    """Keeps libpng's own complaint from the terminal: the error that is raised says the same."""
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
    """The first line of what OpenImageIO, or a part of it, says of a failure."""
    try:
        message = failed.geterror()
    except UnicodeDecodeError as error:  # it quotes bytes of a broken file
        message = error.object.decode(errors="replace")
    lines = message.strip().splitlines() or ["unknown format"]
    return printable(lines[0])
