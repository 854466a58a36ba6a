"""How well pictures determine what was fitted: standard deviations and covariances.

To first order the unknowns scatter with covariance sigma^2 (J^T J)^-1 if the target's numbers
scatter independently with standard deviation sigma. What the pictures do not determine has an
infinite standard deviation; functions of the scene that they do determine, such as ka color, have
a finite one all the same. The step that the solver would still take counts as well: a highlight of
1e-12 may stop it long before its ks is found.
"""

from collections.abc import Callable, Iterable
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, PyTree

from ...xla.jit import compiled
from ..model.parameters import extent
from ..normal_equations.normal_equations import NormalEquations
from ..problem.problem import Problem, normal_at
from .null_columns import ROUNDING
from .null_space import Reason, null_space_reasons

# What is part of a direction of length 1 by no more than this says nothing new.
_NOTHING = 1e-6

# How much a direction may show, in units of J with columns of length 1, where it is certain that it
# does not: derivatives where shadow edges are covered are good to 1 % (docs/edges.md).
_EDGES = 1e-2

# A function that depends on undetermined directions by more than this is not determined.
_DEPENDS = 1e-5


class Spectrum(eqx.Module):
    """J^T J, its columns scaled to length 1, by eigenvectors; largest first."""

    scale: Float[np.ndarray, " free"]  #: the lengths of J's columns
    hidden: Bool[np.ndarray, " free"]  #: which columns are 0
    values: Float[np.ndarray, " free"]
    vectors: Float[np.ndarray, "free free"]
    least: float  #: eigenvalues up to this are 0

    @property
    def rank(self) -> int:
        """How many independent directions show."""
        return int(np.sum(self.values > self.least))

    @property
    def known(self) -> Float[np.ndarray, "free rank"]:
        """The directions that show, as columns."""
        return self.vectors[:, : self.rank]

    @property
    def null(self) -> Float[np.ndarray, "free nullity"]:
        """The directions that do not show, as columns."""
        return self.vectors[:, self.rank :]

    def shown(self, directions: Float[np.ndarray, "free count"]) -> float:
        """The most that is shown of any of some directions of length 1, squared."""
        return float(np.max(self.values @ (self.vectors.T @ directions) ** 2, initial=0))

    def without(self, directions: Float[np.ndarray, "free count"]) -> "Spectrum":
        """The same where orthonormal directions do not show."""
        kept = self.vectors - directions @ (directions.T @ self.vectors)
        values, vectors = _eigen((kept * self.values) @ kept.T)
        return eqx.tree_at(lambda s: (s.values, s.vectors), self, (values, vectors))


def spectrum_of(square: Float[np.ndarray, "free free"], size: float) -> Spectrum:
    """What J^T J tells of its directions.

    Columns of J up to `ROUNDING` rounding errors of the picture are 0, and so are eigenvalues.

    **Arguments:** `square`: J^T J. `size`: the length of the picture, all its numbers taken.
    """
    rounding = ROUNDING * np.finfo(square.dtype).eps
    scale = np.sqrt(np.diag(square))
    hidden = scale <= rounding * size
    # any length would do for them; one like the others' keeps functions of both comparable
    scale = np.where(hidden, np.median(scale[~hidden]) if not hidden.all() else 1.0, scale)
    seen = ~hidden[:, None] & ~hidden[None, :]
    values, vectors = _eigen(np.where(seen, square / scale[:, None] / scale[None, :], 0))
    return Spectrum(scale, hidden, values, vectors, least=float(rounding * values.size))


