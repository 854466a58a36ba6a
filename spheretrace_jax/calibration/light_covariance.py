"""How far a ball's light may be off: noise, shaped residuals, rival models and the outline.

A fit of thousands of pixels is precise, and wrong where its model is. So what enters is how the
answer moves: between blocks of the ball (delete-a-group jackknife) and between its halves, which
residuals with a shape pull apart; between highlights of other shapes and other weights, as far as
these explain the picture about as well; and with the ball's outline.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import chi2

from ..fit.diagnosis.block_jackknife import NormalSums
from .ball_radiance import COAT_IOR, BallSamples
from .light_solver import LightFit, WeightedRows, rows_at

#: Of what a light is known by: two turns (radians), the inverse distance (1/radii), and red, green
#: and blue of what a matt ball would show where it faces the light.
Covariance = Float[np.ndarray, "6 6"]
Step = Float[np.ndarray, "6"]

# Rows and columns of blocks of the ball.
_GRID = 4

# Rivals count in full where they explain the picture as well, and not where their cost is larger by
# this factor.
_WORSE = 2.0

# The least standard deviation of a direction in radians, 0.03 degrees: what blocks, halves and
# rivals cannot tell, as all of them share it.
_FLOOR = 5e-4


def light_covariance(
    fit: LightFit,
    samples: BallSamples,
    places: Int[np.ndarray, "2 samples"],
    free: Bool[np.ndarray, "6"],
    rivals: Sequence[tuple[LightFit, float]],
    moved: Sequence[BallSamples],
) -> Covariance:
    """Returns the covariance of a light: of turns, inverse distance and colour.

    **Arguments:** `fit`: one of several lanes. `places`: rows and columns of the samples in the
    picture. `free`: which unknowns no bound holds. `rivals`: other fits, and how many times larger
    their cost is. `moved`: the samples by an outline that is off by a standard deviation, along
    each axis of its covariance.
    """
    residual, columns, scale = _system(rows_at(fit, samples), free)
    size, vectors = np.linalg.eigh(columns.T @ columns)
    shows = size > size[-1] * 1e-10
    unwhiten = vectors[:, shows] / np.sqrt(size[shows])
    scale[3:] *= facing(fit)
    to_light = scale @ unwhiten  # from whitened steps of all unknowns to those of the light
    white = columns @ unwhiten

    def sums(part: Bool[np.ndarray, " rows"]) -> NormalSums:
        return NormalSums(white[part].T @ white[part], white[part].T @ residual[part])

    counted = np.asarray(samples.counts).ravel() > 0
    noise = residual @ residual / max(counted.sum() - columns.shape[1], 1)
    total = noise * to_light @ to_light.T + np.diag([_FLOOR**2, _FLOOR**2, 0, 0, 0, 0])
    every = np.ones(len(residual), bool)
    whole, blocks = sums(every), _blocks(places, np.asarray(samples.counts))
    left_out = [(whole - sums(blocks == b)).step for b in range(_GRID**2)]
    total += (1 - 1 / _GRID**2) * _squares([to_light @ step for step in left_out])
    for half in _halves(places, samples):
        apart = [to_light @ sums(side).step for side in (half, counted & ~half)]
        total += _squares(apart) / 2
    for rival, worse in rivals:
        weight = np.clip((_WORSE - worse) / (_WORSE - 1), 0, 1)
        total += weight * _squares([_difference(rival, fit)])
    for other in moved:
        change = np.asarray(rows_at(fit, other).residual, float).ravel() - residual
        total += _squares([to_light @ (white.T @ change)])
    return total


def confidence_radius(covariance: Float[np.ndarray, "2 2"], level: float = 0.95) -> float:
    """Returns the radius that holds a direction with a probability, in radians.

    Satterthwaite (1946): the squared distance is about a multiple of chi-squared.
    """
    size = np.maximum(np.linalg.eigvalsh(covariance), 0)
    mean, square = size.sum(), (size**2).sum()
    if not square > 0:
        return 0.0
    return float(np.sqrt(square / mean * chi2.ppf(level, mean**2 / square)))


def facing(fit: LightFit) -> float:
    """Returns the diffuse term of a point that faces light and camera: what passes the coat."""
    mirrored = ((COAT_IOR - 1) / (COAT_IOR + 1)) ** 2
    return float((1 - fit.unknowns[4] * mirrored) ** 2)


def _system(
    rows: WeightedRows, free: Bool[np.ndarray, "6"]
) -> tuple[
    Float[np.ndarray, " rows"], Float[np.ndarray, "rows columns"], Float[np.ndarray, "6 columns"]
]:
    """Returns the residual, its Jacobian, and how the light moves with the columns' unknowns.

    Columns are those of the free unknowns, then those of amplitudes above 0; of unit length.
    """
    residual = np.asarray(rows.residual, float)
    chosen = np.flatnonzero(free).tolist()
    columns = [np.asarray(rows.columns, float)[k].ravel() for k in chosen]
    moves = [np.eye(6)[k] if k < 3 else np.zeros(6) for k in chosen]
    for channel, term in np.argwhere(np.asarray(rows.amplitudes) > 0).tolist():
        column = np.zeros_like(residual)
        column[channel] = np.asarray(rows.terms, float)[channel, term]
        columns.append(column.ravel())
        moves.append(np.eye(6)[3 + channel] if term == 0 else np.zeros(6))
    length = np.linalg.norm(columns, axis=1)
    shows = length > 0
    unit = length[shows]
    matrix, scale = np.stack(columns, axis=1)[:, shows], np.stack(moves, axis=1)[:, shows]
    return residual.ravel(), matrix / unit, scale / unit


def _squares(steps: Sequence[Step]) -> Covariance:
    stacked = np.stack(steps)
    return stacked.T @ stacked


def _difference(rival: LightFit, fit: LightFit) -> Step:
    """Returns how a rival's light differs."""
    axes = np.asarray(fit.model.axes, float)
    here, there = (axes @ np.asarray(f.direction, float) for f in (fit, rival))
    turns = there[1:] / max(there[0], 0.1) - here[1:] / here[0]
    nearness = float(rival.unknowns[2] - fit.unknowns[2])
    there, here = (np.asarray(f.amplitudes, float)[:, 0] * facing(f) for f in (rival, fit))
    return np.concatenate([turns, [nearness], there - here])


def _blocks(places: Int[np.ndarray, "2 samples"], counts: np.ndarray) -> Int[np.ndarray, " rows"]:
    """Returns the block of each number: 16 parts of the ball with as many samples."""
    row, column = places
    strip = _part(row)
    block = np.full(len(row), -1)
    for k in range(_GRID):
        here = strip == k
        block[here] = _GRID * k + _part(column[here])
    return np.tile(block, len(counts))


def _part(x: np.ndarray) -> Int[np.ndarray, " n"]:
    """Returns which quarter numbers belong to, by their order."""
    rank = np.empty(len(x), int)
    rank[np.argsort(x, kind="stable")] = np.arange(len(x))
    return rank * _GRID // max(len(x), 1)


def _halves(
    places: Int[np.ndarray, "2 samples"], samples: BallSamples
) -> list[Bool[np.ndarray, " rows"]]:
    """Returns halves of the counted numbers: left, upper, dark."""
    counts = np.asarray(samples.counts) > 0
    grey = np.asarray(samples.values, float).mean(0)
    known = counts.any(0)
    below = lambda x: counts & (x < np.median(x[known]))
    return [below(x).ravel() for x in (places[1], places[0], grey)]
