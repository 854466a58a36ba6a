"""Trust: whether a fit converged, lies inside its bounds, and explains the picture."""

import re
from collections.abc import Iterator
from functools import cached_property
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, PyTree

from ...base.types import Picture
from ..model.saturation import Plateau, plateaus
from ..model.target import SIGMA_OF_MEDIAN, Target
from ..problem.labels import CHANNELS, joined, labels_of, picture_suffix
from ..problem.problem import Problem, pictures_at
from .outliers import find_outliers, resting_on_outliers

# The structured residual, whose neighbours agree, as a part of the picture's root-mean-square, from
# which the scene does not explain the picture; and that of 8-bit pictures, whose rounding has a
# structure of up to half a level. Lower limits distrust fits for the errors of the file.
_UNEXPLAINED, _UNEXPLAINED_8_BIT = 1e-3, 1e-2

# How far the numbers of one level of an 8-bit picture are apart at most. Its levels, as sRGB has
# them where it is dark, are thirty times as far apart.
_ROUNDING = 1e-5

# The margin for chance, in standard deviations. Free numbers fit as much of any noise as there are
# of them, give or take this margin: a scene that fits no more of a picture explains nothing.
_CHANCE = 5

# The share of its power that noise may have in common with neighbours, in standard deviations of
# this share; it is taken off. Less would find structure in noise, 4 do so in one of 30,000.
_NOISE_SHARE = 4

# The residual from which a number is structure whatever its neighbours, in standard deviations of
# normal noise; and the residual to which robust losses' outliers are clipped.
_OUTLYING, _ROBUST_CLIP = 6, 3


class Trust(eqx.Module):
    """The verdict on a fit, and remarks."""

    ok: bool  #: converged, and explains the picture
    verdict: str  #: one sentence
    unexplained: float  #: the structured part of the residual, as a part of the picture; at most 1
    fit: Any  #: the `Fit` itself

    @cached_property
    def remarks(self) -> tuple[str, ...]:
        """Returns words for numbers at their bounds, and for what is not determined."""
        known, bounds = self.fit.identifiability, _at_bounds(self.fit)
        remarks = [f"at its bound: {', '.join(bounds)}"] if bounds else []
        if names := self.fit.problem.priors:
            remarks.append(f"what is known of {joined(names)} counts: priors, as given")
        return (*remarks, *known.undetermined, *known.weak)

    def __str__(self) -> str:
        return "\n".join([self.verdict, *together(self.remarks)])


def together(sentences: tuple[str, ...]) -> list[str]:
    """Merges sentences that say the same of several spheres."""
    spheres: dict[str, list[str]] = {}
    for sentence in sentences:
        subject, colon, remark = sentence.partition(": ")
        sphere = re.fullmatch(r"sphere (\d+)", subject) if colon else None
        spheres.setdefault(remark if sphere else sentence, []).append(sphere[1] if sphere else "")
    return [
        remark if not of[0] else f"sphere{'s' * (len(of) > 1)} {', '.join(of)}: {remark}"
        for remark, of in spheres.items()
    ]


def judge(fit) -> Trust:
    """Returns what to think of a `Fit`."""
    structures = _structures(fit.problem, fit.values)
    worst = int(np.argmax([share for share, _, _ in structures]))
    unexplained, where, limit = structures[worst]
    explains = unexplained <= limit
    nothing = _explains_nothing(fit)
    ok, resting = fit.converged and not fit.interrupted and explains and not nothing, []
    if ok:
        outliers = find_outliers(fit.problem, fit.values, fit.cost)
        resting = resting_on_outliers(outliers, fit.problem, fit.values)
    misfit = np.sqrt(2 * fit.cost / fit.counted) if fit.counted else float("nan")
    left_out = f"; {fit.left_out} numbers left out" if fit.left_out else ""
    left_out += "".join(_saturation(fit))
    if fit.interrupted:
        end = f"{fit.result_message}: the best scene so far"
    elif not fit.converged:
        end = f"NOT converged ({fit.result_message})"
    elif not explains:
        picture = f" {worst + 1}" if len(fit.scenes) > 1 else ""
        left = f"{unexplained:.1%} left, {where}"
        if unexplained >= 1:
            left = "it is no nearer than a black one"
        end = f"converged, but does NOT explain picture{picture}: {left}"
        if fit.stopped_by == "max_steps":
            end += "; max_steps is reached, not all was tried"
    elif nothing:
        end = "converged, but explains NO more of the picture than it would of noise"
    elif resting:
        end = f"converged, but what tells of {joined(resting)} does NOT fit"
    else:
        end = "converged"
    verdict = f"{end} after {fit.steps} steps, root-mean-square residual {misfit:.2e}{left_out}"
    return Trust(ok=ok and not resting, verdict=verdict, unexplained=unexplained, fit=fit)


