"""Multistart: a fit from one start after the other, until one explains the pictures."""

from collections.abc import Iterable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Bool, PyTree

from ..scene.parameters import LIGHT_PLACES, rows_of
from ..scene.scene import Scene
from .diagnosis.outliers import find_outliers, resting_on_outliers
from .diagnosis.residual_structure import explains
from .model.accessors import GEOMETRY
from .model.parameters import Parameters, bounding_sphere
from .problem.problem import Problem
from .solver.driver import Driver

# How often at most what depends on a fit's residuals, the noise or the numbers to leave out, is
# estimated again and fitted with. More rounds cost a fit each, fewer may end before the estimate
# settles; the next two constants end most fits earlier.
_MOST_ROUNDS = 6

# The relative change of the noise below which an estimate is the last one. It moves robust losses'
# thresholds by as little, and estimates from a median of 10,000 numbers scatter by 1 %.
_NOISE_CHANGE = 0.02

# The decrease of the sum of squares, as a part of it, below which a step is the last one before a
# robust loss goes on. The solution with squares is not the robust one, so need not be exact.
_ROUGH_DECREASE = 0.01

# The distance of a light from a sphere's middle, in radii, below which it is suspect: wrong models
# are imitated by lights close by. Such a light counts if its cost is below this part of others'.
_NEAR, _CLEARLY = 1.5, 0.8

# The distance at which a fit begins once more if its light is suspect, in sizes of the scene.
_FAR = 4.0

# The part of the cost to which leaving out other numbers must lower it to be repeated. Nearer to 1
# it is repeated where the light stays and only the numbers left out differ.
_TRIMMING_DECREASE = 0.5


class Found(NamedTuple):
    """What a fit came to from one of its starts."""

    problem: Problem
    values: PyTree
    cost: float
    result: optx.RESULTS

    @property
    def converged(self) -> bool:
        """Returns whether it is a minimum."""
        return bool(self.result == optx.RESULTS.successful)

    @property
    def explains(self) -> bool:
        """Returns whether it is a minimum that explains the pictures."""
        return self.converged and explains(self.problem, self.values, self.cost)


def fit_from_starts(
    driver: Driver, starts: Iterable[Problem], last: Iterable[Problem], noise_given: bool
) -> Found:
    """Returns the first that explains the pictures, or the best, of what starts lead to.

    Solves past the edges of shadows come after all starts: they take many steps, and another start
    may do without them.

    **Arguments:** `last`: starts for when even these solves do not explain the pictures.
    """
    tried: list[Found] = []
    try:
        if _explained_from(starts, driver, tried, noise_given):
            return tried[-1]
        if tried and not driver.stopped_by and _is_near(min(tried, key=_rank)):
            _try(_from_afar(min(tried, key=_rank)), driver, tried, noise_given)
        for found in sorted(tried, key=_rank):
            if driver.stopped_by or not _may_jump(found, noise_given):
                break
            driver.begin(found.problem)
            tried.append(_past_shadow_edges(driver, found))
            if tried[-1].explains:
                break
        if not driver.stopped_by and not tried[-1].explains:
            _explained_from(last, driver, tried, noise_given)
    except KeyboardInterrupt:  # between two solves, or while the next start is sought
        if not tried:
            raise
        driver.stopped_by = "interrupt"
    return min(tried, key=_rank)


def _explained_from(
    starts: Iterable[Problem], driver: Driver, tried: list[Found], noise_given: bool
) -> bool:
    """Adds what starts lead to, up to the first that explains the pictures. **Returns:** if so."""
    for started in starts:
        _try(started, driver, tried, noise_given)
        if driver.stopped_by:
            break
        if tried[-1].explains:
            if _rests_on_outliers(tried[-1], noise_given):
                tried.append(_past_shadow_edges(driver, tried[-1]))
            return True
    return False


def _try(started: Problem, driver: Driver, tried: list[Found], noise_given: bool) -> None:
    """Adds what one start leads to."""
    driver.begin(started)
    tried.append(_fit_from_start(driver, started, noise_given))
    driver.keep(*tried[-1][:3])


def _rank(found: Found) -> float:
    """Returns what is least for the best: the cost, more for lights close to spheres."""
    if not np.isfinite(found.cost):
        return np.inf
    return found.cost / _CLEARLY if _is_near(found) else found.cost


def _is_near(found: Found) -> bool:
    """Tells whether a light that is free is close to a sphere in scenes that explain too little."""
    if "light_position" not in found.values or GEOMETRY & set(found.values):
        return False
    scenes = [scene for scene, _ in found.problem.scenes_at(found.values)]
    return any(map(lambda s, p: _suspect(s, p).any(), scenes, found.problem.parameters))


