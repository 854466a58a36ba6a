"""Numbers of pictures as they come: whole numbers, grey ones, and masks of numbers."""

import numpy as np
from jaxtyping import Bool, Shaped

from ...base.errors import InputError, PictureError

# The largest numbers of 8 and 16 bits.
_WHITES = (255, 65535)

# The largest number from which whole floating numbers are levels of a file, and the part of white
# from which the largest of others is one. Pictures of bright lights have other numbers.
_LEVELS, _NEARLY = 20, 0.98


def linear_numbers(
    image: Shaped[np.ndarray, "..."],
) -> tuple[Shaped[np.ndarray, "height width 3"], str | None]:
    """Returns a picture's numbers with white at 1 in three channels, and a word on what was done.

    **Arguments:** `image`: of shape `(height, width, 3)`, or grey, `(height, width)` or
    `(height, width, 1)`; floating numbers, those over 0..255 or 0..65535 too, uint8 or uint16.

    **Raises:** `PictureError` for other shapes and types.
    """
    shape, words = image.shape, []
    if image.ndim == 2:
        image = image[..., None]
    if image.ndim != 3 or image.shape[2] not in (1, 3) or 0 in image.shape:
        raise PictureError(
            f"the target must have shape (height, width, 3), or (height, width) if it is grey, "
            f"got {shape}"
        )
    if image.dtype not in (np.uint8, np.uint16) and not np.issubdtype(image.dtype, np.floating):
        raise PictureError(
            "the target must hold linear floating numbers, as read_image gives, uint8 or uint16, "
            f"got {image.dtype}"
        )
    white = _white_of(image)
    if white != 1:
        words.append(
            f"its numbers over 0..{white} are taken as linear and divided by {white} (read_image "
            "decodes those of sRGB files)"
        )
        image = image / white
    if image.shape[2] == 1:
        words.append("it is grey: its three channels are alike")
        image = np.repeat(image, 3, axis=2)
    return image, f"the target: {'; '.join(words)}" if words else None


def _white_of(image: np.ndarray) -> int:
    """Returns the number that stands for white."""
    if image.dtype.kind == "u":
        return np.iinfo(image.dtype).max
    finite = image[np.isfinite(image)]
    largest, least = finite.max(initial=0), finite.min(initial=0)
    whole = largest > _LEVELS and bool(np.all(finite == np.floor(finite)))
    for white in _WHITES:
        if least >= 0 and largest <= white:
            return white if whole or largest >= _NEARLY * white else 1
    return 1


def yes_or_no(mask: Shaped[np.ndarray, "..."]) -> Bool[np.ndarray, "..."]:
    """Returns which numbers of a mask say yes: more than half of white, 1 or 255.

    **Raises:** `InputError` for numbers that are neither in 0..1 nor whole in 0..255.
    """
    if mask.dtype == bool:
        return mask
    largest, least = np.max(mask, initial=0), np.min(mask, initial=0)
    whole = largest <= 255 and bool(np.all(mask == np.floor(mask)))
    if not least >= 0 or not (largest <= 1 or whole):
        raise InputError(
            "the mask must hold yes and no: bool, numbers from 0 to 1, or whole ones from 0 to 255"
        )
    return mask > (0.5 if largest <= 1 else 127.5)
