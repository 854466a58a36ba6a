"""`fit`: finds the scene whose picture is nearest to a target picture."""

import dataclasses
import warnings
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.sharding import NamedSharding
from jaxtyping import Array, Float, PyTree

from ..base.errors import InputError, SceneWarning
from ..base.types import Highlight
from ..scene.scene import Scene
from ..xla.jit import compiled
from .diagnosis.identifiability import Identifiability, identify
from .diagnosis.outliers import find_outliers, resting_on_outliers
from .diagnosis.trust import Trust, explains, judge, together
from .diagnosis.uncertainty import Uncertainty, estimate
from .model.parameters import GEOMETRY
from .model.target import Loss
from .normal_equations.normal_equations import NormalEquations
from .problem.make_problem import make_problem
from .problem.problem import Problem, normal_at
from .solver.driver import Driver, Progress, check_solver
from .solver.gauge import GAUGES, Gauge, fix_gauge
from .solver.levenberg_marquardt import BoundedLevenbergMarquardt
from .solver.light_search import Start, problem_starts

DEFAULT_FREE = ("color", "ka", "kd", "ks", "light_position")

# How often at most what depends on a fit's residuals, the noise or the numbers to leave out, is
# estimated again and fitted with. More rounds cost a fit each, fewer may end before the estimate
# settles; the next two constants end most fits earlier.
_MOST_ROUNDS = 6

# The relative change of the noise below which an estimate is the last one. It moves robust losses'
# thresholds by as little, and estimates from a median of 10,000 numbers scatter by 1 %.
_NOISE_CHANGE = 0.02

# The part of the cost to which leaving out other numbers must lower it to be repeated. Nearer to 1
# it is repeated where the light stays and only the numbers left out differ.
_TRIMMING_DECREASE = 0.5


# Limit of the remarks in a fit's summary, in lines.
_MOST_REMARKS = 7


class Fit(eqx.Module):
    """The result of a fit, and what is to be thought of it."""

    scenes: list[Scene]  #: the best scenes found, one for each picture
    exposures: list[Float[Array, " 3"]]  #: what each picture is multiplied by, per channel
    result: optx.RESULTS  #: whether the solver converged; a readable message if not
    steps: int  #: evaluations of the picture and its Jacobian
    cost: float  #: half the sum of the squared residuals
    costs: tuple[float, ...]  #: the least so far, after every step; first those of wider pixels
    left_out: int  #: how many of the targets' numbers do not count: clipped, masked or too dark
    counted: int  #: how many do
    interrupted: bool  #: whether the user stopped it: the scene is the best so far
    problem: Problem
    values: PyTree  #: the unknowns at the solution
    noise_given: bool  #: whether residuals are multiples of a known noise

    def __str__(self) -> str:
        """Returns a summary of about ten lines; `repr` shows the whole pytree.

        It says whether to trust the fit, what was free, and what the pictures do not determine.
        """
        known, remarks = self.identifiability, together(self.trust.remarks)
        free = ", ".join(self.problem.parameters[0].free)
        lines = [
            self.trust.verdict,
            f"free: {free}; {known.rank} of {known.free} numbers determined",
        ]
        lines += remarks[:_MOST_REMARKS]
        if len(remarks) > _MOST_REMARKS:
            more = len(remarks) - _MOST_REMARKS
            lines.append(f"and {more} more remarks: print(found.trust)")
        return "\n".join(lines)

    @property
    def scene(self) -> Scene:
        """Returns the best scene found; of several pictures the first one's."""
        return self.scenes[0]

    @property
    def exposure(self) -> Float[Array, " 3"]:
        """Returns what the picture is multiplied by, per channel; 1 unless it is free."""
        return self.exposures[0]

    @property
    def result_message(self) -> str:
        """Returns why the solver stopped, if it did not converge."""
        # more sentences follow, on root finding and linear solvers
        return " ".join(str(optx.RESULTS[self.result]).split()).split(". ")[0].rstrip(".")

    @property
    def converged(self) -> bool:
        """Returns whether no better scene is within the tolerance."""
        return bool(self.result == optx.RESULTS.successful)

    @cached_property
    def normal(self) -> NormalEquations:
        """Returns the normal equations at the solution."""
        return normal_at(self.problem, self.values)

    @cached_property
    def identifiability(self) -> Identifiability:
        """Returns what the pictures determine, and in words what they do not."""
        return identify(self.uncertainty)

    @cached_property
    def uncertainty(self) -> Uncertainty:
        """Returns how well the pictures determine the result."""
        return estimate(self.problem, self.values, self.normal, 1.0 if self.noise_given else None)

    @cached_property
    def trust(self) -> Trust:
        """Returns whether the result is what it seems to be."""
        return judge(self)


