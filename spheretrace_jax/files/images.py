"""Pictures read and written through OpenImageIO, on the host.

Inside the program a picture is linear Rec. 709 RGB. What the numbers of a file mean is what the
file says, unless the caller says otherwise; files that are written say it.
"""

import os
import warnings
from pathlib import Path
from typing import get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Bool, Float

from ..base.errors import InputError, PictureError, PictureWarning
from ..base.types import Colorspace
from ..rendering.layers import Layers
from .atomic import check_target, replacing, reserve
from .color_encoding import LINEAR, SRGB
from .color_spaces import code_srgb
from .icc_profile import linear_profile
from .image_reader import ImageData, check_name, read_file, reason
from .layer_channels import layer_channels
from .picture_formats import PICTURE_FORMATS, PictureFormat

# OpenImageIO's names of what is written.
_LINEAR, _SRGB = "lin_rec709_scene", "srgb_rec709_scene"

# Room for a file's header, in bytes: more than any header takes.
_HEADER_BYTES = 1 << 16

# Limit of the text in metadata, in bytes, for formats without long texts: JPEG's library ends the
# program on a text of 64 kB, and TIFF's library cuts the text off.
_MOST_TEXT = 60_000

# The brightness up to which a pixel of a mask is black, from which it is white, and from which it
# counts.
_BLACK, _WHITE, _COUNTS = 0.1, 0.9, 0.5


def read_image(
    path: str | os.PathLike[str], colorspace: Colorspace = "auto", *, layer: str | None = None
) -> Float[np.ndarray, "height width 3"]:
    """Reads a picture as linear Rec. 709 RGB in float32, upright, row 0 at the top.

    OpenImageIO reads many formats; only GIF is refused. The content decides, not the ending. A
    picture of one channel is grey. Numbers that are nan or inf in a floating file stay nan or inf.

    - **Colours** are converted by what the file says: an ICC profile of curves and a matrix, such
      as Display P3; `cICP`, `gAMA` and `cHRM` in PNG; primaries of EXR and Radiance files, and
      the exposure of these. They may then lie outside 0..1. If the file says nothing, integers
      are sRGB and floating numbers are linear.
    - **Alpha**: colours are multiplied by alpha, which composes the picture over black.
    - **Window**: of an EXR file the display window is read, black where it holds no pixels.
    - **Orientation** (Exif, TIFF, EXR) is applied.

    **Arguments:**

    - `colorspace`: how the file's numbers are coded, whatever the file says: `"linear"` or
      `"srgb"`, both of Rec. 709; `"auto"` for what the file says.
    - `layer`: which layer, view, part, page or frame of a file with several, by its name; parts
      also by their number, from `"1"` on.

    **Warns:** `PictureWarning` if another layer could be meant, if pixels are transparent or not
    square, and if the file does not say what its colours are.

    **Raises:** `PictureError` if the file is missing or cannot be read as a picture; for colours
    that are not known (CMYK, PQ, profiles of tables), deep pictures, and layers that are missing.
    """
    path = Path(path)
    _check_colorspace(colorspace)
    encoding = {"auto": None, "linear": LINEAR, "srgb": SRGB}[colorspace]
    image = read_file(path, encoding, layer)
    how = "; a fit can leave them out (read_mask, fit --mask alpha)"
    _warn([*image.remarks, *_transparency(path, image, how), *_saturation(path, image)])
    return image.color


def read_texture(path: str | os.PathLike[str]) -> Float[np.ndarray, "height width 3"]:
    """Reads the bitmap of a texture or a sky. **Warns, raises:** as `read_image`."""
    image = read_file(Path(path))
    _warn([*image.remarks, *_transparency(Path(path), image)])
    return image.color


def _transparency(path: Path, image: ImageData, how: str = "") -> list[str]:
    """Says how many pixels are transparent. **Arguments:** `how`: to leave them out."""
    if image.alpha is None or not (count := int(np.count_nonzero(image.alpha < 1))):
        return []
    pixels = f"{count} of {image.alpha.size} pixels"
    return [f"{path}: {pixels} are transparent, and read as over black{how}"]


def _saturation(path: Path, image: ImageData) -> list[str]:
    """Says how many pixels are saturated, where the numbers do not show it."""
    if not image.saturated:
        return []
    return [
        f"{path}: {image.saturated} pixels are saturated, which its colours beyond 1 hide; a fit "
        "can leave them out (brightest=0.999, fit --brightest 0.999)"
    ]