def _explains_nothing(fit) -> bool:
    """Returns whether the fit leaves as much of the pictures as it would of noise."""
    power, left = fit.problem.norm**2, 2 * fit.cost
    free = fit.problem.at_bounds(fit.values).size
    if not power or fit.problem.targets[0].loss != "square":
        return False
    chance = (free + _CHANCE * np.sqrt(2 * free)) * left / fit.counted
    return bool(power - left <= chance)


def explains(problem: Problem, values: PyTree, cost: float) -> bool:
    """Returns whether values of a known cost explain the pictures."""
    # whatever its structure, no more is left than all of the residual
    most = (np.sqrt(2 * cost / t.counted) / _scale(t) for t in problem.targets)
    if all(share <= _UNEXPLAINED for share in most):
        return True
    return all(share <= limit for share, _, limit in _structures(problem, values))


def _scale(target: Target) -> float:
    """Returns what misfits are divided by; 1 for a black picture."""
    return target.rms or 1.0


def _saturation(fit) -> Iterator[str]:
    """Yields words for the many numbers that stand at the top of channels."""
    for k, target in enumerate(fit.problem.targets):
        where = picture_suffix(k) if len(fit.problem.targets) > 1 else ""
        image, weight = np.asarray(target.image), np.asarray(target.weight)
        # numbers that do not count for other reasons are 0 in the image
        tops = plateaus(image, np.full(image.shape, True))
        count = [bool((weight[..., top.channel] > 0)[top.at].any()) for top in tops]
        if any(not c for c in count):
            at = [_level(top) for top, c in zip(tops, count, strict=True) if not c]
            yield f"; saturated{where}: {joined(at)}"
        if any(count) and not fit.brightest_given:
            at = [_level(top) for top, c in zip(tops, count, strict=True) if c]
            yield (
                f"; NOTE many numbers{where} stand at the top of {joined(at)}, and count: a flat "
                "area, or saturated? (brightest=)"
            )


def _level(top: Plateau) -> str:
    return f"{CHANNELS[top.channel]} at {top.level:.6g} ({np.count_nonzero(top.at)} numbers)"


def _at_bounds(fit) -> list[str]:
    at = np.asarray(fit.problem.at_bounds(fit.values))
    return list(dict.fromkeys(labels_of(fit.problem)[at]))


def _structures(problem: Problem, values: PyTree) -> list[tuple[float, str, float]]:
    """Returns of each picture how much structure its residual has, where, and how much may be."""
    pairs = zip(problem.targets, pictures_at(problem, values), strict=True)
    return [_structure(target, *picture) for target, picture in pairs]


def _structure(
    target: Target, picture: Picture, exposure: Float[Array, " 3"]
) -> tuple[float, str, float]:
    """Returns the structure of a residual, as a part of the picture; where; and how much may be.

    Noise has none: its numbers agree with no neighbours and have no outliers. The structure is the
    share of the power that the right and lower neighbours have too, and the power of outliers.
    """
    residual = np.asarray(target.misfit(picture, exposure), np.float64)
    robust = target.loss != "square"
    if robust:  # outliers are no fault of the scene's
        clip = _ROBUST_CLIP * float(target.noise)
        residual = np.clip(residual, -clip, clip)
    counts = np.asarray(target.weight) > 0
    shared, power, pairs = 0.0, 0.0, 0
    for a, b in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        both = counts[a] & counts[b]
        shared += np.sum(residual[a] * residual[b] * both)
        power += np.sum((residual[a] ** 2 + residual[b] ** 2) * both) / 2
        pairs += np.sum(both)
    share = shared / power - _NOISE_SHARE / np.sqrt(pairs) if power > 0 else 0.0
    square = residual[counts] ** 2
    limit = np.inf if robust else _OUTLYING**2 * SIGMA_OF_MEDIAN**2 * np.median(square)
    outliers = np.where(square > limit, square, 0)
    structure = max(share, 0) * np.mean(square - outliers) + np.mean(outliers)
    row, column = np.unravel_index(_smooth_power(residual).argmax(), residual.shape[:2])
    return (
        min(float(np.sqrt(structure) / _scale(target)), 1.0),
        f"most of it near column {column}, row {row}",
        _UNEXPLAINED_8_BIT if _has_8_bits(np.asarray(target.image)) else _UNEXPLAINED,
    )


def _has_8_bits(image: np.ndarray) -> bool:
    """Tests whether a picture has no more than 256 levels, give or take rounding."""
    values = np.unique(image)
    # neighbouring levels of 8 bits are further apart than rounding, also where it is dark
    first = np.flatnonzero(np.diff(values, prepend=-np.inf) > _ROUNDING)
    last = np.append(first[1:], len(values)) - 1
    return len(first) <= 256 and bool(np.all(values[last] - values[first] <= _ROUNDING))


def _smooth_power(residual: np.ndarray) -> np.ndarray:
    """Returns the residual's power, summed over a pixel and its eight neighbours."""
    power = np.pad(np.sum(residual**2, axis=-1), 1)
    height, width = residual.shape[:2]
    near = [power[i : i + height, j : j + width] for i in range(3) for j in range(3)]
    return np.sum(near, axis=0)
