"""Trust: whether a fit converged, lies inside its bounds, and explains the picture."""

import re
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any, Literal

import equinox as eqx
import numpy as np

from ..model.saturation import Plateau, plateaus
from ..problem.labels import CHANNELS, joined, labels_of, picture_suffix
from .color_space import better_numbers
from .effects import effects
from .evidence import objects_at
from .outliers import find_outliers, resting_on_outliers
from .residual_structure import place_in_words, structures

# The margin for chance, in standard deviations. Free numbers fit as much of any noise as there are
# of them, give or take this margin: a scene that fits no more of a picture explains nothing.
_CHANCE = 5

# The part of the tolerance up to which a fit is good.
_GOOD = 0.25

Grade = Literal["exact", "good", "usable", "not to be used"]
"""How far a fit is to be trusted."""


class Trust(eqx.Module):
    """The verdict on a fit, and remarks.

    Its grade is `"exact"` where the scene explains all of the pictures but noise: what is left has
    no structure above 0.1 % of their root-mean-square, in pictures of 8 bits 1 %. It is `"good"`
    where the structured rest is at most a quarter of the tolerance, `"usable"` at most the
    tolerance: standard deviations then say what the rest may do to each number. Else, and if the
    fit did not converge, it is `"not to be used"`.
    """

    ok: bool  #: unless the grade is "not to be used"
    grade: Grade
    verdict: str  #: one sentence
    unexplained: float  #: the structured part of the residual, as a part of the picture; at most 1
    fit: Any  #: the `Fit` itself

    @property
    def explained(self) -> float:
        """Returns the part of the picture's mean square that the scene explains, but for noise."""
        return 1 - self.unexplained**2

    @cached_property
    def effects(self) -> tuple[str, ...]:
        """Returns in words what the unexplained rest may do to lights and materials.

        Standard deviations of directions in degrees, of others in their units; empty where the
        grade is exact or the fit not to be used.
        """
        rest = self.grade in ("good", "usable")
        return effects(self.fit.problem, self.fit.uncertainty) if rest else ()

    @cached_property
    def other_numbers(self) -> str | None:
        """Returns as what the picture's numbers fit much better, if so: another colour space."""
        fit = self.fit
        if self.grade == "exact" or not fit.converged or fit.interrupted:
            return None
        return better_numbers(fit.problem, fit.values)

    @cached_property
    def remarks(self) -> tuple[str, ...]:
        """Returns words for numbers at their bounds, and for what is not determined."""
        known, bounds = self.fit.identifiability, _at_bounds(self.fit)
        remarks = [f"what is left may move {words}" for words in self.effects]
        if words := self.other_numbers:
            remarks.append(f"the picture fits better if its numbers are taken as {words}")
        remarks += [f"at its bound: {', '.join(bounds)}"] if bounds else []
        if names := self.fit.problem.priors:
            remarks.append(f"what is known of {joined(names)} counts: priors, as given")
        for k, (a, b) in enumerate(self.fit.photo_noise):
            of = picture_suffix(k) if len(self.fit.photo_noise) > 1 else ""
            remarks.append(f"noise{of} of variance {a:.2g} + {b:.2g} I, from the picture itself")
        return (*remarks, *known.undetermined, *known.weak)

    def __str__(self) -> str:
        return "\n".join([self.verdict, *together(self.remarks)])


def together(sentences: Sequence[str]) -> list[str]:
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
    found = structures(fit.problem, fit.values)
    worst = int(np.argmax([one.unexplained for one in found]))
    unexplained, exact = found[worst].unexplained, found[worst].explains
    nothing = _explains_nothing(fit)
    ended = fit.converged and not fit.interrupted
    grade, resting = _grade(unexplained, exact, fit.tolerance), []
    if not ended or nothing:
        grade = "not to be used"
    if grade == "exact":
        outliers = find_outliers(fit.problem, fit.values, fit.cost)
        resting = resting_on_outliers(outliers, fit.problem, fit.values)
        grade = "not to be used" if resting else grade
    misfit = np.sqrt(2 * fit.cost / fit.counted) if fit.counted else float("nan")
    left_out = f"; {fit.left_out} numbers left out" if fit.left_out else ""
    left_out += "".join(_saturation(fit))
    if fit.interrupted:
        end = f"{fit.result_message}: the best scene so far"
    elif not fit.converged:
        end = f"NOT converged ({fit.result_message})"
    elif not exact:
        picture = f" {worst + 1}" if len(fit.scenes) > 1 else ""
        where = f"most of it near column {found[worst].column}, row {found[worst].row}"
        if ended and np.isfinite(fit.cost):
            objects = objects_at(fit.problem, fit.values)[worst]
            of = place_in_words(found[worst], objects, len(fit.scenes[worst].spheres))
            where += f" ({of})"
        left = f"{unexplained:.1%} left, {where}"
        if unexplained >= 1:
            left = "it is no nearer than a black one"
        if grade == "not to be used":
            end = f"converged, but does NOT explain picture{picture}: {left}"
        else:
            end = (
                f"converged, {grade}: explains {1 - unexplained**2:.2%} of picture{picture}, {left}"
            )
        if fit.stopped_by == "max_steps":
            end += "; max_steps is reached, not all was tried"
    elif nothing:
        end = "converged, but explains NO more of the picture than it would of noise"
    elif resting:
        end = f"converged, but what tells of {joined(resting)} does NOT fit"
    else:
        end = "converged"
    verdict = f"{end} after {fit.steps} steps, root-mean-square residual {misfit:.2e}{left_out}"
    return Trust(grade != "not to be used", grade, verdict, unexplained, fit)


def _grade(unexplained: float, exact: bool, tolerance: float) -> Grade:
    """Returns the grade of a fit that converged."""
    if exact:
        return "exact"
    if unexplained <= _GOOD * tolerance:
        return "good"
    return "usable" if unexplained <= tolerance and unexplained < 1 else "not to be used"


def _explains_nothing(fit) -> bool:
    """Returns whether the fit leaves as much of the pictures as it would of noise."""
    power, left = fit.problem.norm**2, 2 * fit.cost
    free = fit.problem.at_bounds(fit.values).size
    if not power or fit.problem.targets[0].loss != "square":
        return False
    chance = (free + _CHANCE * np.sqrt(2 * free)) * left / fit.counted
    return bool(power - left <= chance)


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
