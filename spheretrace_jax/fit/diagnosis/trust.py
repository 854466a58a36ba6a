"""Whether a fit is what it seems to be: converged, inside its bounds, explaining the picture."""

import re
from functools import cached_property
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, PyTree

from ...base.types import Picture
from ..model.target import Target
from ..problem.labels import joined, labels_of
from ..problem.problem import Problem
from .outliers import find_outliers, resting_on_outliers

# A residual whose neighbours agree is no noise: of this part of the picture, or of 8-bit ones of
# that, it says that the scene does not explain the picture.
_UNEXPLAINED, _UNEXPLAINED_8_BIT = 1e-3, 1e-2

# Free numbers fit as much of any noise as there are of them, give or take so many standard
# deviations: a scene that fits no more than that of a picture explains nothing.
_CHANCE = 5


class Trust(eqx.Module):
    """What to think of a fit."""

    ok: bool  #: converged, and explains the picture
    verdict: str  #: one sentence
    unexplained: float  #: the structured part of the residual, as a part of the picture
    fit: Any  #: the `Fit` itself

    @cached_property
    def remarks(self) -> tuple[str, ...]:
        """Numbers at their bounds, and what is not determined."""
        known, bounds = self.fit.identifiability, _at_bounds(self.fit)
        remarks = [f"at its bound: {', '.join(bounds)}"] if bounds else []
        return (*remarks, *known.undetermined, *known.weak)

    def __str__(self) -> str:
        return "\n".join([self.verdict, *together(self.remarks)])


def together(sentences: tuple[str, ...]) -> list[str]:
    """Sentences of which those that say the same of several spheres are said once."""
    spheres: dict[str, list[str]] = {}
    for sentence in sentences:
        who, colon, what = sentence.partition(": ")
        one = re.fullmatch(r"sphere (\d+)", who) if colon else None
        spheres.setdefault(what if one else sentence, []).append(one[1] if one else "")
    return [
        what if not who[0] else f"sphere{'s' * (len(who) > 1)} {', '.join(who)}: {what}"
        for what, who in spheres.items()
    ]


def judge(fit) -> Trust:
    """What to think of a `Fit`."""
    parts = _unexplained(fit.problem, fit.values)
    worst = int(np.argmax([part for part, _, _ in parts]))
    unexplained, where, limit = parts[worst]
    explains = unexplained <= limit
    nothing = _explains_nothing(fit)
    ok, resting = fit.converged and not fit.interrupted and explains and not nothing, []
    if ok:
        off = find_outliers(fit.problem, fit.values, fit.cost)
        resting = resting_on_outliers(off, fit.problem, fit.values)
    misfit = np.sqrt(2 * fit.cost / fit.counted) if fit.counted else float("nan")
    left_out = f"; {fit.left_out} numbers left out" if fit.left_out else ""
    if fit.interrupted:
        end = "interrupted: the best scene so far"
    elif not fit.converged:
        end = f"NOT converged ({fit.result_message.split('.')[0].strip()})"
    elif not explains:
        picture = f" {worst + 1}" if len(fit.scenes) > 1 else ""
        end = f"converged, but does NOT explain picture{picture}: {unexplained:.1%} left, {where}"
    elif nothing:
        end = "converged, but explains NO more of the picture than it would of noise"
    elif resting:
        end = f"converged, but what tells of {joined(resting)} does NOT fit"
    else:
        end = "converged"
    verdict = f"{end} after {fit.steps} steps, root-mean-square residual {misfit:.2e}{left_out}"
    return Trust(ok=ok and not resting, verdict=verdict, unexplained=unexplained, fit=fit)


def _explains_nothing(fit) -> bool:
    """Whether the fit leaves as much of the pictures as it would of noise."""
    all_of_it, left = fit.problem.length**2, 2 * fit.cost
    free = fit.problem.at_bounds(fit.values).size
    if not all_of_it or fit.problem.targets[0].loss != "square":
        return False
    chance = (free + _CHANCE * np.sqrt(2 * free)) * left / fit.counted
    return bool(all_of_it - left <= chance)


def explains(problem: Problem, values: PyTree, cost: float) -> bool:
    """Whether some values, of a known cost, explain the pictures."""
    # whatever its structure, no more is left than all of it
    most = (np.sqrt(2 * cost / t.counted) / _size(t) for t in problem.targets)
    if all(part <= _UNEXPLAINED for part in most):
        return True
    return all(part <= limit for part, _, limit in _unexplained(problem, values))


def _size(target: Target) -> float:
    """What misfits are parts of: of a black picture they are no parts."""
    return target.size or 1.0


def _at_bounds(fit) -> list[str]:
    at = np.asarray(fit.problem.at_bounds(fit.values))
    return list(dict.fromkeys(labels_of(fit.problem)[at]))


def _unexplained(problem: Problem, values: PyTree) -> list[tuple[float, str, float]]:
    """Of each picture the structured part of its residual, where most of it is, and how much is
    too much.
    """
    pairs = zip(problem.targets, problem.pictures(values), strict=True)
    return [_structure(target, *picture) for target, picture in pairs]


def _structure(
    target: Target, picture: Picture, exposure: Float[Array, " 3"]
) -> tuple[float, str, float]:
    """What of a residual is no noise, whose numbers agree with no neighbours and have no outliers.

    The structure is the part of the power that is shared with the right and lower neighbours, and
    that of numbers beyond six standard deviations, as the median has them.
    """
    residual = np.asarray(target.misfit(picture, exposure), np.float64)
    robust = target.loss != "square"
    if robust:  # outliers are no fault of the scene's
        residual = np.clip(residual, -3 * float(target.noise), 3 * float(target.noise))
    counts = np.asarray(target.weight) > 0
    shared, power, pairs = 0.0, 0.0, 0
    for a, b in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        both = counts[a] & counts[b]
        shared += np.sum(residual[a] * residual[b] * both)
        power += np.sum((residual[a] ** 2 + residual[b] ** 2) * both) / 2
        pairs += np.sum(both)
    share = shared / power - 4 / np.sqrt(pairs) if power > 0 else 0.0
    square = residual[counts] ** 2
    most = np.inf if robust else 36 * 1.4826**2 * np.median(square)
    outliers = np.where(square > most, square, 0)
    structure = max(share, 0) * np.mean(square) + np.mean(outliers)
    row, column = np.unravel_index(_smooth(residual).argmax(), residual.shape[:2])
    # neighbouring levels of 8 bits are further apart than rounding, also where it is dark
    coarse = len(np.unique(np.round(np.asarray(target.image), 5))) <= 256
    return (
        float(np.sqrt(structure) / _size(target)),
        f"most of it near column {column}, row {row}",
        _UNEXPLAINED_8_BIT if coarse else _UNEXPLAINED,
    )


def _smooth(residual: np.ndarray) -> np.ndarray:
    """The residual's power, averaged over a pixel and its eight neighbours."""
    power = np.pad(np.sum(residual**2, axis=-1), 1)
    height, width = residual.shape[:2]
    near = [power[i : i + height, j : j + width] for i in range(3) for j in range(3)]
    return np.sum(near, axis=0)
