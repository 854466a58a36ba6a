"""Uncertainty: standard deviations and covariances of what was fitted.

To first order the unknowns scatter with covariance sigma^2 (J^T J)^-1 if the target's numbers
scatter independently with standard deviation sigma. What the pictures do not determine has an
infinite standard deviation; functions of the scene that they do determine, such as ka color, have
a finite one all the same. The step that the solver would still take counts as well: a highlight of
1e-12 may stop it long before its ks is found.
"""

import dataclasses
from collections.abc import Callable, Iterable
from statistics import NormalDist
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, PyTree

from ...base.errors import InputError
from ...xla.jit import compiled
from ..model.parameters import bounding_sphere
from ..normal_equations.normal_equations import NormalEquations
from ..problem.problem import Problem, normal_at
from .null_space import Spectrum, spectrum_of
from .null_space_reasons import Reason, null_space_reasons

# The part of a direction of length 1 outside what is explained, up to which the direction says
# nothing new: smaller parts are rounding errors of the directions, in float64 and of the scene's.
_NOTHING_NEW = 1e-6

# How much a direction may show, in units of J with columns of length 1, where it is certain that it
# does not: derivatives where shadow edges are covered are good to 1 % (docs/edges.md).
_EDGE_ERROR = 1e-2

# The probability with which a light is no nearer, and no farther, than is said.
_CONFIDENCE = 0.95

# The part of a function's derivative along undetermined directions, from which the function is not
# determined. Smaller ones are errors of the directions; a larger limit gives finite deviations to
# functions that do depend.
_DEPENDS = 1e-5


class LightDistance(NamedTuple):
    """How far a light is from the middle of the spheres, in the scene's units."""

    value: float  #: as it was found; infinite for a directional light
    least: float  #: it is at least so far away, with 95 % probability
    most: float  #: it is at most so far away, with 95 % probability; inf where there is no limit

    @property
    def infinite(self) -> bool:
        """Tells whether the light may as well be at infinity: its distance does not show."""
        return bool(np.isinf(self.most))


