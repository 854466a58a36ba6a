"""Pictures in a POV-Ray scene."""

import os
from pathlib import Path

from ..base.errors import SceneError
from ..scene.texture import Texture
from .image_reader import is_plain

_FORMATS = {
    ".bmp": "bmp", ".exr": "exr", ".gif": "gif", ".hdr": "hdr", ".jpeg": "jpeg", ".jpg": "jpeg",
    ".png": "png", ".ppm": "ppm", ".tga": "tga", ".tif": "tiff", ".tiff": "tiff",
}  # fmt: skip
_LINEAR_FORMATS = ("exr", "hdr")


def declared_image(name: str, texture: Texture) -> str:
    """Declares a function that looks up a texture's file.

    **Raises:** `SceneError` for textures that are in no file, or in a file that POV-Ray reads as
    another picture.
    """
    if not texture.file:
        raise SceneError("a texture is in no file: write it with write_image and name that file")
    ending = Path(texture.file).suffix.lower()
    if ending not in _FORMATS:
        known = ", ".join(_FORMATS)
        raise SceneError(f"{texture.file}: expected a picture that POV-Ray reads ({known})")
    file = Path(texture.file).as_posix()  # POV-Ray takes slashes on Windows, too
    if any(c in file for c in '"\\\r\n'):
        raise SceneError(f"POV-Ray cannot name the picture {texture.file!r}")
    linear = _FORMATS[ending] in _LINEAR_FORMATS
    if os.path.isfile(texture.file) and not is_plain(Path(texture.file), linear):
        raise SceneError(
            f"{texture.file}: POV-Ray would read this picture without its orientation, layer, "
            "colour space or alpha: write it with write_image and name that file"
        )
    gamma = "1" if linear else "srgb"
    image = f'{_FORMATS[ending]} "{file}" gamma {gamma} map_type 1 interpolate 2'
    return f"#declare {name} = function {{ pigment {{ image_map {{ {image} }} }} }}"
