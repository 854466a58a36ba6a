"""`ball_from_photo`: finds a ball in a photograph, and fits its outline."""

import numpy as np
from jaxtyping import ArrayLike, Float

from ..base.errors import InputError
from .camera import Intrinsics, Number, intrinsics_of
from .conic import BallOutline, outline_distance, outline_of_numbers
from .consensus import covered_share, find_outline, refine_outline
from .edges import Edges, find_edges
from .limb import fit_limb

Pixels = Float[np.ndarray, "height width channels"]

# Pixels of the longer side of the picture in which the ball is searched.
_SMALL = 320

# Distance of an edge from an outline that it supports, in pixels of the small picture: from one
# through three edges, and from one that is fitted to many.
_TOLERANCE, _EXACTLY = 1.5, 0.7

# The share of the outline that edges must cover, and how much more of the outline that must be than
# of other outlines beside it, which texture covers.
_LEAST_SHARE, _BEYOND_CHANCE = 0.3, 1.6

# Radii of the outlines beside, by which chance is told.
_BESIDE = (0.8, 0.88, 1.12, 1.2)

# How many edges, the strongest ones, take part in the search.
_MOST_EDGES = 3000


def ball_from_photo(
    picture: ArrayLike,
    near: tuple[Number, Number, Number] | None = None,
    focal: Number = np.inf,
    principal_point: tuple[Number, Number] | None = None,
) -> BallOutline:
    """Finds a ball in a photograph and fits its outline.

    The search takes the outline with which most edges of the picture agree. A part of it may be
    missing: in shadow before a dark background, hidden, or beyond the border. The fit models the
    brightness on both sides of the outline, which falls towards it like a square root.

    **Arguments:** `picture`: (height, width, channels) or (height, width), linear
    numbers of any scale. `near`: (x, y, radius) of the ball in
    pixels, to within a quarter of the radius; by default the whole picture is searched. `focal`,
    `principal_point`: of the camera, as in `ball_from_mask`.

    **Raises:** `InputError` if no ball is found.
    """
    pixels = _channels(picture)
    size = pixels.shape[:2]
    intrinsics = intrinsics_of(size, focal, principal_point)
    hint = None if near is None else np.array(near, float)
    if hint is not None and not (np.isfinite(hint).all() and hint[2] > 0):
        raise InputError(f"near: expected (x, y, radius) in pixels, radius > 0, got {near}")
    visible = _stabilized(pixels)
    longest = max(size) if hint is None else min(max(size), 6 * hint[2])
    factor = 2 ** max(0, int(np.ceil(np.log2(longest / _SMALL))))
    ball = _search(_shrunk(visible, factor), _scaled(intrinsics, factor), hint, factor)
    while True:
        ball = _follow(visible, ball, intrinsics, factor)
        if factor == 1:
            break
        factor //= 2
    ball, covariance = fit_limb(pixels, ball, intrinsics)
    return outline_of_numbers(ball, intrinsics, covariance)


def _channels(picture: ArrayLike) -> Pixels:
    """Checks a picture. **Returns:** its channels that differ, about 1 at their largest."""
    pixels = np.asarray(picture, float)
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if pixels.ndim != 3 or min(pixels.shape) == 0 or min(pixels.shape[:2]) < 8:
        raise InputError(
            f"picture: expected at least 8 x 8 pixels, (height, width, 3) or (height, width), "
            f"got shape {np.shape(picture)}"
        )
    if not np.isfinite(pixels).all():
        raise InputError("picture: expected finite numbers, some are not")
    if (pixels == pixels[..., :1]).all():
        pixels = pixels[..., :1]
    top = float(np.quantile(np.abs(pixels), 0.995)) or float(np.abs(pixels).max()) or 1.0
    return pixels / top


def _stabilized(pixels: Pixels) -> Pixels:
    """Returns square roots, in which dark edges show too and shot noise is even (Anscombe)."""
    return np.sqrt(np.clip(pixels, 0, 1))


