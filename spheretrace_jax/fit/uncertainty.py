"""How well pictures determine what was fitted: standard deviations and covariances.

To first order the unknowns scatter with covariance sigma^2 (J^T J)^-1 if the target's numbers
scatter independently with standard deviation sigma. What the pictures do not determine has an
infinite standard deviation; functions of the scene that they do determine, such as ka color, have
a finite one all the same.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, PyTree

from .normal import Normal
from .parameters import extent
from .problem import Problem

# Eigenvalues of the scaled J^T J below so many rounding errors are 0.
_ROUNDING = 1e3

# A function that depends on undetermined directions by more than this is not determined.
_DEPENDS = 1e-5


class Spectrum(eqx.Module):
    """J^T J, its columns scaled to length 1, by eigenvectors; largest first."""

    scale: Float[np.ndarray, " free"]  #: the lengths of J's columns; 1 for those that are 0
    values: Float[np.ndarray, " free"]
    vectors: Float[np.ndarray, "free free"]
    rank: int

    @property
    def known(self) -> Float[np.ndarray, "free rank"]:
        """The directions that show, as columns."""
        return self.vectors[:, : self.rank]

    @property
    def null(self) -> Float[np.ndarray, "free nullity"]:
        """The directions that do not show, as columns."""
        return self.vectors[:, self.rank :]


def spectrum_of(normal: Normal) -> Spectrum:
    """The scaled J^T J by eigenvectors, and how many of them are not 0 but for rounding."""
    square = np.asarray(normal.square, np.float64)
    scale = np.sqrt(np.diag(square))
    # derivatives of rounding errors are none
    tiny = np.finfo(np.float64).tiny
    scale = np.where(scale > tiny, scale, 1)
    values, vectors = np.linalg.eigh(square / scale[:, None] / scale[None, :])
    values, vectors = values[::-1], vectors[:, ::-1]
    eps = np.finfo(np.asarray(normal.square).dtype).eps
    rank = int(np.sum(values > _ROUNDING * len(values) * eps))
    return Spectrum(scale, np.maximum(values, 0), vectors, rank)


class Uncertainty(eqx.Module):
    """How well what was fitted is known."""

    noise: float  #: the standard deviation of the target's numbers (times their weights)
    problem: Problem
    values: PyTree
    spectrum: Spectrum

    @property
    def standard_deviations(self) -> dict[str, np.ndarray]:
        """Of each free parameter, in its own units and shape; inf where it is not determined.

        With several pictures, what each has of its own has one more axis in front.
        """
        found = {}
        for name in self.problem.parameters[0].free:
            slopes = self._slopes(lambda natural, name=name: natural[name])
            shape = np.shape(self._natural()[0][name])
            if name in self.problem.own:
                found[name] = np.stack([self._deviations(s).reshape(shape) for s in slopes])
            else:
                found[name] = self._deviations(slopes[0]).reshape(shape)
        return found

    @property
    def covariance(self) -> Float[np.ndarray, "free free"]:
        """Of the first picture's free parameters, name by name, row by row, in their own units.

        Directions that are not determined are left out of it: see `standard_deviations`.
        """
        free = self.problem.parameters[0].free
        flat = lambda natural: jnp.concatenate([natural[n].reshape(-1) for n in free])
        half = self._half(self._slopes(flat)[0])
        return half @ half.T

    def of(self, function: Callable[[Any], Array]) -> np.ndarray:
        """The standard deviations of any differentiable function of the (first) scene.

        For example `lambda s: s.spheres.ka[:, None] * s.spheres.color`. inf where the pictures do
        not determine it.
        """
        y, unravel = ravel_pytree(self.values)
        seen = lambda y: function(self.problem.place(unravel(y))[0][0])
        slope = np.asarray(jax.jacobian(seen)(y), np.float64)
        shape = slope.shape[:-1]
        return self._deviations(slope.reshape(-1, y.size)).reshape(shape)

    @property
    def of_unknowns(self) -> Float[np.ndarray, " free"]:
        """Of the solver's own numbers, which are of order one."""
        return self._deviations(np.eye(self.spectrum.scale.size))

    def of_light(self, picture: int, light: int) -> tuple[float, float]:
        """How well a light's direction is known, in radians, and its distance, as a part of it.

        Both as seen from the middle of the spheres.
        """
        y, unravel = ravel_pytree(self.values)
        middle, _ = extent(self.problem.parameters[picture].scene)

        def position(y: Array) -> Array:
            scene = self.problem.place(unravel(y))[picture][0]
            return scene.lights.position[light] - middle

        away = np.asarray(position(y), np.float64)
        slope = np.asarray(jax.jacfwd(position)(y), np.float64) / np.linalg.norm(away)
        along = away / np.linalg.norm(away)
        distance = self._deviations((along @ slope)[None])[0]
        across = slope - np.outer(along, along @ slope)
        angles = self._deviations(across)
        return float(np.linalg.norm(angles)), float(distance)

    def _natural(self) -> list[dict]:
        picture = self.problem.of_picture
        return [p.natural(picture(self.values, k)) for k, p in enumerate(self.problem.parameters)]

    def _slopes(self, pick: Callable[[dict], Array]) -> list[np.ndarray]:
        """For each picture the derivatives of some of its parameters by the unknowns."""
        y, unravel = ravel_pytree(self.values)

        def one(k: int) -> Callable:
            return lambda y: pick(
                self.problem.parameters[k].natural(self.problem.of_picture(unravel(y), k))
            ).reshape(-1)

        count = len(self.problem.parameters)
        return [np.asarray(jax.jacfwd(one(k))(y), np.float64) for k in range(count)]

    def _half(self, slope: Float[np.ndarray, "functions free"]) -> np.ndarray:
        """H with H H^T the covariance of functions of the unknowns."""
        s = self.spectrum
        return self.noise * (slope / s.scale) @ s.known / np.sqrt(s.values[: s.rank])

    def _deviations(self, slope: Float[np.ndarray, "functions free"]) -> np.ndarray:
        scaled = slope / self.spectrum.scale
        hidden = np.linalg.norm(scaled @ self.spectrum.null, axis=1)
        shows = hidden <= _DEPENDS * np.linalg.norm(scaled, axis=1)
        return np.where(shows, np.linalg.norm(self._half(slope), axis=1), np.inf)


def estimate(problem: Problem, values: PyTree, normal: Normal, noise: float | None) -> Uncertainty:
    """**Arguments:** `noise`: None to estimate it from what the fit leaves."""
    spectrum = spectrum_of(normal)
    if noise is None:
        counted = sum(t.counted for t in problem.targets)
        noise = float(np.sqrt(2 * float(normal.cost) / max(counted - spectrum.rank, 1)))
    return Uncertainty(noise, problem, values, spectrum)
