"""The limb of a ball: a fit of its outline to the brightness on both sides.

On a ball the normal turns fastest at the outline: at depth d inside, brightness is a + b sqrt(d) +
c d to first orders, whatever the reflection. An edge detector would put the outline inside the
ball by up to half a pixel. So each piece of the outline has its own a, b, c, and a line outside;
all are blurred, and eliminated in closed form (variable projection, Golub and Pereyra 1973).
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .camera import Intrinsics
from .conic import outline_distance
from .consensus import Points, sectors_of
from .edge_model import PIXEL, power_profiles, shadow_profiles
from .outline import block_of, inflated, pixels_along

# Pixels on both sides of the outline that take part, and the length of its pieces in pixels.
_REACH, _PIECE = 5.0, 10.0
_FEWEST, _MOST = 12, 128

# Limits of the edge's width (a deviation), pixels: from the pixel itself to a blurred picture.
_SHARPEST, _BLURRED = np.sqrt(PIXEL), 4.0

# Depths in pixels at which the edge of a shadow is looked for, and by how much the logarithm of the
# residuals' variance must fall where one is found.
_KINKS = (0.0, 0.3, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 3.9)
_CLEARLY, _ROUNDS = 0.1, 4

# The least pixels of a piece: three for each of its profiles.
_LEAST_PIXELS = 27

# What simplifications of the model move outlines by, pixels: of 72 balls with radii of 21 to 32
# pixels, drawn under five lights before four backgrounds, 0.03 in the median and 0.1 at most.
_MODEL = 0.035

# Fits end when a step is shorter than this, pixels.
_STEP = 1e-4


class _Pieces(NamedTuple):
    """The pixels along an outline, sorted by the piece of the outline that they belong to."""

    pixels: Points
    values: Float[np.ndarray, "n channels"]
    along: Float[np.ndarray, " n"]  #: place along the piece, from -1 to 1
    ends: Int[np.ndarray, " pieces"]  #: where each piece ends


class _Step(NamedTuple):
    """A linear model of the fit at one place."""

    residuals: Float[np.ndarray, "n channels"]
    rows: Float[np.ndarray, "n channels 4"]  #: how the residuals shrink with the unknowns
    variances: Float[np.ndarray, "pieces channels"]


def fit_limb(
    picture: Float[np.ndarray, "height width channels"],
    ball: Float[np.ndarray, "3"],
    intrinsics: Intrinsics,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Fits the outline of a ball to a picture, from a start less than two pixels off.

    **Returns:** (u, v, r) and their covariance, in pixels.
    """
    pieces = _pieces(picture, ball, intrinsics)
    unknowns = np.array([*ball, 0.7])
    kinks = np.zeros(len(pieces.ends))
    unknowns, now = _solve(pieces, unknowns, intrinsics, kinks)
    for _ in range(_ROUNDS):
        before, kinks = kinks, _find_kinks(pieces, unknowns, intrinsics)
        if (kinks == before).all():
            break
        unknowns, now = _solve(pieces, unknowns, intrinsics, kinks)
    weights = _weights(pieces, now)
    rows, right = now.rows * weights[..., None], now.residuals * weights
    blocks = np.repeat(block_of(pieces.pixels, unknowns[:3]), rows.shape[1])
    rows = rows.reshape(-1, 4)
    covariance = inflated(rows.T @ rows, rows * right.reshape(-1, 1), blocks, least=1.0)
    return unknowns[:3], covariance[:3, :3] + _MODEL**2 * np.eye(3)


def _solve(
    pieces: _Pieces,
    unknowns: Float[np.ndarray, "4"],
    intrinsics: Intrinsics,
    kinks: Float[np.ndarray, " pieces"],
) -> tuple[Float[np.ndarray, "4"], _Step]:
    """Minimizes the squares by the method of Levenberg and Marquardt."""
    now, damping = _linearize(pieces, unknowns, intrinsics, kinks), 1e-3
    for _ in range(40):
        weights = _weights(pieces, now)
        rows, right = now.rows * weights[..., None], now.residuals * weights
        flat = rows.reshape(-1, 4)
        matrix, slope = flat.T @ flat, flat.T @ right.ravel()
        damped = matrix + damping * np.diag(np.diag(matrix))
        move = np.linalg.lstsq(damped, slope, rcond=1e-12)[0]
        trial = unknowns + np.clip(move, -1, 1)
        trial[3] = np.clip(trial[3], _SHARPEST, _BLURRED)
        new = _linearize(pieces, trial, intrinsics, kinks)
        if ((new.residuals * weights) ** 2).sum() <= (right**2).sum():
            length = np.abs(trial - unknowns).max()
            unknowns, now, damping = trial, new, damping / 10
            if length < _STEP:
                break
        else:
            damping *= 10
            if damping > 1e6:
                break
    return unknowns, now


def _pieces(
    picture: Float[np.ndarray, "height width channels"],
    ball: Float[np.ndarray, "3"],
    intrinsics: Intrinsics,
) -> _Pieces:
    """Collects the pixels along an outline and cuts it into pieces."""
    reach = min(_REACH, max(2.5, ball[2] / 4))
    rows, columns = pixels_along(ball, intrinsics, picture.shape[:2], reach)
    pixels = np.column_stack([columns, rows]) + 0.5
    near = np.abs(outline_distance(pixels, ball, intrinsics)[0]) < reach
    rows, columns, pixels = rows[near], columns[near], pixels[near]
    count = int(np.clip(round(2 * np.pi * ball[2] / _PIECE), _FEWEST, _MOST))
    piece = sectors_of(pixels, ball, count)
    order = np.argsort(piece, kind="stable")
    away = pixels[order] - ball[:2]
    turn = np.arctan2(away[:, 1], away[:, 0]) / (2 * np.pi) % 1 * count
    ends = np.cumsum(np.bincount(piece, minlength=count))
    values = picture[rows, columns][order]
    return _Pieces(pixels[order], values, 2 * (turn - piece[order]) - 1, ends)


