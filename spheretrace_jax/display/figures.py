"""Figures: Matplotlib's without a window system, and pictures as PNG."""

import io
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped

from ..files.atomic import replacing
from ..files.images import to_srgb

Picture = Float[np.ndarray, "height width 3"]


def new_figure(width: float, height: float) -> Any:
    """Returns an empty figure. **Arguments:** `width`, `height`: in inches."""
    from matplotlib.figure import Figure  # not pyplot: no window system, no global state

    return Figure(figsize=(width, height), layout="constrained")


def save_figure(figure: Any, path: Path) -> None:
    """Writes a figure atomically, in the format of the ending."""
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120)


def figure_png(figure: Any, dpi: int = 96) -> bytes:
    """Returns a figure as a PNG file."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=dpi)
    return file.getvalue()


def displayed(picture: Shaped[Any, "height width 3"]) -> Picture:
    """Returns linear RGB as a display takes it: sRGB from 0 to 1; NaN is black."""
    return np.clip(to_srgb(np.nan_to_num(np.asarray(picture, np.float32))), 0, 1)


def picture_png(picture: Shaped[Any, "height width 3"]) -> bytes:
    """Returns a linear picture as a PNG file of 8 bits, pixel for pixel."""
    from matplotlib.image import imsave

    file = io.BytesIO()
    imsave(file, np.round(displayed(picture) * 255).astype(np.uint8), format="png")
    return file.getvalue()


def shrunk(picture: Picture, most: int) -> Float[np.ndarray, "rows columns 3"]:
    """Returns means of boxes of pixels, so that no side is longer than `most`; NaN stays NaN."""
    height, width = picture.shape[:2]
    side = -(-max(height, width) // most)
    if side == 1:
        return picture
    rows, columns = max(height // side, 1), max(width // side, 1)
    inside = picture[: rows * side, : columns * side]
    high, wide = min(side, height), min(side, width)
    return inside.reshape(rows, high, columns, wide, 3).mean(axis=(1, 3))


def draw_residual(ax: Any, residual: Picture) -> Any:
    """Draws the worst channel of each pixel of a residual, white at 0; NaN is grey.

    **Returns:** the drawn picture, for a colour bar.
    """
    known = np.nan_to_num(residual)
    channel = np.abs(known).argmax(-1, keepdims=True)
    worst = np.take_along_axis(residual, channel, -1)[..., 0]
    limit = max(float(np.abs(known).max()), 1e-12)
    ax.set_facecolor("0.75")
    ax.set(xticks=[], yticks=[])
    return ax.imshow(worst, cmap="RdBu", vmin=-limit, vmax=limit)
