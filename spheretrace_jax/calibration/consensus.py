"""Random sample consensus: the ball whose outline runs along most edges of a picture.

Three points of an outline determine the ball. Their rays d satisfy d . w = |d|, with w the
direction of the ball's centre divided by the cosine of its angular radius; of an orthographic
camera the points lie on a circle. Both are linear (Fischler and Bolles 1981, for the search).
"""

import numpy as np
from jaxtyping import Bool, Float

from .camera import Intrinsics
from .conic import outline_distance

Points = Float[np.ndarray, "points 2"]

# How many triples of points are tried. With a tenth of the points on the outline 60 of them are.
_TRIPLES = 60_000

# How many outlines are handed on, the one with most support first.
_BEST = 40

# The least cosine between the normal of an edge and of the outline there: 18 degrees apart.
_ALIGNED = 0.95

# Into how many sectors the outline is divided to tell how much of it the edges cover.
SECTORS = 64

# From this focal length on, in pixels, the search takes the camera for orthographic: an outline
# 5000 pixels off the axis differs by 0.1 pixels, and the rays are too parallel to be told apart.
_LONG = 1e6


def find_outline(
    points: Points,
    normals: Points | None,
    intrinsics: Intrinsics,
    tolerance: float,
    near: Float[np.ndarray, "3"] | None = None,
    most_balls: int = 500,
) -> list[tuple[Float[np.ndarray, "3"], float]]:
    """Searches the outlines that most edges support.

    An outline's support is the length that edges cover, in pixels, times the share of its sectors
    that they cover: half a large outline counts more than the whole of a highlight inside of it.

    **Arguments:** `points`: (x, y) of edges. `normals`: unit normals of the edges, of either sign;
    None if they are not known. `tolerance`: how far an edge may lie off, pixels. `near`: (u, v, r),
    to within a quarter of the radius. `most_balls`: how many are looked at closely.

    **Returns:** (u, v, r) and the share of the outline that edges cover, of the best ones.
    """
    random = np.random.default_rng(0)
    triples = random.integers(0, len(points), (_TRIPLES, 3))
    balls, good = balls_through(points[triples], intrinsics)
    good &= (balls[:, 2] > 2) & (balls[:, 2] < 10 * np.ptp(points, axis=0).max() + 10)
    if near is not None:
        good &= np.abs(balls - near).max(1) < near[2] / 4
    if normals is not None:
        for i in range(3):
            radial = points[triples[:, i]] - balls[:, :2]
            cosine = np.abs((radial * normals[triples[:, i]]).sum(1))
            good &= cosine > _ALIGNED * np.linalg.norm(radial, axis=1)
    found = [
        (ball, covered_share(points, normals, ball, intrinsics, tolerance))
        for ball in balls[good][:most_balls]
    ]
    found.sort(key=lambda pair: -pair[0][2] * pair[1] ** 2)
    return found[:_BEST]


def covered_share(
    points: Points,
    normals: Points | None,
    ball: Float[np.ndarray, "3"],
    intrinsics: Intrinsics,
    tolerance: float,
) -> float:
    """Returns the share of an outline's sectors that edges cover, from 0 to 1."""
    depth, _, outward = outline_distance(points, ball, intrinsics)
    on = np.abs(depth) < tolerance
    if normals is not None:
        on &= np.abs((normals * outward).sum(1)) > _ALIGNED
    return np.unique(sectors_of(points[on], ball, SECTORS)).size / SECTORS


def sectors_of(points: Points, ball: Float[np.ndarray, "3"], count: int) -> np.ndarray:
    """Returns the number of the sector around the centre that each point lies in."""
    away = points - ball[:2]
    turn = np.arctan2(away[:, 1], away[:, 0]) / (2 * np.pi)
    return np.floor(turn % 1 * count).astype(int) % count


def refine_outline(
    points: Points,
    ball: Float[np.ndarray, "3"],
    intrinsics: Intrinsics,
    *,
    scales: tuple[float, ...],
) -> Float[np.ndarray, "3"]:
    """Fits an outline to points by robust least squares: Gauss-Newton with Welsch's weights.

    **Arguments:** `scales`: distances in pixels at which points begin to count little, one after
    the other, from coarse to fine.
    """
    for scale in scales:
        for _ in range(8):
            depth, rows, _ = outline_distance(points, ball, intrinsics)
            weight = np.exp(-0.5 * (depth / scale) ** 2)
            step = -np.linalg.lstsq(rows * weight[:, None], depth * weight, rcond=1e-10)[0]
            ball = ball + np.clip(step, -0.3 * ball[2], 0.3 * ball[2])
            if intrinsics.focal < np.inf:
                ball[2] = min(ball[2], 0.999 * intrinsics.focal)
            if np.abs(step).max() < 1e-9 * ball[2]:
                break
    return ball


def balls_through(
    points: Float[np.ndarray, "m 3 2"], intrinsics: Intrinsics
) -> tuple[Float[np.ndarray, "m 3"], Bool[np.ndarray, " m"]]:
    """Returns the balls whose outlines pass three points each, as (u, v, r), and which exist."""
    q = points - intrinsics.principal_point
    if intrinsics.focal > _LONG:
        middle = q.mean(1)
        x = q - middle[:, None]
        solution, good = _solve(
            np.concatenate([2 * x, np.ones((len(x), 3, 1))], -1), (x * x).sum(-1)
        )
        center = middle + solution[:, :2]
        square = solution[:, 2] + (solution[:, :2] ** 2).sum(1)
    else:
        rays = np.concatenate([q / intrinsics.focal, np.ones((len(q), 3, 1))], -1)
        w, good = _solve(rays, np.linalg.norm(rays, axis=-1))
        good &= w[:, 2] > 0
        depth = np.where(good, w[:, 2], 1)
        center = intrinsics.focal * w[:, :2] / depth[:, None]
        square = intrinsics.focal**2 * ((w * w).sum(1) - 1) / depth**2
        good &= square < intrinsics.focal**2
    good &= square > 0
    radius = np.sqrt(np.where(good, square, 1))
    return np.column_stack([center + intrinsics.principal_point, radius]), good


def _solve(
    rows: Float[np.ndarray, "m 3 3"], right: Float[np.ndarray, "m 3"]
) -> tuple[Float[np.ndarray, "m 3"], Bool[np.ndarray, " m"]]:
    """Solves linear systems; those that are singular get zeros."""
    lengths = np.prod(np.linalg.norm(rows, axis=-1), axis=-1)
    good = np.abs(np.linalg.det(rows)) > 1e-13 * lengths
    rows = np.where(good[:, None, None], rows, np.eye(3))
    solution = np.linalg.solve(rows, right[..., None])[..., 0]
    return np.where(good[:, None], solution, 0), good