def _eigen(square: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The eigenvalues, largest first, none below 0 as rounding may have them, and eigenvectors."""
    values, vectors = np.linalg.eigh(square)
    return np.maximum(values[::-1], 0), np.ascontiguousarray(vectors[:, ::-1])


class Uncertainty(eqx.Module):
    """How well what was fitted is known."""

    noise: float  #: the standard deviation of the target's numbers (times their weights)
    problem: Problem
    values: PyTree
    spectrum: Spectrum
    #: of each picture's free parameters, in its layout, the derivatives by the unknowns
    slopes: list[Float[np.ndarray, "_ free"]]
    step: Float[np.ndarray, " free"]  #: the Gauss-Newton step that is left
    reasons: tuple[str, ...]  #: sentences why something does not show
    explained: Float[np.ndarray, "free count"]  #: what they say, orthonormal in scaled unknowns

    @property
    def standard_deviations(self) -> dict[str, np.ndarray]:
        """Of each free parameter, in its own units and shape; inf where it is not determined.

        With several pictures, what each has of its own has one more axis in front; lights that a
        picture has less than others are nan.
        """
        found, own = {}, self.problem.own
        for name in self.problem.parameters[0].free:
            pictures = range(len(self.slopes) if name in own else 1)
            places = [self.problem.layout(k).places[name] for k in pictures]
            each = [self._deviations(self.slopes[k])[at] for k, at in enumerate(places)]
            found[name] = _stacked(each) if name in own else np.asarray(each[0])
        return found

    @property
    def covariance(self) -> Float[np.ndarray, "natural natural"]:
        """Of the first picture's free parameters, name by name, row by row, in their own units.

        Directions that are not determined are left out of it: see `standard_deviations`.
        """
        half = self._half(self.slopes[0])
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
        middle, _ = extent(self.problem.parameters[picture].scene)
        scene, _ = self.problem.place(self.values)[picture]
        away = np.asarray(scene.lights.position[light] - middle, np.float64)
        length = np.linalg.norm(away)
        along = away / length
        places = self.problem.layout(picture).places["light_position"]
        slope = self.slopes[picture][places[light]] / length
        distance = self._deviations((along @ slope)[None])[0]
        across = slope - np.outer(along, along @ slope)
        angles = self._deviations(across)
        return float(np.linalg.norm(angles)), float(distance)

    def _half(self, slope: Float[np.ndarray, "functions free"]) -> np.ndarray:
        """H with H H^T the covariance of functions of the unknowns."""
        s = self.spectrum
        return self.noise * (slope / s.scale) @ s.known / np.sqrt(s.values[: s.rank])

    def _deviations(self, slope: Float[np.ndarray, "functions free"]) -> np.ndarray:
        scaled = slope / self.spectrum.scale
        hidden = np.linalg.norm(scaled @ self.spectrum.null, axis=1)
        shows = hidden <= _DEPENDS * np.linalg.norm(scaled, axis=1)
        scatter = np.linalg.norm(self._half(slope), axis=1)
        return np.where(shows, np.hypot(scatter, slope @ self.step), np.inf)


def _stacked(arrays: list) -> np.ndarray:
    """Arrays one upon another, those with fewer rows filled up with nan."""
    stacked = np.full((len(arrays), *max(np.shape(a) for a in arrays)), np.nan)
    for k, a in enumerate(arrays):
        stacked[(k, *map(slice, np.shape(a)))] = a
    return stacked


def estimate(
    problem: Problem, values: PyTree, normal: NormalEquations, noise: float | None
) -> Uncertainty:
    """**Arguments:** `normal`: the normal equations there. `noise`: None to estimate it from what
    the fit leaves.
    """
    square, gradient, slopes = _in_float64(problem, values, normal)
    spectrum = spectrum_of(square, problem.length)
    told, explained = _confirmed(
        null_space_reasons(problem, values, spectrum.hidden, slopes), spectrum
    )
    if spectrum.shown(explained) > spectrum.least:
        spectrum = spectrum.without(explained)
    if noise is None and problem.targets[0].loss != "square":
        noise = float(np.mean(problem.noise))  # that of the median, which outliers leave be
    elif noise is None:
        freedom = max(problem.counted - spectrum.rank, 1)
        noise = float(np.sqrt(2 * float(normal.cost) / freedom))
    step = _step(spectrum, gradient, np.asarray(problem.at_bounds(values)))
    return Uncertainty(noise, problem, values, spectrum, slopes, step, told, explained)


def _step(
    spectrum: Spectrum, gradient: Float[np.ndarray, " free"], held: Bool[np.ndarray, " free"]
) -> Float[np.ndarray, " free"]:
    """The Gauss-Newton step of what is not held at a bound, in the directions that show."""
    known = np.where(held[:, None], 0, spectrum.known)
    square = (known * spectrum.values[: spectrum.rank]) @ known.T
    down = np.where(held, 0, -gradient / spectrum.scale)
    return np.linalg.pinv(square, spectrum.least, hermitian=True) @ down / spectrum.scale


def _confirmed(
    known: Iterable[Reason], spectrum: Spectrum
) -> tuple[tuple[str, ...], Float[np.ndarray, "free count"]]:
    """Those reasons that J^T J confirms, and that say what no other has said: their sentences,
    and an orthonormal basis of their directions, in scaled unknowns.
    """
    told, explained = [], np.zeros((spectrum.scale.size, 0))
    for reason in known:
        new = _beyond(reason.directions * spectrum.scale[:, None], explained)
        most = _EDGES**2 if reason.certain else spectrum.least
        if new.shape[1] and spectrum.shown(new) <= most:
            explained = np.concatenate([explained, new], axis=1)
            told.append(reason.sentence)
    return tuple(told), explained


def _beyond(directions: np.ndarray, explained: np.ndarray) -> np.ndarray:
    """An orthonormal basis of what some directions, of any length, say that is not explained."""
    length = np.linalg.norm(directions, axis=0)
    directions = directions[:, length > 0] / length[length > 0]
    new = directions - explained @ (explained.T @ directions)
    left, size, _ = np.linalg.svd(new, full_matrices=False)
    return left[:, size > _NOTHING]


def _in_float64(
    problem: Problem, values: PyTree, normal: NormalEquations
) -> tuple[
    Float[np.ndarray, "free free"], Float[np.ndarray, " free"], list[Float[np.ndarray, "_ free"]]
]:
    """J^T J, J^T r, and the derivatives of the free parameters by the unknowns.

    In float32 too: there the squares of what shows little are lost among the rounding errors of
    what shows much, and nothing could be said of what does not show at all.
    """
    if problem.dtype == np.float64:
        slopes = [np.asarray(s) for s in _slopes(problem, values)]
        return np.asarray(normal.square), np.asarray(normal.gradient), slopes
    wide = lambda x: x.astype(np.float64) if eqx.is_inexact_array(x) else x
    with jax.enable_x64(True):
        problem, values = jax.tree.map(wide, (problem, values))
        return _in_float64(problem, values, normal_at(problem, values))


@compiled
def _slopes(problem: Problem, values: PyTree) -> list[Float[Array, "_ free"]]:
    return [problem.slope(values, k) for k in range(len(problem.parameters))]
