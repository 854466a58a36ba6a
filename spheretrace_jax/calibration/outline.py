"""`ball_from_mask`: the outline of a ball from a mask, to a hundredth of a pixel."""

from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Bool, Float, Int
from scipy import ndimage
from scipy.special import expit

from ..base.errors import InputError
from .camera import Intrinsics, Number, intrinsics_of
from .conic import BallOutline, outline_distance, outline_of_numbers, outline_points
from .consensus import Points, find_outline, refine_outline, sectors_of
from .edge_model import PIXEL, step

# The least boundary that tells a ball: places where it ends, and share of the outline.
_LEAST_EDGES, _LEAST_SHARE = 12, 0.2

# How many blocks the outline has in which errors may hang together. More blocks miss errors that
# reach further than one block, fewer tell the factor less exactly.
_BLOCKS = 16


def ball_from_mask(
    mask: ArrayLike,
    focal: Number = np.inf,
    principal_point: tuple[Number, Number] | None = None,
) -> BallOutline:
    """Fits the outline of a ball to a mask.

    The largest area of the mask counts, with its holes filled. It may be cut by the picture's
    border, and parts of its boundary may be wrong. Where all pixels are 0 or 1, the fit separates
    the centres inside from those outside (logistic regression); else it fits the covered areas.

    **Arguments:** `mask`: (height, width), or a grey picture (height, width, 3); booleans, numbers
    from 0 to 1 (coverage), or integers from 0 to 255 or 65535. `focal`: focal length in pixels,
    infinite for an orthographic camera. `principal_point`: (cx, cy) in pixels, by default the
    middle of the picture.

    **Raises:** `InputError` if the mask shows no ball.
    """
    cover = coverage_of(mask)
    intrinsics = intrinsics_of(cover.shape, focal, principal_point)
    cover = largest_area(cover)
    points = _edge_points(cover)
    if len(points) < _LEAST_EDGES:
        raise InputError(
            f"mask: expected the area of a ball with a boundary, found {int((cover > 0.5).sum())} "
            f"pixels in one piece and {len(points)} places where it ends"
        )
    found = find_outline(points, None, intrinsics, 1.5, most_balls=100)
    if not found or found[0][1] < _LEAST_SHARE:
        raise InputError(
            "mask: its largest area has no outline of a ball: an ellipse that agrees with its "
            "boundary was not found"
        )
    ball = refine_outline(points, found[0][0], intrinsics, scales=(2.0, 1.0, 0.7))
    pixels, values = _band(cover, points, ball, intrinsics)
    between = (values > 0.02) & (values < 0.98)
    fit = _fit_coverage if between.mean() > 0.02 else _separate
    ball, covariance = fit(pixels, values, ball, intrinsics)
    return outline_of_numbers(ball, intrinsics, covariance)


def coverage_of(mask: ArrayLike) -> Float[np.ndarray, "height width"]:
    """Converts a mask to numbers from 0 to 1: from booleans, shares, 0..255 or 0..65535.

    **Raises:** `InputError` for other shapes, and numbers that are no mask.
    """
    mask = np.asarray(mask)
    if mask.ndim == 3 and mask.size and (mask == mask[..., :1]).all():  # a grey picture
        mask = mask[..., 0]
    if mask.ndim != 2 or 0 in mask.shape:
        raise InputError(
            f"mask: expected an array (height, width) or a grey picture, got shape {mask.shape}"
        )
    values = mask.astype(float)
    if not np.isfinite(values).all() or values.min() < 0:
        raise InputError("mask: expected numbers from 0 to 1, 255 or 65535; some are not")
    top = next((top for top in (1, 255, 65535) if values.max() <= top), 0)
    if not top or (top > 1 and mask.dtype.kind == "f" and values.max() < top):
        raise InputError(
            f"mask: expected numbers from 0 to 1, 255 or 65535, got {values.max():g} at most"
        )
    return values / top


def largest_area(cover: Float[np.ndarray, "height width"]) -> Float[np.ndarray, "height width"]:
    """Returns the mask with its largest area only, whose holes are filled."""
    labels = np.zeros(cover.shape, np.int32)
    if ndimage.label(cover > 0.5, output=labels) == 0:
        return np.zeros_like(cover)
    area = labels == 1 + np.bincount(labels.ravel())[1:].argmax()
    filled = np.asarray(ndimage.binary_fill_holes(area))
    # partly covered pixels belong to the area that they touch
    others = _dilated((labels > 0) & ~area, 2)
    partly = np.where(_dilated(area, 2) & ~others, cover, 0)
    deep = filled & ~_dilated(~filled, 2)  # what lies there in the picture is a hole
    return np.where(deep | (filled & ~area), 1, partly)