def _linearize(
    pieces: _Pieces,
    unknowns: Float[np.ndarray, "4"],
    intrinsics: Intrinsics,
    kinks: Float[np.ndarray, " pieces"],
) -> _Step:
    """Eliminates the brightness of each piece and linearizes what is left."""
    depth, by_ball = _depths(pieces, unknowns, intrinsics)
    residuals = np.zeros_like(pieces.values)
    rows = np.zeros((*pieces.values.shape, 4))
    variances = np.full((len(pieces.ends), pieces.values.shape[1]), np.inf)
    for k, part in _parts(pieces):
        basis = _basis(depth[part], pieces.along[part], unknowns[3], kinks[k])
        values, by_depth, by_width = basis.transpose(0, 2, 1)
        left, coefficients = _eliminated(values, pieces.values[part])
        residuals[part] = pieces.values[part] - left @ (left.T @ pieces.values[part])
        slope = (by_depth @ coefficients)[..., None]
        change = slope * by_ball[part, None]
        change = np.concatenate([change, (by_width @ coefficients)[..., None]], -1)
        flat = change.reshape(len(left), -1)
        rows[part] = (flat - left @ (left.T @ flat)).reshape(change.shape)
        variances[k] = (residuals[part] ** 2).sum(0) / max(len(left) - left.shape[1], 1)
    return _Step(residuals, rows, variances)


def _find_kinks(
    pieces: _Pieces, unknowns: Float[np.ndarray, "4"], intrinsics: Intrinsics
) -> Float[np.ndarray, " pieces"]:
    """Finds the pieces where a shadow ends a little inside of the outline.

    Seen from there the light is just below the horizon, and the outline itself is dark.

    **Returns:** depths of the shadows' edges in pixels, 0 where the brightness has no kink.
    """
    depth, _ = _depths(pieces, unknowns, intrinsics)
    kinks = np.zeros(len(pieces.ends))
    for k, part in _parts(pieces):
        costs = []
        for kink in _KINKS:
            basis = _basis(depth[part], pieces.along[part], unknowns[3], kink)[0].T
            left, _ = _eliminated(basis, pieces.values[part])
            residuals = pieces.values[part] - left @ (left.T @ pieces.values[part])
            variance = (residuals**2).sum(0) / max(len(left) - left.shape[1], 1)
            costs.append(np.log(np.maximum(variance, 1e-12)).sum())
        best = int(np.argmin(costs))
        kinks[k] = _KINKS[best] if costs[best] < costs[0] - _CLEARLY else 0
    return kinks


def _parts(pieces: _Pieces) -> Iterator[tuple[int, slice]]:
    """Yields number and pixels of the pieces that have enough pixels."""
    starts = np.concatenate([[0], pieces.ends[:-1]])
    for k, (start, end) in enumerate(zip(starts, pieces.ends, strict=True)):
        if end - start >= _LEAST_PIXELS:
            yield k, slice(start, end)


def _depths(
    pieces: _Pieces, unknowns: Float[np.ndarray, "4"], intrinsics: Intrinsics
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Returns mean depths of the pixels' blurred areas, and derivatives by (u, v, r).

    They are less than those of the centres, as the outline is curved.
    """
    depth, by_ball, _ = outline_distance(pieces.pixels, unknowns[:3], intrinsics)
    return depth - unknowns[3] ** 2 / (2 * unknowns[2]), by_ball


def _basis(
    depth: Float[np.ndarray, " n"], along: Float[np.ndarray, " n"], width: float, kink: float
) -> Float[np.ndarray, "3 profiles n"]:
    """Returns the profiles that the brightness of a piece is made of.

    **Returns:** values, derivatives by depth, derivatives by width.
    """
    inside = np.stack(power_profiles(depth, width))
    outside = np.stack(power_profiles(-depth, width))[:, [0, 2]] * _SIGNS
    both = [inside, outside, along * inside[:, :2], along * outside[:, :1]]
    if kink:
        shadow = np.stack(shadow_profiles(depth, width, kink))
        both = [inside[:, :1], shadow, outside, along * shadow, along * outside[:, :1]]
    return np.concatenate(both, 1)


def _eliminated(
    basis: Float[np.ndarray, "n profiles"], values: Float[np.ndarray, "n channels"]
) -> tuple[Float[np.ndarray, "n rank"], Float[np.ndarray, "profiles channels"]]:
    """Returns an orthonormal basis, and the coefficients of least squares."""
    left, size, right = np.linalg.svd(basis, full_matrices=False)
    keep = size > 1e-6 * size[0]
    left, size, right = left[:, keep], size[keep], right[keep]
    return left, right.T @ ((left.T @ values) / size[:, None])


#: Signs of values, derivatives by depth, and by width, of profiles outside.
_SIGNS = np.array([1.0, -1, 1])[:, None, None]


def _weights(pieces: _Pieces, step: _Step) -> Float[np.ndarray, "n channels"]:
    """Returns the inverse deviations of the pieces' noise, zero for pieces left out.

    Pieces without any noise, black ones say, count no more than a tenth of the median allows.
    """
    known = step.variances[np.isfinite(step.variances)]
    floor = (0.1**2 * np.median(known) if known.size else 0) or 1e-12
    weights = 1 / np.sqrt(step.variances + floor)
    sizes = np.diff(pieces.ends, prepend=0)
    return np.repeat(weights, sizes, axis=0)
