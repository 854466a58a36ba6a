"""Blurred edges: what a step and other profiles become in pixels.

A pixel is a square. Seen across an edge, the mean over a pixel is close to that with a Gaussian of
variance 1/12, in all directions of the edge; the blur of lens and sensor adds its own.
"""

from functools import cache

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

Depths = Float[np.ndarray, "..."]

#: Variance of a pixel's square along any direction, square pixels.
PIXEL = 1 / 12


def step(depth: Depths, width: float) -> tuple[Depths, Depths]:
    """Blurs a unit step. **Returns:** values and derivatives by depth."""
    x = depth / width
    return ndtr(x), _normal(x) / width


def power_profiles(
    depth: Depths, width: float
) -> tuple[Float[np.ndarray, "3 n"], Float[np.ndarray, "3 n"], Float[np.ndarray, "3 n"]]:
    """Blurs the profiles max(depth, 0)^p, p = 0, 1/2, 1, with a Gaussian.

    **Arguments:** `depth`: pixels inside of the edge. `width`: of the Gaussian, pixels.

    **Returns:** values; derivatives by depth; derivatives by width.
    """
    x = depth / width
    bell, share = _normal(x), ndtr(x)
    grid, root, slope = _root_table()
    values = np.stack([share, np.interp(x, grid, root), x * share + bell])
    slopes = np.stack([bell, np.interp(x, grid, slope), share])
    # beyond the table by the curvature of the root: sqrt(x) + (1/2) d^2 sqrt(x) / dx^2
    far, deep = x > grid[-1], np.maximum(x, 1)
    values[1] = np.where(far, np.sqrt(deep) - deep**-1.5 / 8, values[1])
    slopes[1] = np.where(far, 0.5 / np.sqrt(deep) + 3 / 16 * deep**-2.5, slopes[1])
    p = np.array([0, 0.5, 1])[:, None]
    return (
        values * width**p,
        slopes * width ** (p - 1),
        (p * values - x * slopes) * width ** (p - 1),
    )


def _normal(x: Depths) -> Depths:
    return np.exp(-0.5 * x * x) / np.sqrt(2 * np.pi)


@cache
def _root_table() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tabulates the square root blurred with a unit Gaussian, and its derivative."""
    x = np.linspace(-8, 12, 801)
    # E sqrt(max(x + z, 0)) = integral of s * 2 s normal(s^2 - x) over s > 0
    s, ds = np.linspace(0, 5, 501, retstep=True)
    bell = _normal(s**2 - x[:, None])
    values = (2 * s**2 * bell).sum(1) * ds
    return x, values, (2 * s**2 * (s**2 - x[:, None]) * bell).sum(1) * ds


def shadow_profiles(
    depth: Depths, width: float, kink: float
) -> tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "2 n"], Float[np.ndarray, "2 n"]]:
    """Blurs the profile max(sqrt(depth) - sqrt(kink), 0) of a shadow's edge inside of an outline.

    **Returns:** values; derivatives by depth; derivatives by width: of the profile and, up to a
    factor, of its derivative by `kink`.
    """
    nodes = np.linspace(-4, 4, 65)
    share = _normal(nodes)
    share /= share.sum()
    places = depth[:, None] + width * nodes
    lit = places > kink
    roots = np.sqrt(np.where(lit, places, 1))
    slope = np.where(lit, 0.5 / roots, 0)
    values = np.where(lit, roots - np.sqrt(kink), 0) @ share
    x = (depth - kink) / width
    bell = _normal(x) / width
    return (
        np.stack([values, ndtr(x)]),
        np.stack([slope @ share, bell]),
        np.stack([slope @ (share * nodes), -x * bell]),
    )
