"""The structure of residuals: what neighbours share, and outliers; white noise has neither.

Noise of neighbouring pixels is independent: their residuals agree by chance only (Moran's test of
spatial correlation, 1950). What a scene does not explain of a picture has a shape.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from ...base.types import Picture
from ..model.target import SIGMA_OF_MEDIAN, Target
from ..problem.problem import Problem, pictures_at

# The structured residual, whose neighbours agree, as a part of the picture's root-mean-square, up
# to which a scene explains the picture; and that of 8-bit pictures, whose rounding has a structure
# of up to half a level. Lower limits distrust fits for the errors of the file.
_UNEXPLAINED, _UNEXPLAINED_8_BIT = 1e-3, 1e-2

# How far the numbers of one level of an 8-bit picture are apart at most. Its levels, as sRGB has
# them where it is dark, are thirty times as far apart.
_ROUNDING = 1e-5

# The share of its power that noise, also one that varies over the picture, may have in common with
# neighbours, in standard deviations of this share; it is taken off. Less would find structure in
# noise, 4 do so in one of 30,000.
_NOISE_SHARE = 4

# The residual from which a number is structure whatever its neighbours, in standard deviations of
# normal noise; and the residual to which robust losses' outliers are clipped.
_OUTLYING, _ROBUST_CLIP = 6, 3

# The distance from an object's middle, in halves of its width and height, from which words say on
# which side of it something is.
_ASIDE = 0.35


class Structure(NamedTuple):
    """The structured part of a picture's residual."""

    unexplained: float  #: as a part of the picture's root-mean-square, at most 1
    limit: float  #: up to which the scene explains the picture
    shared: bool  #: whether neighbours agree by more than noise does
    row: int  #: where most of it is
    column: int
    power: Float[np.ndarray, "height width"]  #: the residual's, summed with the eight neighbours'

    @property
    def explains(self) -> bool:
        """Tells whether the scene explains the picture."""
        return self.unexplained <= self.limit


def structures(problem: Problem, values: PyTree) -> list[Structure]:
    """Returns how much structure the residual of each picture has, and where."""
    pairs = zip(problem.targets, pictures_at(problem, values), strict=True)
    return [structure(target, *picture) for target, picture in pairs]


def structure(target: Target, picture: Picture, exposure: Float[Array, " 3"]) -> Structure:
    """Returns the structure of a residual.

    It is the share of the power that the right and lower neighbours have too, and the power of
    outliers.
    """
    residual = np.asarray(target.misfit(picture, exposure), np.float64)
    robust = target.loss != "square"
    if robust:  # outliers are no fault of the scene's
        clip = _ROBUST_CLIP * float(target.noise)
        residual = np.clip(residual, -clip, clip)
    counts = np.asarray(target.weight) > 0
    shared, power, chance = 0.0, 0.0, 0.0
    for a, b in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        both = counts[a] & counts[b]
        products = residual[a] * residual[b] * both
        shared += np.sum(products)
        chance += np.sum(products**2)
        power += np.sum((residual[a] ** 2 + residual[b] ** 2) * both) / 2
    share = (shared - _NOISE_SHARE * np.sqrt(chance)) / power if power > 0 else 0.0
    # black numbers that are drawn black are no example of how well others fit
    shows = counts & ((np.asarray(target.image) != 0) | (residual != 0))
    square = residual[shows if shows.any() else counts] ** 2
    outlying = np.inf if robust else _OUTLYING**2 * SIGMA_OF_MEDIAN**2 * np.median(square)
    outliers = np.where(square > outlying, square, 0)
    structured = max(share, 0) * np.sum(square - outliers) + np.sum(outliers)
    smooth = _smooth_power(residual)
    row, column = np.unravel_index(smooth.argmax(), smooth.shape)
    limit = _UNEXPLAINED_8_BIT if has_8_bits(np.asarray(target.image)) else _UNEXPLAINED
    unexplained = float(np.sqrt(structured / np.count_nonzero(counts)) / scale_of(target))
    if not target.rms and unexplained > limit:  # of black nothing is explained in part
        unexplained = 1.0
    return Structure(
        min(unexplained, 1.0),
        limit,
        bool(share > 0),
        int(row),
        int(column),
        smooth,
    )


def explains(problem: Problem, values: PyTree, cost: float) -> bool:
    """Returns whether values of a known cost explain the pictures."""
    # whatever its structure, no more is left than all of the residual
    most = (np.sqrt(2 * cost / t.counted) / scale_of(t) for t in problem.targets)
    if all(share <= _UNEXPLAINED for share in most):
        return True
    return all(found.explains for found in structures(problem, values))


def scale_of(target: Target) -> float:
    """Returns what misfits are divided by; 1 for a black picture."""
    return target.rms or 1.0


def has_8_bits(image: np.ndarray) -> bool:
    """Tests whether a picture has no more than 256 levels, give or take rounding."""
    values = np.unique(image)
    # neighbouring levels of 8 bits are further apart than rounding, also where it is dark
    first = np.flatnonzero(np.diff(values, prepend=-np.inf) > _ROUNDING)
    last = np.append(first[1:], len(values)) - 1
    return len(first) <= 256 and bool(np.all(values[last] - values[first] <= _ROUNDING))


def place_in_words(found: Structure, objects: Int[np.ndarray, "height width"], spheres: int) -> str:
    """Returns on which object most of a residual is, on which side of it, and how much of all.

    **Arguments:** `objects`: of each pixel the object's number, spheres first, -1 for none.
    """
    here = objects == objects[found.row, found.column]
    number = int(objects[found.row, found.column])
    name = "the background" if number < 0 else f"sphere {number + 1}"
    if number >= spheres:
        name = f"plane {number - spheres + 1}"
    share = found.power[here].sum() / (found.power.sum() or 1)
    part = f", {share:.0%} of it" if share < 0.995 else ""
    return f"{name}{_side_of(here, found.row, found.column) if number >= 0 else ''}{part}"


def _side_of(here: np.ndarray, row: int, column: int) -> str:
    """Returns words for a place within an object: its side, and whether it is at its outline."""
    words = []
    for at, x, names in ((1, row, ("upper", "lower")), (0, column, ("left", "right"))):
        inside = np.flatnonzero(here.any(axis=at))
        first, last = inside[0], inside[-1]
        off = (2 * x - first - last) / max(last - first, 1)
        words += [names[int(off > 0)]] if abs(off) > _ASIDE else []
    near = np.pad(here, 1)[row : row + 3, column : column + 3]
    outline = " at its outline" if not near.all() else ""
    return f", {' '.join(words) or 'middle'}{outline}"


def _smooth_power(residual: np.ndarray) -> np.ndarray:
    """Returns the residual's power, summed over a pixel and its eight neighbours."""
    power = np.pad(np.sum(residual**2, axis=-1), 1)
    height, width = residual.shape[:2]
    near = [power[i : i + height, j : j + width] for i in range(3) for j in range(3)]
    return np.sum(near, axis=0)
