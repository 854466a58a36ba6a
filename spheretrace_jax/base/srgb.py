"""The curve of sRGB (IEC 61966-2-1), from numbers of files to linear light and back."""

from collections.abc import Callable

import numpy as np


def srgb(x: np.ndarray) -> np.ndarray:
    """Decodes sRGB numbers to linear ones."""
    return np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0) + 0.055) / 1.055) ** 2.4)


def code_srgb(x: np.ndarray) -> np.ndarray:
    """Codes linear numbers as sRGB."""
    return np.where(x <= 0.0031308, x * 12.92, 1.055 * np.maximum(x, 0) ** (1 / 2.4) - 0.055)


#: What a picture's numbers may be that were read as something else, and how they become linear.
MISREAD: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "sRGB-encoded": srgb,
    "linear, not decoded from sRGB": code_srgb,
}
