"""The null space of J: which directions of the unknowns show in the pictures, and which do not.

From the eigenvalues and eigenvectors of J^T J, its columns scaled to length 1.
"""

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from .null_columns import ROUNDING


class Spectrum(eqx.Module):
    """J^T J, its columns scaled to length 1, by eigenvectors; largest first."""

    scale: Float[np.ndarray, " free"]  #: the lengths of J's columns
    null: Bool[np.ndarray, " free"]  #: which columns are 0
    values: Float[np.ndarray, " free"]
    vectors: Float[np.ndarray, "free free"]
    least: float  #: eigenvalues up to this are 0

    @property
    def rank(self) -> int:
        """Returns how many independent directions show."""
        return int(np.sum(self.values > self.least))

    @property
    def known(self) -> Float[np.ndarray, "free rank"]:
        """Returns the directions that show, as columns."""
        return self.vectors[:, : self.rank]

    @property
    def null_space(self) -> Float[np.ndarray, "free nullity"]:
        """Returns the directions that do not show, as columns."""
        return self.vectors[:, self.rank :]

    @property
    def square(self) -> Float[np.ndarray, "free free"]:
        """Returns J^T J."""
        scaled = (self.vectors * self.values) @ self.vectors.T
        return self.scale[:, None] * scaled * self.scale[None, :]

    def shown(self, directions: Float[np.ndarray, "free count"]) -> float:
        """Returns how much at most one of several directions of length 1 shows, squared."""
        return float(np.max(self.values @ (self.vectors.T @ directions) ** 2, initial=0))

    def without(self, directions: Float[np.ndarray, "free count"]) -> "Spectrum":
        """Returns the spectrum where orthonormal directions do not show."""
        kept = self.vectors - directions @ (directions.T @ self.vectors)
        values, vectors = _eigen((kept * self.values) @ kept.T)
        return eqx.tree_at(lambda s: (s.values, s.vectors), self, (values, vectors))


def spectrum_of(square: Float[np.ndarray, "free free"], norm: float) -> Spectrum:
    """Returns the spectrum of J^T J.

    Columns of J up to `ROUNDING` rounding errors of the picture are 0, and so are eigenvalues.

    **Arguments:** `square`: J^T J. `norm`: of the picture, over all its numbers.
    """
    rounding = ROUNDING * np.finfo(square.dtype).eps
    scale = np.sqrt(np.diag(square))
    null = scale <= rounding * norm
    # any length would do for null columns; one like the others' keeps functions of both comparable
    scale = np.where(null, np.median(scale[~null]) if not null.all() else 1.0, scale)
    shows = ~null[:, None] & ~null[None, :]
    values, vectors = _eigen(np.where(shows, square / scale[:, None] / scale[None, :], 0))
    return Spectrum(scale, null, values, vectors, least=float(rounding * values.size))


def _eigen(square: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns eigenvalues, largest first, and eigenvectors. Those below 0 by rounding become 0."""
    values, vectors = np.linalg.eigh(square)
    return np.maximum(values[::-1], 0), np.ascontiguousarray(vectors[:, ::-1])