def _suspect(scene: Scene, parameters: Parameters) -> Bool[np.ndarray, " lights"]:
    """Returns which lights are free and close to a sphere."""
    center, radius = (np.asarray(x) for x in (scene.spheres.center, scene.spheres.radius))
    offset = np.asarray(scene.lights.position)[:, None] - center[None]
    near = (np.linalg.norm(offset, axis=-1) < _NEAR * radius[None]).any(axis=1)
    free = parameters.free_numbers("light_position").any(axis=1)
    return near & free & rows_of(scene, "light_position")


def _from_afar(found: Found) -> Problem:
    """Returns the problem from what was found, with lights that are close in the same direction."""

    def away(scene: Scene, parameters: Parameters) -> Scene:
        middle, size = (np.asarray(x) for x in bounding_sphere(scene))
        lights = np.asarray(scene.lights.position)
        offset = lights - middle
        length = np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), 1e-3 * size)
        moved = np.where(
            _suspect(scene, parameters)[:, None], middle + offset / length * _FAR * size, lights
        )
        return eqx.tree_at(lambda s: s.lights.position, scene, jnp.asarray(moved, scene.dtype))

    scenes = [scene for scene, _ in found.problem.scenes_at(found.values)]
    started = found.problem.starting_at(list(map(away, scenes, found.problem.parameters)))
    return started.traced_at(started.start()) if started.edges_move else started


def _estimates_noise(problem: Problem, noise_given: bool) -> bool:
    return problem.targets[0].loss != "square" and not noise_given


def _fit_from_start(driver: Driver, problem: Problem, noise_given: bool) -> Found:
    """Returns what is found from a problem's start."""
    values, estimates_noise = problem.start(), _estimates_noise(problem, noise_given)
    try:
        if problem.targets[0].loss != "square":
            # far from the solution nearly all numbers are outliers, and tell robust losses little
            squares = problem.with_squares()
            values = driver.solve(squares, values, aside=True, least_decrease=_ROUGH_DECREASE)
            if driver.stopped_by:
                return Found(problem, values, driver.cost_at(problem, values), driver.result)
        for k in range(_MOST_ROUNDS if estimates_noise else 1):
            if estimates_noise:
                estimated = problem.with_estimated_noise(values)
                if k and np.allclose(estimated.noise, problem.noise, rtol=_NOISE_CHANGE):
                    break
                problem = estimated
            problem, values = driver.solve_and_trace(problem, values)
            if driver.stopped_by or not driver.converged:
                break
    except KeyboardInterrupt:  # between two solves: what the first one found is kept
        driver.stopped_by = "interrupt"
    return Found(problem, values, driver.cost_at(problem, values), driver.result)


def _may_jump(found: Found, noise_given: bool) -> bool:
    """Tells whether edges of shadows may hold lights: those of single rays have no derivative."""
    shadows = any(s.needs.shadows and not s.antialias for s in found.problem.settings)
    noise_known = not _estimates_noise(found.problem, noise_given)
    return (
        shadows and noise_known and found.converged and bool(set(LIGHT_PLACES) & set(found.values))
    )


def _rests_on_outliers(found: Found, noise_given: bool) -> bool:
    """Tells whether something is known only from numbers that do not fit, as edges may jump."""
    if not _may_jump(found, noise_given):
        return False
    outliers = find_outliers(found.problem, found.values, found.cost)
    return bool(resting_on_outliers(outliers, found.problem, found.values))


def _past_shadow_edges(driver: Driver, found: Found) -> Found:
    """Fits again where single rays may hold a light on the wrong side of a shadow's edge.

    As the edge moves, a picture of single rays jumps from pixel to pixel, without a derivative.
    Least trimmed squares (Rousseeuw 1984): the few numbers that fit worst are left out, others
    each time as long as that helps. What the rest leads to is kept if all then fit better.
    """
    problem, trimmed, least = found.problem, found.values, np.inf
    for _ in range(_MOST_ROUNDS):
        without = problem.trimmed(trimmed)
        trimmed = driver.solve(without, trimmed, aside=True)
        cost = driver.cost_at(without, trimmed)
        if driver.stopped_by or not cost < _TRIMMING_DECREASE * least:
            break
        least = cost
    if driver.stopped_by or not driver.converged:
        return found
    trimmed = driver.solve(problem, trimmed)
    cost = driver.cost_at(problem, trimmed)
    better = driver.converged and cost < found.cost
    return Found(problem, trimmed, cost, driver.result) if better else found
