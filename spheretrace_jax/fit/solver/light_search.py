"""The search for lights: starts of a fit whose geometry is known, from lights or from nothing.

Variable projection on a grid: directions all around are tried for the lights, one after the other,
each with the materials that suit it best, then finer ones around the best. The search is
deterministic, and blind to local minima that are narrower than the grid.
"""

from collections.abc import Iterator
from typing import Literal, get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...base.errors import InputError
from ...scene.parameters import LIGHT_PLACES, rows_of
from ...scene.scene import Scene
from ...scene.settings import RenderSettings
from ..model.accessors import GEOMETRY
from ..model.constraints import Constraint
from ..model.parameters import Parameters, bounding_sphere
from ..model.target import Target
from ..problem.problem import Problem
from .exponent_search import with_best_exponents, with_exponents
from .variable_projection import (
    LightTerms,
    SampledPixels,
    best_residual,
    known_terms,
    projected_costs,
    refine_lights,
    sample_pixels,
    scene_with,
    try_lights,
)

Start = Literal["scene", "lights", "auto"]

# The grid: how many directions are tried first, and at which distances in sizes of the scene. 160
# directions are 16 degrees apart; the time grows in proportion. Of 200 random scenes with 1 to 3
# lights 199 are found (docs/fits.md).
_DIRECTIONS, _DISTANCES = 160, (1.6, 5.0)

# Finer grids around the best: 5 x 5 directions, turned by at most so many degrees, and distances
# multiplied by so much. The first covers what lies nearer than the grid's next directions, 11
# degrees in the corners; each next covers two steps of the one before.
_ZOOMS, _STEPS, _STRETCHES = (12.0, 5.0, 2.0), 5, (0.6, 1.0, 1.7)

# How many of the best first directions are followed, and the cosine of the angle by which these are
# apart at least. Each costs as much as the one before and is tried only if none before explains the
# picture. 37 degrees are twice the grid's step, so that no neighbours are followed.
_STARTS, _LEAST_APART = 4, 0.8


def problem_starts(problem: Problem, start: Start) -> Iterator[Problem]:
    """Yields the problem from each of the starts that are to be tried.

    **Raises:** `InputError` for starts that are unknown, or that the scene does not allow.
    """
    if start not in get_args(Start):
        raise InputError(f"start must be one of {', '.join(get_args(Start))}, got {start!r}")
    free = problem.parameters[0].free
    if start == "scene":
        yield problem
        if not is_separable(problem):
            return
    elif edges := [name for name in free if name in GEOMETRY]:
        raise InputError(f"start {start} needs a known geometry, got {', '.join(edges)} free")
    elif not len(problem.parameters[0].scene.lights):
        raise InputError(
            f"start {start} needs to know how many lights there are, the scene has none"
        )
    elif not _lights_apart(problem):
        raise InputError(f"start {start} does not know lights whose positions are tied")
    starts_of = starts_from_nothing if start == "auto" else starts_from_lights
    pictures = zip(problem.parameters, problem.targets, problem.settings, strict=True)
    if not set(LIGHT_PLACES) & problem.per_picture:
        pictures = [next(pictures)]
    scenes = [starts_of(*picture) for picture in pictures]
    for start_scenes in zip(*scenes, strict=False):
        started = problem.starting_at(start_scenes)
        yield started.traced_at(started.start()) if problem.edges_move else started


def last_starts(problem: Problem, start: Start) -> Iterator[Problem]:
    """Yields the scene's own start: what a search leads to may be worse."""
    if start == "lights":
        yield problem
    elif start == "auto":
        yield from problem_starts(problem, "scene")


def is_separable(problem: Problem) -> bool:
    """Returns whether variable projection applies (separable least squares).

    The pictures must be linear in what is free of the spheres, and the lights free.
    """
    parameters = problem.parameters[0]
    lights_only = not GEOMETRY & set(parameters.free) and bool(free_places(parameters))
    linear = all(
        not s.needs.textures and not (s.bounces and s.needs.bounces) for s in problem.settings
    )
    square = all(t.loss == "square" for t in problem.targets)
    apart = _lights_apart(problem)
    return lights_only and apart and linear and square and len(parameters.scene.spheres) > 0


def _lights_apart(problem: Problem) -> bool:
    """Tells whether the places of all lights are unknowns of their own, or held."""
    return not any(c.tied for p in problem.parameters for c in light_constraints(p).values())


def free_places(parameters: Parameters) -> tuple[str, ...]:
    """Returns those of the lights' positions and directions that are free."""
    return tuple(name for name in LIGHT_PLACES if name in parameters.free)


def light_constraints(parameters: Parameters) -> dict[str, Constraint]:
    """Returns the constraints of the lights' positions and directions."""
    return {n: c for n, c in parameters.constraints.items() if n in LIGHT_PLACES}


def starts_from_lights(
    parameters: Parameters, target: Target, settings: RenderSettings
) -> Iterator[Scene]:
    """Yields one scene to start from: the lights downhill from where they are in this scene."""
    found, places = [], free_places(parameters)
    for samples in with_exponents(sample_pixels(parameters, target, settings), parameters):
        lights = parameters.scene.lights.position
        if places:
            lights = refine_lights(samples, lights, places, light_constraints(parameters))
        found.append((float(jnp.sum(best_residual(samples, lights) ** 2)), samples, lights))
    _, samples, lights = min(found, key=lambda of: of[0])
    yield scene_with(with_best_exponents(samples, parameters, lights), parameters, lights)