class Uncertainty(eqx.Module):
    """The covariance of the unknowns, as a spectrum, and of functions of them."""

    noise: float  #: the standard deviation of the target's numbers (times their weights)
    problem: Problem
    values: PyTree
    spectrum: Spectrum
    #: the derivatives of each picture's free parameters, by its `ParameterIndex`, by the unknowns
    jacobians: list[Float[np.ndarray, "_ free"]]
    step: Float[np.ndarray, " free"]  #: the Gauss-Newton step that is left
    reasons: tuple[str, ...]  #: sentences why directions do not show
    explained: Float[np.ndarray, "free count"]  #: these, orthonormal in scaled unknowns
    #: S with S S^T the covariance of the unknowns by what the scene does not explain; no columns
    #: where residuals are white noise (`model_error.py`)
    model_error: Float[np.ndarray, "free columns"]

    @property
    def white(self) -> "Uncertainty":
        """Returns the uncertainty by white noise alone, as if the scene explained the pictures."""
        return eqx.tree_at(lambda u: u.model_error, self, self.model_error[:, :0])

    @property
    def standard_deviations(self) -> dict[str, np.ndarray]:
        """Returns those of each free parameter, in its units and shape; inf if not determined.

        With several pictures, parameters that each picture has apart have one more axis in front;
        lights that a picture has less than others are nan.
        """
        deviations, per_picture = {}, self.problem.per_picture
        for name in self.problem.parameters[0].free:
            pictures = range(len(self.jacobians) if name in per_picture else 1)
            places = [self.problem.index(k).places[name] for k in pictures]
            arrays = [self._deviations(self.jacobians[k])[at] for k, at in enumerate(places)]
            deviations[name] = _stacked(arrays) if name in per_picture else np.asarray(arrays[0])
        return deviations

    @property
    def covariance(self) -> Float[np.ndarray, "natural natural"]:
        """Returns that of the first picture's free parameters, name by name, row by row.

        In the parameters' units. Directions that are not determined are left out of it: see
        `standard_deviations`.
        """
        jacobian = self.jacobians[0]
        half = np.concatenate([self._half(jacobian), jacobian @ self.model_error], axis=1)
        return half @ half.T

    def of(self, function: Callable[[Any], Array]) -> np.ndarray:
        """Returns the standard deviations of any differentiable function of the (first) scene.

        For example `lambda s: s.spheres.ka[:, None] * s.spheres.color`. inf where the pictures do
        not determine it.
        """
        y, unravel = ravel_pytree(self.values)
        of_unknowns = lambda y: function(self.problem.scenes_at(unravel(y))[0][0])
        jacobian = np.asarray(jax.jacobian(of_unknowns)(y), np.float64)
        shape = jacobian.shape[:-1]
        return self._deviations(jacobian.reshape(-1, y.size)).reshape(shape)

    @property
    def of_unknowns(self) -> Float[np.ndarray, " free"]:
        """Returns the standard deviations of the solver's unknowns, which are of order one."""
        return self._deviations(np.eye(self.spectrum.scale.size))

    def light_distance(self, light: int, picture: int = 0) -> LightDistance:
        """Returns how far a light is from the middle of the spheres, and what the pictures allow.

        To first order 1/distance scatters normally, which is near 0 where parallax and fall-off
        hardly show. As it cannot be negative, the normal distribution is cut off at 0: the least
        distance is the inverse of the 95 % quantile of what is left. A light that is found within
        1.645 standard deviations of 1/distance = 0 has no greatest distance.

        **Arguments:** `light`, `picture`: their numbers, from 0.

        **Raises:** `InputError` for a light or a picture that there is not.
        """
        pictures = len(self.problem.parameters)
        if not 0 <= picture < pictures:
            raise InputError(f"picture must be in 0..{pictures - 1}, got {picture}")
        lights = self.problem.parameters[picture].scene.lights
        if not 0 <= light < len(lights):
            raise InputError(f"light must be in 0..{len(lights) - 1}, got {light}")
        if lights.directional[light]:
            return LightDistance(np.inf, np.inf, np.inf)
        length = float(np.linalg.norm(self._offset(picture, light)))
        if "light_position" not in self.problem.parameters[0].free or not length > 0:
            return LightDistance(length, length, length)
        _, relative = self.of_light(picture, light)
        if not relative > 0:
            return LightDistance(length, length, length)
        if not np.isfinite(relative):
            return LightDistance(length, 0.0, np.inf)
        normal = NormalDist()
        above = relative * normal.inv_cdf(1 - (1 - _CONFIDENCE) * normal.cdf(1 / relative))
        below = relative * normal.inv_cdf(_CONFIDENCE)
        most = length / (1 - below) if below < 1 else np.inf
        return LightDistance(length, length / (1 + above), float(most))

    def of_light(self, picture: int, light: int) -> tuple[float, float]:
        """Returns how well a light's direction is known, in radians, and its relative distance.

        Both as seen from the middle of the spheres. Of a directional light the distance is known.
        """
        directional = self.problem.parameters[picture].scene.lights.directional[light]
        name = "light_direction" if directional else "light_position"
        offset = self._offset(picture, light)
        length = np.linalg.norm(offset)
        along = offset / length
        places = self.problem.index(picture).places[name]
        jacobian = self.jacobians[picture][places[light]] / length
        distance = 0.0 if directional else self._deviations((along @ jacobian)[None])[0]
        across = jacobian - np.outer(along, along @ jacobian)
        angles = self._deviations(across)
        return float(np.linalg.norm(angles)), float(distance)

    def _offset(self, picture: int, light: int) -> Float[np.ndarray, " 3"]:
        """Returns a light's position from the middle of the spheres, or its direction."""
        scene, _ = self.problem.scenes_at(self.values)[picture]
        place = np.asarray(scene.lights.position[light], np.float64)
        if scene.lights.directional[light]:
            return place
        middle, _ = bounding_sphere(self.problem.parameters[picture].scene)
        return place - np.asarray(middle, np.float64)

    def _half(self, jacobian: Float[np.ndarray, "functions free"]) -> np.ndarray:
        """Returns H with H H^T the covariance of functions of the unknowns."""
        s = self.spectrum
        return self.noise * (jacobian / s.scale) @ s.known / np.sqrt(s.values[: s.rank])

    def _deviations(self, jacobian: Float[np.ndarray, "functions free"]) -> np.ndarray:
        """Returns the standard deviations of functions of the unknowns."""
        scaled = jacobian / self.spectrum.scale
        undetermined = np.linalg.norm(scaled @ self.spectrum.null_space, axis=1)
        determined = undetermined <= _DEPENDS * np.linalg.norm(scaled, axis=1)
        parts = [self._half(jacobian), jacobian @ self.model_error, (jacobian @ self.step)[:, None]]
        scatter = np.linalg.norm(np.concatenate(parts, axis=1), axis=1)
        return np.where(determined, scatter, np.inf)


def _stacked(arrays: list) -> np.ndarray:
    """Stacks arrays, those with fewer rows filled up with nan."""
    stacked = np.full((len(arrays), *max(np.shape(a) for a in arrays)), np.nan)
    for k, a in enumerate(arrays):
        stacked[(k, *map(slice, np.shape(a)))] = a
    return stacked


