"""Layers as channels of an EXR file, by the names that other programs know."""

from pathlib import Path

import numpy as np

from ..base.errors import PictureError
from ..rendering.layers import Layers


def check_layer_format(path: Path) -> None:
    """Checks that a file can hold layers. **Raises:** `PictureError` for all but EXR."""
    if path.suffix.lower() != ".exr":
        raise PictureError(f"{path}: layers need an EXR file (.exr), got {path.suffix!r}")


def layer_channels(path: Path, layers: Layers, size: tuple[int, int]) -> dict[str, np.ndarray]:
    """Returns the channels of layers by name: coverage A, depth Z, N.X, N.Y, N.Z, and id.

    **Arguments:** `size`: the (height, width) of the colours that stand in the same file.

    **Raises:** `PictureError` for all but EXR files, and for layers of another size.
    """
    check_layer_format(path)
    normal = np.asarray(layers.normal)
    channels = {
        "A": layers.coverage,
        "Z": layers.depth,
        "N.X": normal[..., 0],
        "N.Y": normal[..., 1],
        "N.Z": normal[..., 2],
        "id": layers.object,
    }
    if any(np.shape(channel) != size for channel in channels.values()):
        raise PictureError(
            f"{path}: expected layers of shape {size}, as the picture has, got "
            f"{np.shape(layers.depth)}"
        )
    return {name: np.asarray(channel, np.float32) for name, channel in channels.items()}