def fit(
    scene: Scene | Sequence[Scene],
    target: Any,
    *,
    free: Sequence[str] = DEFAULT_FREE,
    own: Sequence[str] = (),
    highlight: Highlight = "phong",
    bounces: int = 5,
    samples: int = 1,
    mask: Any = None,
    weights: Any = None,
    noise: Any = None,
    darkest: float | None = None,
    loss: Loss = "square",
    shrink: int = 1,
    start: Start = "scene",
    gauge: Gauge = "ka",
    jacobian: Literal["structured", "dense"] = "structured",
    solver: optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser | None = None,
    max_steps: int = 100,
    rtol: float | None = None,
    atol: float | None = None,
    throw: bool = False,
    callback: Callable[[Progress], Any] | None = None,
    sharding: NamedSharding | None = None,
) -> Fit:
    """Finds the scene whose picture is nearest to `target`, starting from `scene`.

    Levenberg-Marquardt (Optimistix) on the normal equations of the difference of the pictures,
    which are summed up in one pass without the Jacobian. What is not free stays as it is. Colours
    and coefficients stay in 0..1, exponents stay positive. What the picture does not determine
    does not move from the start.

    Coarse to fine where centres, radii or the camera are free: edges have derivatives only for as
    long as they stay within their pixels. A fit goes first by pixels 25 times as wide, then 5
    times, each if 48 of them lie along each side. From there the pixels themselves take few steps.

    **Arguments:**

    - `scene`: the start; it also fixes the dtype of the fit. 1e-8 needs float64. For several
      pictures of one world a list of scenes that differ in their lights or cameras.
    - `target`: linear RGB of shape `(height, width, 3)`; as many as there are scenes. Numbers at 1
      in a picture without brighter ones are clipped, as in 8- and 16-bit files, and do not count.
    - `free`: among `color ka kd ks exponent kgr kt center radius` (of all spheres),
      `light_position light_color` (of all lights), `theta phi mu distance` (of the camera) and
      `exposure` (a factor per channel of the whole picture). An exponent of 0 starts as 0.01. For
      centers, radii and the camera the scene's antialias flag must be 1, or no derivative tells
      how edges move.
    - `own`: which of these have a value for each picture, among those of lights and camera;
      parameters that start differently must be named here. Each picture has its exposure.
    - `highlight`, `bounces`, `samples`: as for `render`.
    - `mask`: bool of shape `(height, width)` or `(height, width, 3)`: which numbers count.
    - `weights`: how much each number's square counts, at least 0.
    - `noise`: the standard deviation of the target's numbers; residuals and cost are then
      multiples of it.
    - `darkest`: numbers up to `darkest` are under-exposed and do not count. 0 leaves out black.
    - `loss`: `"square"`; `"huber"` or `"cauchy"` for targets with outliers, in units of the noise,
      which is estimated from the residuals if it is not given.
    - `shrink`: fits the means of boxes of `shrink` x `shrink` pixels, of which those count whose
      numbers all count. It must divide width and height. Memory and time are `shrink`² times
      less. A mean is one of an area: set antialias to 1, or `samples`.
    - `start`: `"lights"` searches for the lights first, from where they are in the scene. Each step
      takes the materials that suit them best, in closed form (variable projection). `"scene"`
      does so only if it finds nothing that explains the picture. `"auto"` starts from nothing: of
      `scene` only the geometry, the number of lights and what is not free are used, and directions
      all around are tried for the lights.
    - `gauge`: where color, ka and kd are all free, their common scale does not show: `"ka"` keeps
      ka at its start where the bounds allow it, `"color"` makes the brightest channel 1, `"none"`
      leaves what the solver came to.
    - `jacobian`: `"dense"` hands the solver the residuals of all pixels and their whole Jacobian,
      for comparison.
    - `solver`: any Optimistix least-squares solver or minimiser, by default Levenberg-Marquardt
      with bounds.
    - `rtol`, `atol`: the solver's tolerances on the unknowns, which are scaled to order one, and
      on the residuals; by default 1e-10 in float64 and 1e-6 in float32.
    - `throw`: raise an error if the solver does not converge.
    - `callback`: called with a `Progress` after each step.
    - `sharding`: how the pictures' rows lie on several devices, as for `render`: each device sums
      up the normal equations of its own rows, and what is found lies whole on all of them. Where
      devices are those of several processes, all of these call `fit` with the same arguments. A
      target, mask, weights or noise may be one array over several processes
      (`jax.make_array_from_process_local_data`), which is sent to all of them once: rows of one
      picture, or a list of pictures as one array of shape `(pictures, height, width, 3)`.

    With several pictures `mask`, `weights` and `noise` are lists, or one value for all.

    **Returns:** a `Fit`. A KeyboardInterrupt between two steps ends the fit with the best scene
    so far.

    **Warns:** `PictureWarning` of the memory that a large picture takes.

    **Raises:** `InputError` (a `ValueError`) for unusable targets, scenes, names and solvers, and
    inside jit, vmap and grad, where `solution` is the same fit.
    """
    check_solver(solver)
    problem = make_problem(
        scene, target, tuple(free), per_picture=tuple(own), highlight=highlight, bounces=bounces,
        samples=samples, sharding=sharding, mask=mask, weights=weights, noise=noise,
        darkest=darkest, loss=loss, shrink=shrink,
    )  # fmt: skip
    edges = ", ".join(name for name in free if name in GEOMETRY)
    if edges and not all(p.scene.antialias for p in problem.parameters):
        warnings.warn(
            f"{edges} free: a picture of single rays has no derivative where edges "
            "move; set antialias to 1",
            SceneWarning,
            stacklevel=2,
        )
    if gauge not in GAUGES:
        raise InputError(f"gauge must be one of {', '.join(GAUGES)}, got {gauge!r}")
    tolerance = 1e-10 if problem.dtype == jnp.float64 else 1e-6
    rtol, atol = (tolerance if t is None else t for t in (rtol, atol))
    best = None
    try:
        for started in problem_starts(problem, start):
            if solver is None:
                bounds = started.bounds()
                method = BoundedLevenbergMarquardt(rtol, atol, *bounds, cautious=bool(edges))
            else:
                method = solver
            driver = Driver(method, jacobian == "dense", rtol + atol, max_steps, callback)
            result = _fit_from_start(driver, started, gauge, noise)
            if best is None or not result.cost >= best.cost:
                best = result
            # another start after the scene's is for what that one does not find, not for too few
            # steps
            if result.interrupted or (start == "scene" and result.steps >= max_steps):
                break
            if result.converged and explains(result.problem, result.values, result.cost):
                break
    except KeyboardInterrupt:  # while the next start is sought
        if best is None:
            raise
        best = dataclasses.replace(best, interrupted=True)
    assert best is not None
    if throw and not best.interrupted and not best.converged:
        raise RuntimeError(
            f"the fit did not converge in {best.steps} steps ({best.result_message}): allow more "
            "(max_steps), or look at what it finds without throw=True"
        )
    return best


