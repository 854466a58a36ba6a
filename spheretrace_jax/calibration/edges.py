"""Edges of a picture: where the gradient is largest along its own direction (Canny 1986)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import ndimage

# Blur before differences are taken, pixels: less answers noise, more rounds corners off.
_BLUR = 1.0

# How many deviations of the noise's gradient an edge has, and the least share of the largest one.
_SIGNIFICANT, _LEAST = 5.0, 0.01


class Edges(NamedTuple):
    """Edges with subpixel positions."""

    points: Float[np.ndarray, "n 2"]  #: (x, y) in pixels
    normals: Float[np.ndarray, "n 2"]  #: unit vectors across the edges, towards the lighter side
    strength: Float[np.ndarray, " n"]  #: lengths of the gradients


def find_edges(picture: Float[np.ndarray, "height width channels"]) -> Edges:
    """Finds the edges of a picture; each pixel takes the channel with the largest gradient.

    The position along the gradient is the top of a parabola through three lengths.
    """
    smooth = [ndimage.gaussian_filter(channel, _BLUR) for channel in np.moveaxis(picture, -1, 0)]
    slopes = [[ndimage.sobel(channel, axis) / 8 for axis in (1, 0)] for channel in smooth]
    x, y = np.moveaxis(np.array(slopes), 1, 0)
    length = np.hypot(x, y)
    strongest = length.argmax(0)[None]
    x, y, length = (np.take_along_axis(a, strongest, 0)[0] for a in (x, y, length))
    # noise has a Rayleigh distribution of lengths, whose median is 1.18 deviations
    least = max(_SIGNIFICANT * _noise(picture), _LEAST * float(length.max()))
    rows, columns = np.nonzero(length > least)
    normals = np.column_stack([x[rows, columns], y[rows, columns]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    places = np.column_stack([columns, rows]).astype(float)
    middle = length[rows, columns]
    before, after = (
        ndimage.map_coordinates(length, (places + side * normals).T[::-1], order=1, mode="nearest")
        for side in (-1, 1)
    )
    top = (middle >= before) & (middle > after)
    bend = np.where(top, 2 * middle - before - after, 1)
    shift = 0.5 * (after - before) / np.where(bend > 0, bend, 1)
    points = places + 0.5 + np.clip(shift, -0.6, 0.6)[:, None] * normals
    return Edges(points[top], normals[top], middle[top])


def _noise(picture: Float[np.ndarray, "height width channels"]) -> float:
    """Estimates the deviation of a gradient's length from noise alone (Immerkaer 1996)."""
    mask = np.array([[1.0, -2, 1], [-2, 4, -2], [1, -2, 1]])
    worst = 0.0
    for channel in np.moveaxis(picture, -1, 0):
        second = ndimage.convolve(channel, mask)[1:-1, 1:-1]
        if second.size:
            worst = max(worst, float(np.median(np.abs(second))) / 0.6745 / 6)
    return _GAIN * worst


def _gain() -> float:
    """Returns how much of white noise is left in one component of the gradient."""
    impulse = np.zeros((21, 21))
    impulse[10, 10] = 1
    answer = ndimage.sobel(ndimage.gaussian_filter(impulse, _BLUR), 0) / 8
    return float(np.sqrt((answer**2).sum()))


_GAIN = _gain()
