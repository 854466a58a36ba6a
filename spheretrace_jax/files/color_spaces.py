"""Colour spaces: curves between coded and linear numbers, and matrices between primaries.

A space is known by x and y of its red, green, blue and white. Matrices adapt the white by Bradford
transforms. Sources: Lindbloom, "RGB/XYZ Matrices", "Chromatic Adaptation" (brucelindbloom.com);
ITU-T H.273 for the numbers of primaries and curves in video; IEC 61966-2-1 for sRGB.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from ..base.srgb import code_srgb as code_srgb, srgb as srgb

Curve = Callable[[np.ndarray], np.ndarray]
Matrix = Float[np.ndarray, "3 3"]

_D65, _ACES = (0.3127, 0.3290), (0.32168, 0.33767)

#: Whites as X, Y, Z: of ICC profiles, and of Rec. 709.
D50 = np.array([0.9642, 1.0, 0.8249])
D65 = np.array([_D65[0] / _D65[1], 1.0, (1 - sum(_D65)) / _D65[1]])

_BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)

# Primaries of numbers that are X, Y, Z themselves, of a white of D65.
_XYZ = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0)

#: Primaries and white by the names of OpenImageIO.
PRIMARIES: dict[str, tuple[float, ...]] = {
    "rec709": (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, *_D65),
    "p3d65": (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *_D65),
    "rec2020": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *_D65),
    "adobergb": (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, *_D65),
    "ap0": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, *_ACES),
    "ap1": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, *_ACES),
    "ciexyzd65": (*_XYZ, *_D65),
}

#: The same by the numbers of H.273; 2 means unknown.
VIDEO_PRIMARIES: dict[int, tuple[float, ...]] = {
    1: PRIMARIES["rec709"],
    2: PRIMARIES["rec709"],
    5: (0.64, 0.33, 0.29, 0.60, 0.15, 0.06, *_D65),
    6: (0.630, 0.340, 0.310, 0.595, 0.155, 0.070, *_D65),
    7: (0.630, 0.340, 0.310, 0.595, 0.155, 0.070, *_D65),
    9: PRIMARIES["rec2020"],
    10: PRIMARIES["ciexyzd65"],
    11: (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.314, 0.351),
    12: PRIMARIES["p3d65"],
    22: (0.630, 0.340, 0.295, 0.605, 0.155, 0.077, *_D65),
}


def linear(x: np.ndarray) -> np.ndarray:
    """Returns numbers that are linear already."""
    return x


def rec709(x: np.ndarray) -> np.ndarray:
    """Decodes numbers of video cameras to linear ones (ITU-R BT.709)."""
    return np.where(x < 0.081, x / 4.5, ((np.maximum(x, 0) + 0.099) / 1.099) ** (1 / 0.45))


def power(gamma: float) -> Curve:
    """Returns the curve x^gamma, with the sign of x."""
    return lambda x: np.sign(x) * np.abs(x) ** gamma


#: The curves by the numbers of H.273; 2 means unknown.
VIDEO_CURVES: dict[int, Curve] = {
    1: rec709, 2: srgb, 4: power(2.2), 5: power(2.8), 6: rec709, 8: linear, 13: srgb, 14: rec709,
    15: rec709,
}  # fmt: skip


def to_xyz(chromaticities: Sequence[float]) -> Matrix:
    """Returns the matrix from a space to X, Y, Z of its white. **Raises:** `ValueError`."""
    x, y = np.reshape(np.asarray(chromaticities, np.float64), (4, 2)).T
    primaries = np.stack([x, y, 1 - x - y])[:, :3]
    if not (np.isfinite([*x, *y]).all() and y[3] > 0 and abs(np.linalg.det(primaries)) > 1e-6):
        raise ValueError("its primaries make no sense")
    if tuple(chromaticities[:6]) == _XYZ:
        return primaries
    return primaries * np.linalg.solve(primaries, _white(chromaticities))


def to_rec709(chromaticities: Sequence[float]) -> Matrix:
    """Returns the matrix from a space to linear Rec. 709. **Raises:** `ValueError`."""
    matrix = to_xyz(chromaticities)
    if tuple(chromaticities[:6]) == _XYZ:
        return xyz_to_rec709(D65)
    return xyz_to_rec709(_white(chromaticities)) @ matrix


def xyz_to_rec709(white: np.ndarray) -> Matrix:
    """Returns the matrix from X, Y, Z of a white to linear Rec. 709."""
    return np.linalg.inv(to_xyz(PRIMARIES["rec709"])) @ adaptation(white, D65)


def adaptation(source: np.ndarray, target: np.ndarray) -> Matrix:
    """Returns the matrix between X, Y, Z of two whites (Bradford)."""
    ratio = (_BRADFORD @ target) / (_BRADFORD @ source)
    return np.linalg.solve(_BRADFORD, ratio[:, None] * _BRADFORD)


def _white(chromaticities: Sequence[float]) -> np.ndarray:
    """Returns X, Y, Z of the white."""
    x, y = chromaticities[6:]
    return np.array([x / y, 1.0, (1 - x - y) / y])