def read_mask(
    path: str | os.PathLike[str], *, alpha: bool = False, layer: str | None = None
) -> Bool[np.ndarray, "height width"]:
    """Reads which pixels count in a fit: those of at least half the brightness of white.

    The brightness is that of the file's numbers as they are coded, of the brightest channel.
    Transparent pixels are black.

    **Arguments:** `alpha`: takes the picture's alpha in place of its brightness. `layer`: as for
    `read_image`.

    **Warns:** `PictureWarning` as `read_image`, and if more than half of the pixels are grey.

    **Raises:** `PictureError` as `read_image`; if there is no alpha; and for pictures that are no
    masks, as nowhere they are black or white, or in which no pixel counts.
    """
    path = Path(path)
    image = read_file(path, LINEAR, layer)
    if alpha and image.alpha is None:
        raise PictureError(f"{path}: has no alpha channel that could be the mask")
    values = image.alpha if alpha and image.alpha is not None else image.color.max(axis=-1)
    grey = (values > _BLACK) & (values < _WHITE)
    if grey.all():
        raise PictureError(
            f"{path}: expected a mask, white where the picture counts and black elsewhere, got "
            f"only greys from {values.min():.2g} to {values.max():.2g}"
        )
    counts = values >= _COUNTS
    if not counts.any():
        raise PictureError(f"{path}: no pixel of the mask counts: expected some as bright as half")
    if 2 * np.count_nonzero(grey) > grey.size:
        image.remarks.append(
            f"{path}: expected a mask of black and white, {grey.mean():.0%} of its pixels are grey"
        )
    _warn(image.remarks)
    return counts


def _warn(remarks: list[str]) -> None:
    """Warns the caller of a public function of this module."""
    for remark in remarks:
        warnings.warn(remark, PictureWarning, stacklevel=3)


def _check_colorspace(colorspace: Colorspace) -> None:
    """**Raises:** `InputError` for unknown spaces."""
    if colorspace not in get_args(Colorspace):
        spaces = ", ".join(get_args(Colorspace))
        raise InputError(f"colorspace must be one of {spaces}, got {colorspace!r}")


def write_image(
    path: str | os.PathLike[str],
    image: ArrayLike,
    *,
    colorspace: Colorspace = "auto",
    bits: int | None = None,
    scene: str | None = None,
    layers: Layers | None = None,
) -> None:
    """Writes linear RGB as EXR, HDR, PNG, PPM, TIFF or JPEG, whole or not at all.

    **Arguments:**

    - `image`: linear RGB of shape `(height, width, 3)`, row 0 at the top. Integer formats clip it
      to 0..1.
    - `colorspace`: how to code the file's numbers: `"linear"`, `"srgb"`, or `"auto"` for linear
      floating numbers and sRGB in integers. The file says which, so that `read_image` knows.
    - `bits`: 8 (default) or 16 for PNG, PPM and TIFF; TIFF and EXR also 32, floating, which is the
      default for EXR.
    - `scene`: the text of a scene file for the picture's metadata, which also hold the program's
      version and the colour space. PPM and HDR hold no text, TIFF and JPEG none above 60 kB.
    - `layers`: those of `render_layers`, as more channels of an EXR file, floating in 32 bits:
      coverage `A`, depth `Z`, normal `N.X N.Y N.Z` and object `id`.

    **Warns:** `PictureWarning` for a colour space that the format cannot say: linear in PPM, sRGB
    in HDR.

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
    _check_colorspace(colorspace)
    usual = "linear" if number_type in ("float", "half") else "srgb"
    linear = (usual if colorspace == "auto" else colorspace) == "linear"
    if not linear:
        pixels = to_srgb(pixels)
    more = {} if layers is None else layer_channels(path, layers, pixels.shape[:2])
    pixels = np.dstack([pixels, *more.values()])
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], number_type)
    if more:
        spec.channelnames = ("R", "G", "B", *more)
        types = [number_type] * 3 + ["float"] * len(more)
        spec.channelformats = tuple(map(oiio.TypeDesc, types))
    spec.attribute("oiio:ColorSpace", _LINEAR if linear else _SRGB)
    spec.attribute("Software", f"spheretrace_jax {__version__}")
    if linear and format_.profile:
        profile = np.frombuffer(linear_profile(), np.uint8)
        spec.attribute("ICCProfile", oiio.TypeDesc(f"uint8[{profile.size}]"), profile)
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
            raise PictureError(f"{path}: cannot be written: {reason(oiio)}")
        if not (sink.write_image(np.ascontiguousarray(pixels)) and sink.close()):
            raise PictureError(f"{path}: cannot be written: {reason(sink)}")
    if not format_.tagged and colorspace not in ("auto", usual):
        warnings.warn(
            f"{path}: {path.suffix} files cannot say that their numbers are {colorspace}: read it "
            f"with colorspace={colorspace!r}",
            PictureWarning,
            stacklevel=2,
        )


def check_writable(
    path: str | os.PathLike[str], bits: int | None = None
) -> tuple[PictureFormat, str]:
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
    check_name(path.resolve())
    return format_, format_.number_type(bits)


def to_srgb(image: ArrayLike) -> Float[np.ndarray, "height width 3"]:
    """Converts linear RGB to sRGB numbers, for display."""
    return code_srgb(np.asarray(image, np.float32)).astype(np.float32)
