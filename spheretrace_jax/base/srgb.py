"""The curve of sRGB (IEC 61966-2-1), from numbers of files to linear light and back."""

import numpy as np


def srgb(x: np.ndarray) -> np.ndarray:
    """Decodes sRGB numbers to linear ones."""
    return np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0) + 0.055) / 1.055) ** 2.4)


def code_srgb(x: np.ndarray) -> np.ndarray:
    """Codes linear numbers as sRGB."""
    return np.where(x <= 0.0031308, x * 12.92, 1.055 * np.maximum(x, 0) ** (1 / 2.4) - 0.055)
