"""Identifiability: what pictures determine of what is free, and in words what they do not."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..problem.labels import free_lights, labels_of
from .uncertainty import Uncertainty

# The standard deviation from which an unknown is as good as not determined: half of its range.
# Unknowns are logarithms, angles in radians or parts of their range. A smaller one names more.
_WEAK = 0.5

# The components of a null direction, as parts of its largest, that are named. Smaller ones come
# from other directions of the basis; a lower limit names them too.
_LARGE = 0.3


class Identifiability(eqx.Module):
    """The rank of a fit's Jacobian, and words for what pictures do not determine."""

    rank: int  #: how many independent combinations of the free numbers show
    free: int  #: how many free numbers there are
    singular_values: Float[np.ndarray, " free"]  #: of J with columns of length 1, largest first
    undetermined: tuple[str, ...]  #: what does not show at all, a sentence for each reason
    weak: tuple[str, ...]  #: what shows, but drowns in the noise

    def __str__(self) -> str:
        first = f"{self.rank} of {self.free} free numbers are determined"
        return "\n".join([first, *self.undetermined, *self.weak])


def identify(uncertainty: Uncertainty) -> Identifiability:
    """Returns what the pictures determine at a solution.

    Reasons that are known by structure are named; the rest of the null space of J^T J is named by
    its largest components.
    """
    problem, spectrum = uncertainty.problem, uncertainty.spectrum
    sentences, labels = list(uncertainty.reasons), labels_of(problem)
    for direction in _sparse(_unexplained(spectrum.null_space, uncertainty.explained)).T:
        large = np.abs(direction) > _LARGE * np.abs(direction).max()
        named = list(dict.fromkeys(labels[large]))
        words = named[0] if len(named) == 1 else f"a combination of {', '.join(named)}"
        sentences.append(f"{words} is not determined")
    return Identifiability(
        rank=spectrum.rank,
        free=spectrum.scale.size,
        singular_values=np.sqrt(spectrum.values),
        undetermined=tuple(dict.fromkeys(sentences)),
        weak=tuple(_weak(uncertainty)),
    )


def _unexplained(null: np.ndarray, explained: np.ndarray) -> np.ndarray:
    """Returns a basis of the null directions beyond those that are explained."""
    left, _, _ = np.linalg.svd(null - explained @ (explained.T @ null), full_matrices=False)
    return left[:, : max(null.shape[1] - explained.shape[1], 0)]


def _sparse(basis: np.ndarray) -> np.ndarray:
    """Returns a sparse basis of the same space, by elimination (Gauss, Jordan).

    Each direction has as many zeros as there are others: independent reasons that share no
    unknowns come apart.
    """
    basis = basis.copy()
    for k in range(basis.shape[1]):
        row, column = np.unravel_index(np.abs(basis[:, k:]).argmax(), basis[:, k:].shape)
        basis[:, [k, k + column]] = basis[:, [k + column, k]]
        basis[:, k] /= basis[row, k]
        others = np.arange(basis.shape[1]) != k
        basis[:, others] -= np.outer(basis[:, k], basis[row, others])
    return basis


def _weak(uncertainty: Uncertainty) -> list[str]:
    """Returns sentences for what is determined in principle, but to no better than its size."""
    problem, deviations = uncertainty.problem, uncertainty.of_unknowns
    weak = np.isfinite(deviations) & (deviations > _WEAK)
    sentences = [
        f"{label} is lost in the noise"
        for label in dict.fromkeys(labels_of(problem)[weak])
        if "position" not in label
    ]
    for k, i, suffix in free_lights(problem, "light_position"):
        angle, _ = uncertainty.of_light(k, i)
        distance = uncertainty.light_distance(i, k)
        if angle <= _WEAK and distance.infinite:
            sentences.append(f"light {i + 1}{suffix}{_at_infinity(distance.least, angle)}")
        elif _WEAK < angle < np.inf:
            sentences.append(f"light {i + 1}'s position{suffix} is lost in the noise")
    return sentences


def _at_infinity(least: float, angle: float) -> str:
    """Returns words for a light whose distance does not show, after its name."""
    known = f"direction known to {np.degrees(angle):.2g} degrees"
    if not least > 0:
        return f": distance undetermined, {known}"
    return (
        f" is at infinity: its distance does not show, but is at least {least:.3g} (95 %); "
        f"{known}; prefer a directional light, the simpler model"
    )