def _shrunk(pixels: Pixels, factor: int) -> Float[np.ndarray, "rows columns channels"]:
    """Averages blocks of `factor` x `factor` pixels, whole ones only."""
    rows, columns = (n // factor for n in pixels.shape[:2])
    cut = pixels[: rows * factor, : columns * factor]
    return cut.reshape(rows, factor, columns, factor, -1).mean((1, 3))


def _scaled(intrinsics: Intrinsics, factor: int) -> Intrinsics:
    """Returns the camera of a picture that is `factor` times smaller."""
    cx, cy = intrinsics.principal_point / factor
    return Intrinsics(intrinsics.focal / factor, cx, cy)


def _search(
    pixels: Pixels,
    intrinsics: Intrinsics,
    hint: Float[np.ndarray, "3"] | None,
    factor: int,
) -> Float[np.ndarray, "3"]:
    """Searches a ball in a small picture. **Returns:** (u, v, r) in pixels of the large one."""
    edges = find_edges(pixels)
    if hint is not None:
        hint = hint / factor
        beside = np.linalg.norm(edges.points - hint[:2], axis=1) / hint[2]
        edges = _chosen(edges, (beside > 0.4) & (beside < 1.6))
    if len(edges.strength) > _MOST_EDGES:
        edges = _chosen(edges, np.argsort(-edges.strength)[:_MOST_EDGES])
    message = "no ball found in the picture: " + (
        "tell where it is with `near`, or give a mask" if hint is None else "no outline near `near`"
    )
    if len(edges.strength) < 12:
        raise InputError(f"{message}; it has hardly an edge")
    points, normals = edges.points, edges.normals
    best, share, chance, most = None, 0.0, 0.0, 0.0
    found = [ball for ball, _ in find_outline(points, normals, intrinsics, _TOLERANCE, hint)]
    for ball in _distinct(found):
        ball = _refined(edges, ball, intrinsics, 1.0)
        outlines = [
            ball * [1, 1, scale] for scale in (1, *_BESIDE) if ball[2] * scale < intrinsics.focal
        ]
        covered, *others = (
            covered_share(points, normals, outline, intrinsics, _EXACTLY) for outline in outlines
        )
        beside = float(np.median(others))
        if (support := ball[2] * max(covered - beside, 0) ** 2) > most:
            best, share, chance, most = ball, covered, beside, support
    if best is None:
        raise InputError(f"{message}; its edges lie on no outline of a ball")
    if share < _LEAST_SHARE or share < _BEYOND_CHANCE * chance:
        raise InputError(
            f"{message}; the best outline has edges on {share:.0%} of its length, outlines beside "
            f"it on {chance:.0%}"
        )
    return best * factor


def _follow(
    pixels: Pixels, ball: Float[np.ndarray, "3"], intrinsics: Intrinsics, factor: int
) -> Float[np.ndarray, "3"]:
    """Fits an outline to the edges next to it, in a picture `factor` times smaller."""
    reach = 1.2 * np.sqrt(np.diag(outline_of_numbers(ball, intrinsics).ellipse.shape)) + 8 * factor
    low = np.maximum((ball[:2] - reach) // factor, 0).astype(int) * factor
    high = np.ceil(np.maximum(ball[:2] + reach, low + 8 * factor)).astype(int)
    part = pixels[low[1] : high[1], low[0] : high[0]]
    edges = find_edges(_shrunk(part, factor))
    return _refined(edges._replace(points=edges.points * factor + low), ball, intrinsics, factor)


def _refined(
    edges: Edges, ball: Float[np.ndarray, "3"], intrinsics: Intrinsics, scale: Number
) -> Float[np.ndarray, "3"]:
    """Fits an outline to the edges within three pixels that run along it."""
    depth, _, outward = outline_distance(edges.points, ball, intrinsics)
    near = (np.abs(depth) < 3 * scale) & (np.abs((edges.normals * outward).sum(1)) > 0.9)
    if near.sum() < 12:
        return ball
    return refine_outline(edges.points[near], ball, intrinsics, scales=(1.5 * scale, 0.7 * scale))


def _distinct(balls: list[Float[np.ndarray, "3"]]) -> list[Float[np.ndarray, "3"]]:
    """Returns the balls that lie more than two pixels from those before them."""
    chosen = []
    for ball in balls:
        if all(np.abs(ball - other).max() > 2 for other in chosen):
            chosen.append(ball)
    return chosen


def _chosen(edges: Edges, which: np.ndarray) -> Edges:
    return Edges(edges.points[which], edges.normals[which], edges.strength[which])
