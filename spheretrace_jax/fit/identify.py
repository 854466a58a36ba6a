"""What pictures determine of what is free, and in words what they do not."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .normal import Normal
from .reasons import names_of, reasons
from .uncertainty import Uncertainty

# How much a direction may show, in units of J with columns of length 1, that does not show.
_HIDDEN = 1e-5

# Logarithms, angles and parts of their range that are known to no better than this are as good as
# not determined.
_WEAK = 0.5


class Identifiability(eqx.Module):
    """What pictures determine."""

    rank: int  #: how many independent combinations of the free numbers show
    free: int  #: how many free numbers there are
    singular_values: Float[np.ndarray, " free"]  #: of J with columns of length 1, largest first
    undetermined: tuple[str, ...]  #: what does not show at all, a sentence for each reason
    weak: tuple[str, ...]  #: what shows, but drowns in the noise

    def __str__(self) -> str:
        first = f"{self.rank} of {self.free} free numbers are determined"
        return "\n".join([first, *self.undetermined, *self.weak])


def identify(uncertainty: Uncertainty, normal: Normal) -> Identifiability:
    """What the pictures determine at a solution.

    A reason that is known by structure is named if J^T J confirms it; what else J^T J leaves open
    is named by its largest parts.
    """
    problem, values, spectrum = uncertainty.problem, uncertainty.values, uncertainty.spectrum
    words, explained = [], np.zeros((spectrum.scale.size, 0))
    for sentence, directions in reasons(problem, values, normal):
        new = _orthonormal(directions * spectrum.scale[:, None])
        new = _orthonormal(new - explained @ (explained.T @ new))
        shows = np.sum(spectrum.values[:, None] * (spectrum.vectors.T @ new) ** 2, axis=0)
        if new.shape[1] and np.sqrt(shows.max()) < _HIDDEN:
            explained = np.concatenate([explained, new], axis=1)
            words.append(sentence)
    rest = _orthonormal(spectrum.null - explained @ (explained.T @ spectrum.null))
    names = names_of(problem)
    for direction in rest.T:
        large = np.abs(direction) > 0.3 * np.abs(direction).max()
        parts = list(dict.fromkeys(names[i] for i in np.flatnonzero(large)))
        what = parts[0] if len(parts) == 1 else f"a combination of {', '.join(parts)}"
        words.append(f"{what} is not determined")
    return Identifiability(
        rank=spectrum.rank,
        free=spectrum.scale.size,
        singular_values=np.sqrt(spectrum.values),
        undetermined=tuple(words),
        weak=tuple(_weak(uncertainty)),
    )


def _orthonormal(directions: np.ndarray) -> np.ndarray:
    """A basis of what columns of length at most 1 span."""
    left, size, _ = np.linalg.svd(directions, full_matrices=False)
    return left[:, size > 1e-6 * max(1, size.max(initial=0))]


def _weak(uncertainty: Uncertainty) -> list[str]:
    """What is determined in principle, but to no better than its own size."""
    deviations = uncertainty.of_unknowns
    names = np.asarray(names_of(uncertainty.problem))
    weak = np.isfinite(deviations) & (deviations > _WEAK)
    words = [
        f"{name} is lost in the noise"
        for name in dict.fromkeys(names[weak])
        if not name.endswith("position")
    ]
    problem = uncertainty.problem
    if "light_position" not in problem.parameters[0].free:
        return words
    for k, parameters in enumerate(
        problem.parameters if "light_position" in problem.own else problem.parameters[:1]
    ):
        of = f" of picture {k + 1}" if "light_position" in problem.own else ""
        for i in range(len(parameters.scene.lights)):
            angle, distance = uncertainty.of_light(k, i)
            if np.isfinite(angle) and angle < _WEAK < distance:
                words.append(
                    f"light {i + 1}{of}: distance undetermined, direction known to "
                    f"{np.degrees(angle):.2g} degrees"
                )
    return words