@compiled
def _finish(problem: Problem, values: PyTree, gauge: Gauge) -> tuple[PyTree, list]:
    values = fix_gauge(problem, values, gauge)
    return values, problem.scenes_at(values)


def _fit_from_start(driver: Driver, problem: Problem, gauge: Gauge, noise: Any) -> Fit:
    """Returns what is found from a problem's start."""
    values = problem.start()
    estimates_noise = problem.targets[0].loss != "square" and noise is None
    steps = 0
    try:
        for _ in range(_MOST_ROUNDS if estimates_noise else 1):
            if estimates_noise:
                estimated = problem.with_estimated_noise(values)
                if driver.costs and np.allclose(estimated.noise, problem.noise, rtol=_NOISE_CHANGE):
                    break
                problem = estimated
            problem, values = driver.solve_and_trace(problem, values)
            steps = len(driver.costs)
            if driver.interrupted or not driver.converged:
                break
        if driver.converged and not driver.interrupted and not estimates_noise:
            values = _past_shadow_edges(driver, problem, values)
            steps = len(driver.costs)
    except KeyboardInterrupt:  # between two solutions: what the first one found is kept
        driver.interrupted = True
        del driver.costs[steps:]
    values, pairs = _finish(problem, values, gauge)
    return Fit(
        scenes=[scene for scene, _ in pairs],
        exposures=[exposure for _, exposure in pairs],
        result=driver.result,
        steps=len(driver.costs),
        cost=driver.costs[-1] if driver.costs else float("nan"),
        costs=tuple(driver.costs),
        left_out=sum(t.image.size for t in problem.targets) - problem.counted,
        counted=problem.counted,
        interrupted=driver.interrupted,
        problem=problem,
        values=values,
        noise_given=noise is not None,
    )


def _past_shadow_edges(driver: Driver, problem: Problem, values: PyTree) -> PyTree:
    """Fits again where single rays may hold a light on the wrong side of a shadow's edge.

    As the edge moves, a picture of single rays jumps from pixel to pixel, without a derivative.
    Least trimmed squares (Rousseeuw 1984): the few numbers that fit worst are left out, others
    each time as long as that helps. What the rest leads to is kept if all then fit better.
    """
    shadows = any(s.needs.shadows and not s.antialias for s in problem.settings)
    if not shadows or "light_position" not in values:
        return values
    cost, before, result = driver.costs[-1], len(driver.costs), driver.result
    if explains(problem, values, cost) and not resting_on_outliers(
        find_outliers(problem, values, cost), problem, values
    ):
        return values
    trimmed, least = values, np.inf
    for _ in range(_MOST_ROUNDS):
        trimmed = driver.solve(problem.trimmed(trimmed), trimmed)
        if driver.interrupted or not driver.costs[-1] < _TRIMMING_DECREASE * least:
            break
        least = driver.costs[-1]
    after = len(driver.costs)
    if driver.converged and not driver.interrupted:
        trimmed = driver.solve(problem, trimmed)
    better = driver.converged and len(driver.costs) > after and driver.costs[-1] < cost
    # what is reported is the least cost so far, of all that counts
    last = [min(cost, c) for c in driver.costs[after:]] if better else []
    driver.costs[before:] = [cost] * (len(driver.costs) - before - len(last)) + last
    driver.result = driver.result if better else result
    return trimmed if better else values