def starts_from_nothing(
    parameters: Parameters, target: Target, settings: RenderSettings
) -> Iterator[Scene]:
    """Yields scenes to start from, one after the other, the most promising first.

    **Arguments:** `parameters`: of their scene the geometry, the number of lights, and what is not
    free, are used.
    """
    places = free_places(parameters)
    if not places:
        yield from starts_from_lights(parameters, target, settings)
        return
    scene = parameters.scene
    rows = [parameters.free_numbers(name).any(axis=1) & rows_of(scene, name) for name in places]
    free = np.flatnonzero(np.any(rows, axis=0)).tolist()
    best = lambda terms, among, k: int(np.argmin(projected_costs(samples, terms, among, k)))
    tried = []
    for samples in with_exponents(sample_pixels(parameters, target, settings), parameters):
        grids = _Grids(samples)
        dark = known_terms(samples).at[np.array(free)].set(0)
        first = projected_costs(samples, dark, grids.of(free[0])[1], free[0])
        tried.append((float(first.min()), samples, grids, dark, first))
    _, samples, grids, dark, first = min(tried, key=lambda of: of[0])
    known = np.asarray(scene.lights.position, np.float64)
    grid, grid_terms = grids.of(free[0])
    for i in _spread(grids.offset(free[0], grid), np.argsort(first))[:_STARTS]:
        lights, terms = known.copy(), dark.at[free[0]].set(grid_terms[i])
        lights[free[0]] = grid[i]
        for k in [*free[1:], *(free if len(free) > 1 else [])]:
            every, every_terms = grids.of(k)
            j = best(terms, every_terms, k)
            lights[k], terms = every[j], terms.at[k].set(every_terms[j])
        for angle in _ZOOMS:
            for k in free:
                near = grids.around(k, lights[k], np.radians(angle))
                near_terms = try_lights(samples, k, near)
                j = best(terms, near_terms, k)
                lights[k], terms = near[j], terms.at[k].set(near_terms[j])
        lights = jnp.asarray(lights, scene.dtype)
        refined = refine_lights(samples, lights, places, light_constraints(parameters))
        yield scene_with(with_best_exponents(samples, parameters, refined), parameters, refined)


class _Grids:
    """The places that are tried for lights: points around the scene, or directions."""

    def __init__(self, samples: SampledPixels):
        self.samples, self.lights = samples, samples.scene.lights
        self.middle, self.size = (np.asarray(x, np.float64) for x in bounding_sphere(samples.scene))
        self._known: dict[tuple[bool, float], tuple[np.ndarray, LightTerms]] = {}

    def of(self, k: int) -> tuple[Float[np.ndarray, "c 3"], LightTerms]:
        """Returns the first places for a light, and its terms there."""
        alike = self.lights.directional[k], float(self.lights.falloff[k])
        if alike not in self._known:
            places = _directions(_DIRECTIONS)
            if not alike[0]:
                shells = [self.size * distance * places for distance in _DISTANCES]
                places = self.middle + np.concatenate(shells)
            self._known[alike] = places, try_lights(self.samples, k, places)
        return self._known[alike]

    def offset(self, k: int, places: Float[np.ndarray, "*c 3"]) -> Float[np.ndarray, "*c 3"]:
        """Returns the vectors to a light's places from the middle of the scene."""
        return places if self.lights.directional[k] else places - self.middle

    def around(
        self, k: int, place: Float[np.ndarray, " 3"], angle: float
    ) -> Float[np.ndarray, "c 3"]:
        """Returns a finer grid around a light's place. **Arguments:** as for `_neighbors`."""
        if self.lights.directional[k]:
            return _neighbors(place, angle, stretches=(1.0,))
        return self.middle + _neighbors(place - self.middle, angle, _STRETCHES)


def _directions(count: int) -> Float[np.ndarray, "count 3"]:
    """Returns directions all around, evenly spread (the Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)


def _neighbors(
    offset: Float[np.ndarray, " 3"], angle: float, stretches: tuple[float, ...]
) -> Float[np.ndarray, "c 3"]:
    """Returns vectors around one, turned by up to `angle` and stretched."""
    length = np.linalg.norm(offset)
    direction = offset / length
    first = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    first /= np.linalg.norm(first)
    second = np.cross(direction, first)
    steps = np.linspace(-np.tan(angle), np.tan(angle), _STEPS)
    turned = [direction + a * first + b * second for a in steps for b in steps]
    turned = np.stack([v / np.linalg.norm(v) for v in turned])
    return np.concatenate([turned * length * stretch for stretch in stretches])


def _spread(vectors: Float[np.ndarray, "c 3"], order: Int[np.ndarray, " c"]) -> list[int]:
    """Returns, of ordered vectors, those that differ in direction from all better ones."""
    units = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    kept: list[int] = []
    for i in order:
        if all(units[i] @ units[j] < _LEAST_APART for j in kept):
            kept.append(int(i))
    return kept