def _dilated(
    area: Bool[np.ndarray, "height width"], steps: int
) -> Bool[np.ndarray, "height width"]:
    return np.asarray(ndimage.binary_dilation(area, iterations=steps))


def _edge_points(cover: Float[np.ndarray, "height width"]) -> Points:
    """Returns where the mask crosses 1/2 between neighbours, along rows and columns."""
    found = []
    for values, swap in ((cover, False), (cover.T, True)):
        rows, columns = np.nonzero((values[:, 1:] > 0.5) != (values[:, :-1] > 0.5))
        a, b = values[rows, columns], values[rows, columns + 1]
        xy = [columns + 0.5 + (0.5 - a) / (b - a), rows + 0.5]
        found.append(np.column_stack(xy[::-1] if swap else xy))
    return np.concatenate(found)


def _band(
    cover: Float[np.ndarray, "height width"],
    points: Points,
    ball: Float[np.ndarray, "3"],
    intrinsics: Intrinsics,
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Returns the pixels beside an outline and their values, where the mask is not wrong."""
    spread = 1.4826 * np.median(np.abs(outline_distance(points, ball, intrinsics)[0]))
    most = max(1.2, 4 * spread)
    beyond = _floor(points, cover.shape)  # where the boundary strays from the outline
    along = pixels_along(ball, intrinsics, cover.shape, most + 1)
    rows, columns = np.unique(np.concatenate([beyond, along], 1), axis=1)
    pixels, values = np.column_stack([columns, rows]) + 0.5, cover[rows, columns]
    depth = outline_distance(pixels, ball, intrinsics)[0]
    wrong = ((values > 0.5) != (depth > 0)) & (np.abs(depth) > most)
    count = max(8, round(2 * np.pi * ball[2] / 4))  # sectors of four pixels
    bad = np.zeros(count, bool)
    bad[sectors_of(pixels[wrong], ball, count)] = True
    bad |= np.roll(bad, 1) | np.roll(bad, -1)
    near = (np.abs(depth) < most + 1) & ~bad[sectors_of(pixels, ball, count)]
    return pixels[near], values[near]


def pixels_along(
    ball: Float[np.ndarray, "3"], intrinsics: Intrinsics, size: tuple[int, ...], reach: float
) -> Int[np.ndarray, "2 n"]:
    """Returns rows and columns of the pixels within about `reach` pixels of an outline."""
    angles = np.linspace(0, 2 * np.pi, 64 + round(16 * ball[2]), endpoint=False)
    points = outline_points(outline_of_numbers(ball, intrinsics), angles)
    steps = np.arange(-np.ceil(reach) - 1, np.ceil(reach) + 2)
    pixels = np.unique(np.floor(points).astype(int), axis=0)
    square = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 1, 2).astype(int)
    pixels = np.unique((pixels + square).reshape(-1, 2), axis=0)
    seen = ((pixels >= 0) & (pixels < size[1::-1])).all(1)
    return pixels[seen].T[::-1]


def _floor(points: Points, size: tuple[int, ...]) -> Int[np.ndarray, "2 n"]:
    """Returns rows and columns of the pixels that hold points of the picture."""
    columns, rows = np.floor(points).astype(int).T
    return np.stack([np.minimum(rows, size[0] - 1), np.minimum(columns, size[1] - 1)])


def _separate(
    pixels: Points,
    values: Float[np.ndarray, " n"],
    ball: Float[np.ndarray, "3"],
    intrinsics: Intrinsics,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Separates the pixels inside from those outside: maximum likelihood of a logistic model.

    A pixel at depth d is inside with probability 1 / (1 + exp(-d / s)). The blur s is that of
    largest likelihood, but at least the mean distance between the depths of two pixels: on less
    no pixel would tell.
    """
    sign = np.where(values > 0.5, 1.0, -1.0)
    depth = outline_distance(pixels, ball, intrinsics)[0]
    spacing = np.ptp(depth) / len(depth)
    fits = []
    for blur in np.geomspace(max(0.5, spacing), spacing, 12):
        fit = _logistic(pixels, sign, ball, blur, intrinsics)
        ball = fit.ball
        fits.append(fit)
    best = max(fits, key=lambda fit: fit.likelihood)
    # centres of pixels lie more evenly than at random: the blocks' sums say 0.15, and balls at
    # random places with radii of 8 to 300 pixels are 0.35 off in variance
    covariance = inflated(best.information, best.scores, block_of(pixels, ball), least=0.38)
    return best.ball, covariance


class _Logistic(NamedTuple):
    ball: Float[np.ndarray, "3"]
    likelihood: float
    information: Float[np.ndarray, "3 3"]
    scores: Float[np.ndarray, "n 3"]


def _logistic(
    pixels: Points,
    sign: Float[np.ndarray, " n"],
    ball: Float[np.ndarray, "3"],
    blur: float,
    intrinsics: Intrinsics,
) -> _Logistic:
    """Maximizes the likelihood of a logistic model by Newton's method with shorter steps."""

    def evaluate(ball: Float[np.ndarray, "3"]) -> _Logistic:
        depth, rows, _ = outline_distance(pixels, ball, intrinsics)
        wrong = expit(-sign * depth / blur)
        scores = rows * (sign * wrong / blur)[:, None]
        information = (rows * (wrong * (1 - wrong) / blur**2)[:, None]).T @ rows
        likelihood = -np.logaddexp(0, -sign * depth / blur).sum()
        return _Logistic(ball, float(likelihood), information, scores)

    now = evaluate(ball)
    for _ in range(30):
        slope = now.scores.sum(0)
        move = np.linalg.lstsq(now.information, slope, rcond=1e-12)[0]
        if move @ slope < 1e-6:
            break
        trials = (evaluate(now.ball + move * 0.5**k) for k in range(20))
        better = next((trial for trial in trials if trial.likelihood > now.likelihood), None)
        if better is None:
            break
        now = better
    return now


def _fit_coverage(
    pixels: Points,
    values: Float[np.ndarray, " n"],
    ball: Float[np.ndarray, "3"],
    intrinsics: Intrinsics,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Fits the covered areas of pixels by least squares; the blur of the edge is free."""
    width = np.sqrt(PIXEL)
    rows, residual = np.zeros((0, 4)), np.zeros(0)
    for _ in range(20):
        depth, by_ball, _ = outline_distance(pixels, ball, intrinsics)
        # the mean depth of an area is less than that of its centre, as the outline is curved
        depth = depth - width**2 / (2 * ball[2])
        cover, by_depth = step(depth, width)
        rows = np.column_stack([by_ball, -depth / width]) * by_depth[:, None]
        residual = values - cover
        move = np.linalg.lstsq(rows, residual, rcond=1e-10)[0]
        ball, width = ball + move[:3], max(width + move[3], 0.1)
        if np.abs(move).max() < 1e-8:
            break
    variance = max(residual @ residual / (len(values) - 4), 1e-12)
    scores = rows * (residual / variance)[:, None]
    blocks = block_of(pixels, ball)
    return ball, inflated(rows.T @ rows / variance, scores, blocks, least=1.0)[:3, :3]


def block_of(pixels: Points, ball: Float[np.ndarray, "3"]) -> np.ndarray:
    """Returns which block of the outline each pixel belongs to."""
    return sectors_of(pixels, ball, _BLOCKS)


def inflated(
    information: Float[np.ndarray, "p p"],
    scores: Float[np.ndarray, "n p"],
    blocks: np.ndarray,
    *,
    least: float,
) -> Float[np.ndarray, "p p"]:
    """Returns the covariance of a fit whose residuals hang together within blocks.

    The inverse of the information, times how much more the scores of blocks vary than those of
    independent residuals would: the trace of the sandwich estimator (Cameron and Miller 2015,
    "A practitioner's guide to cluster-robust inference", with their small-sample factor).

    **Arguments:** `scores`: derivatives of the log-likelihood, a row for each residual. `least`:
    the least factor.
    """
    count, parameters = len(np.unique(blocks)), len(information)
    sums = np.zeros((int(blocks.max()) + 1, parameters))
    np.add.at(sums, blocks, scores)
    inverse = np.linalg.pinv(information, hermitian=True)
    excess = np.trace(inverse @ (sums.T @ sums)) / parameters
    return inverse * max(least, excess * count / max(count - parameters, 1))
