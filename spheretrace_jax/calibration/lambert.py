"""`lambert_light`: the light of a matt ball by linear least squares, the method to compare with."""

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Num

from ..base.errors import InputError
from .camera import Number

# The least N.L of a pixel that counts as lit: next to the shadow's edge pixels are lit in part.
_LIT = 0.05

# The most rounds in which lit pixels are chosen anew; about five settle them.
_ROUNDS = 30


class LambertLight(eqx.Module):
    """One light at infinity on a matt ball: I = color (N.L) + ambient on lit pixels."""

    direction: Float[np.ndarray, "3"]  #: unit vector to the light, in the frame of the normals
    covariance: Float[np.ndarray, "3 3"]  #: of `direction`, square radians, for independent noise
    color: Float[np.ndarray, " channels"]  #: albedo times the light's intensity
    ambient: Float[np.ndarray, " channels"]  #: what shadows show; zeros if not asked for
    residual: float  #: root of the mean square of what the lit pixels' mean channel leaves
    lit: Bool[np.ndarray, " n"]  #: which pixels took part

    @property
    def std(self) -> float:
        """Standard deviation of `direction` in radians, along its less certain axis."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance)[-1]))


def lambert_light(
    picture: Num[np.ndarray, "height width *channels"],
    normals: Float[np.ndarray, "n 3"],
    mask: Bool[np.ndarray, "height width"],
    *,
    ambient: bool = False,
    level: Number = np.inf,
) -> LambertLight:
    """Fits a light at infinity to a matt ball by linear least squares (Woodham 1980).

    The lit pixels are those that the last fit says are lit, until they stay the same.

    **Arguments:** `picture`: linear numbers. `normals`: unit normals of `picture[mask]`. `ambient`:
    whether to fit a constant as well. `level`: numbers from here on are saturated and left out.

    **Raises:** `InputError` if fewer than ten pixels are lit, or these do not tell a direction.
    """
    values = np.asarray(picture, float)[mask]
    values = values.reshape(len(values), -1)
    if len(values) != len(normals):
        raise InputError(
            f"normals: expected one for each of {len(values)} pixels, got {len(normals)}"
        )
    good = np.isfinite(values).all(1) & (values < level).all(1)
    grey = values.mean(1)
    columns = np.column_stack([normals, np.ones(len(normals))]) if ambient else normals
    top = float(np.quantile(grey[good], 0.99)) if good.any() else 0.0
    lit = np.asarray(good & (grey > 0.1 * top))
    solution = np.zeros(columns.shape[1])
    for _ in range(_ROUNDS):
        if lit.sum() < 10 or np.linalg.matrix_rank(columns[lit], 1e-6 * np.sqrt(lit.sum())) < len(
            solution
        ):
            raise InputError(
                f"picture: {int(lit.sum())} lit pixels, not saturated, do not tell a direction"
            )
        solution = np.linalg.lstsq(columns[lit], grey[lit], rcond=None)[0]
        before = lit
        length = np.linalg.norm(solution[:3])
        if not length > 0:
            raise InputError("picture: the ball is equally bright everywhere")
        lit = np.asarray(good & (normals @ solution[:3] > _LIT * length))
        if (lit == before).all():
            break
    colors = np.linalg.lstsq(columns[lit], values[lit], rcond=None)[0]
    direction = solution[:3] / np.linalg.norm(solution[:3])
    left = grey[lit] - columns[lit] @ solution
    variance = left @ left / max(lit.sum() - len(solution), 1)
    inverse = np.linalg.inv(columns[lit].T @ columns[lit])[:3, :3]
    across = (np.eye(3) - np.outer(direction, direction)) / np.linalg.norm(solution[:3])
    return LambertLight(
        direction,
        variance * across @ inverse @ across,
        direction @ colors[:3],
        colors[3] if ambient else np.zeros(values.shape[1]),
        float(np.sqrt(np.mean(left**2))),
        lit,
    )
