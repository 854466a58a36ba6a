"""Pictures on Matplotlib axes, with the colours of a display."""

from typing import Any

import numpy as np
from jaxtyping import Float, Shaped

from ..base.errors import InputError
from ..rendering.render import render
from ..scene.scene import Scene
from .figures import Picture, displayed

#: The height of a scene's picture, in pixels, where it is shown without being asked for a size.
SMALL = 256


def to_srgb(picture: Shaped[Any, "height width 3"]) -> Picture:
    """Converts a linear picture to the numbers of a display: sRGB, clipped to 0..1; NaN is black.

    **Returns:** a NumPy array of shape `(height, width, 3)`, for `imshow` and the like.
    """
    return displayed(_picture(picture))


def show(picture_or_scene: Any, ax: Any = None, title: str = "", **settings: Any) -> Any:
    """Shows a linear picture, or a scene's small picture, on Matplotlib axes.

    **Arguments:** `picture_or_scene`: linear RGB `(height, width, 3)`, or a `Scene`, which is
    rendered with 256 x 256 pixels. `ax`: where, by default new axes of pyplot's. `settings`: of a
    scene's picture, as for `render`.

    **Returns:** the axes.

    **Raises:** `InputError` for what is neither, and for settings of a picture.
    """
    if isinstance(picture_or_scene, Scene):
        size: dict[str, Any] = {"width": SMALL, "height": SMALL}
        picture = np.asarray(render(picture_or_scene, **(size | settings)))
    elif settings:
        raise InputError(f"a picture is shown as it is: unknown {', '.join(settings)}")
    else:
        picture = _picture(picture_or_scene)
    if ax is None:
        import matplotlib.pyplot as plt

        ax = plt.subplots(layout="constrained")[1]
    ax.imshow(displayed(picture))
    ax.set(title=title, xticks=[], yticks=[])
    return ax


def _picture(picture: Any) -> Float[np.ndarray, "height width 3"]:
    """Returns a picture of NumPy's. **Raises:** `InputError` for arrays of other shapes."""
    try:
        numbers = np.asarray(picture, float)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.ndim != 3 or numbers.shape[-1] != 3:
        got = f"shape {np.shape(picture)}" if hasattr(picture, "shape") else type(picture).__name__
        raise InputError(f"expected a picture of shape (height, width, 3), or a Scene, got {got}")
    return numbers