def estimate(
    problem: Problem, values: PyTree, normal: NormalEquations, noise: float | None
) -> Uncertainty:
    """Estimates how well what was fitted is known.

    **Arguments:** `normal`: the normal equations at `values`. `noise`: None to estimate the noise
    from the residuals.
    """
    # of the problem only what the derivatives are of
    parameters = eqx.tree_at(lambda p: (p.targets, p.buffers), problem, ((), ()))
    jacobians = [np.asarray(x, np.float64) for x in _jacobians(parameters, values)]
    square, gradient = np.asarray(normal.square), np.asarray(normal.gradient)
    # what the pictures alone determine
    priors, seen = problem.priors, square
    if priors:
        seen = np.asarray(normal_at(problem.without_priors(), values).square)
    spectrum = spectrum_of(seen, problem.norm)
    reasons = list(null_space_reasons(problem, values, spectrum.null, jacobians))
    sentences, explained = _confirmed(reasons, spectrum)
    if spectrum.shown(explained) > spectrum.least:
        spectrum = spectrum.without(explained)
    if priors:
        spectrum = spectrum_of(spectrum.square + (square - seen), problem.norm)
        told = [dataclasses.replace(r, certain=False) for r in reasons if r.sentence in sentences]
        sentences, explained = _confirmed(told, spectrum)
    if noise is None and problem.targets[0].loss != "square":
        noise = float(np.mean(problem.noise))  # by the median, which outliers do not move
    elif noise is None:
        freedom = max(_scattering(problem, normal) - spectrum.rank, 1)
        noise = float(np.sqrt(2 * float(normal.cost) / freedom))
    step = _step(spectrum, gradient, np.asarray(problem.at_bounds(values)))
    none = np.zeros((step.size, 0))
    return Uncertainty(
        noise, problem, values, spectrum, jacobians, step, sentences, explained, none
    )


def _scattering(problem: Problem, normal: NormalEquations) -> int:
    """Returns how many numbers may have noise: all but black ones that are drawn black."""
    count = 0
    for target, picture in zip(problem.targets, normal.pictures, strict=True):
        shows = (np.asarray(target.image) != 0) | (np.asarray(picture) != 0)
        count += int(np.count_nonzero((np.asarray(target.weight) > 0) & shows))
    return count


def _step(
    spectrum: Spectrum, gradient: Float[np.ndarray, " free"], held: Bool[np.ndarray, " free"]
) -> Float[np.ndarray, " free"]:
    """Returns the Gauss-Newton step of what is not held at a bound, in directions that show."""
    down = np.where(held, 0, -gradient / spectrum.scale)
    inverse = np.linalg.pinv(square_of_free(spectrum, held), spectrum.least, hermitian=True)
    return inverse @ down / spectrum.scale


def square_of_free(
    spectrum: Spectrum, held: Bool[np.ndarray, " free"]
) -> Float[np.ndarray, "free free"]:
    """Returns J^T J, its columns scaled to length 1, in directions that show.

    0 in the rows and columns of what is held at a bound.
    """
    known = np.where(held[:, None], 0, spectrum.known)
    return (known * spectrum.values[: spectrum.rank]) @ known.T


def _confirmed(
    reasons: Iterable[Reason], spectrum: Spectrum
) -> tuple[tuple[str, ...], Float[np.ndarray, "free count"]]:
    """Returns the sentences of reasons that J^T J confirms and that say something new.

    And an orthonormal basis of their directions, in scaled unknowns.
    """
    sentences, explained = [], np.zeros((spectrum.scale.size, 0))
    for reason in reasons:
        new = _beyond(reason.directions * spectrum.scale[:, None], explained)
        limit = _EDGE_ERROR**2 if reason.certain else spectrum.least
        if new.shape[1] and spectrum.shown(new) <= limit:
            explained = np.concatenate([explained, new], axis=1)
            sentences.append(reason.sentence)
    return tuple(sentences), explained


def _beyond(directions: np.ndarray, explained: np.ndarray) -> np.ndarray:
    """Returns an orthonormal basis of what directions of any length add to what is explained."""
    length = np.linalg.norm(directions, axis=0)
    directions = directions[:, length > 0] / length[length > 0]
    new = directions - explained @ (explained.T @ directions)
    left, size, _ = np.linalg.svd(new, full_matrices=False)
    return left[:, size > _NOTHING_NEW]


@compiled
def _jacobians(parameters: Problem, values: PyTree) -> list[Float[Array, "_ free"]]:
    return [parameters.parameter_jacobian(values, k) for k in range(len(parameters.parameters))]
