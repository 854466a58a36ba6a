"""What pictures determine of what is free, and in words what they do not."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..problem.labels import labels_of, picture_suffix
from .uncertainty import Uncertainty

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


def identify(uncertainty: Uncertainty) -> Identifiability:
    """What the pictures determine at a solution.

    Reasons that are known by structure are named; what else J^T J leaves open is named by its
    largest parts.
    """
    problem, spectrum = uncertainty.problem, uncertainty.spectrum
    words, names = list(uncertainty.reasons), labels_of(problem)
    for direction in _sparse(_rest(spectrum.null, uncertainty.explained)).T:
        large = np.abs(direction) > 0.3 * np.abs(direction).max()
        parts = list(dict.fromkeys(names[large]))
        what = parts[0] if len(parts) == 1 else f"a combination of {', '.join(parts)}"
        words.append(f"{what} is not determined")
    return Identifiability(
        rank=spectrum.rank,
        free=spectrum.scale.size,
        singular_values=np.sqrt(spectrum.values),
        undetermined=tuple(dict.fromkeys(words)),
        weak=tuple(_weak(uncertainty)),
    )


def _rest(null: np.ndarray, explained: np.ndarray) -> np.ndarray:
    """A basis of what is not explained of the directions that do not show."""
    left, _, _ = np.linalg.svd(null - explained @ (explained.T @ null), full_matrices=False)
    return left[:, : max(null.shape[1] - explained.shape[1], 0)]


def _sparse(basis: np.ndarray) -> np.ndarray:
    """A basis of the same space with as many zeros as there are other directions in each.

    By elimination (Gauss, Jordan): independent reasons that share no unknowns come apart.
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
    """What is determined in principle, but to no better than its own size."""
    deviations = uncertainty.of_unknowns
    names = labels_of(uncertainty.problem)
    weak = np.isfinite(deviations) & (deviations > _WEAK)
    words = [
        f"{name} is lost in the noise"
        for name in dict.fromkeys(names[weak])
        if "position" not in name
    ]
    problem = uncertainty.problem
    if "light_position" not in problem.parameters[0].free:
        return words
    own = "light_position" in problem.own
    for k, parameters in enumerate(problem.parameters if own else problem.parameters[:1]):
        of = picture_suffix(k) if own else ""
        for i in range(len(parameters.scene.lights)):
            angle, distance = uncertainty.of_light(k, i)
            if angle <= _WEAK < distance:
                words.append(
                    f"light {i + 1}{of}: distance undetermined, direction known to "
                    f"{np.degrees(angle):.2g} degrees"
                )
            elif _WEAK < angle < np.inf:
                words.append(f"light {i + 1}'s position{of} is lost in the noise")
    return words
