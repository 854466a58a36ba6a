"""From a scene and a picture to the scene that looks like the picture."""

import dataclasses
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Any, Literal, get_args

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
from .diagnosis.trust import Trust, explains, judge
from .diagnosis.uncertainty import Uncertainty, estimate
from .model.parameters import GEOMETRY
from .model.target import Loss
from .normal_equations.normal_equations import NormalEquations
from .problem.problem import Problem, make_problem, normal_at
from .solver.driver import Driver, Progress
from .solver.gauge import GAUGES, Gauge, settle
from .solver.levenberg_marquardt import BoundedLevenbergMarquardt
from .solver.light_search import start_from_lights, start_from_nothing

Start = Literal["scene", "lights", "auto"]

DEFAULT_FREE = ("color", "ka", "kd", "ks", "light_position")

# What is estimated from a fit's residuals is estimated again after the next, at most so often.
_MOST_ROUNDS = 6


class Fit(eqx.Module):
    """What a fit found, and what is to be thought of it."""

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

    @property
    def scene(self) -> Scene:
        """The best scene found; of several pictures the first one's."""
        return self.scenes[0]

    @property
    def exposure(self) -> Float[Array, " 3"]:
        """What the picture is multiplied by, per channel; 1 unless it is free."""
        return self.exposures[0]

    @property
    def result_message(self) -> str:
        """Why the solver stopped, if it did not converge."""
        return str(optx.RESULTS[self.result])

    @property
    def converged(self) -> bool:
        """Whether no better scene is within the tolerance."""
        return bool(self.result == optx.RESULTS.successful)

    @cached_property
    def normal(self) -> NormalEquations:
        """The normal equations at the solution."""
        return normal_at(self.problem, self.values)

    @cached_property
    def identifiability(self) -> Identifiability:
        """What the pictures determine, and in words what they do not."""
        return identify(self.uncertainty)

    @cached_property
    def uncertainty(self) -> Uncertainty:
        """How well the pictures determine it."""
        return estimate(self.problem, self.values, self.normal, 1.0 if self.noise_given else None)

    @cached_property
    def trust(self) -> Trust:
        """Whether the result is what it seems to be."""
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

    Edges have derivatives for as long as they stay within their pixels. So where centres, radii or
    the camera are free, a fit goes first by pixels 5 times as wide, before that 25 times, as long
    as 48 of them lie along each side. From there the pixels themselves take few steps.

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
    - `own`: which of these each picture has of its own, among those of lights and camera; what
      starts differently must be named here. The exposure always is.
    - `highlight`, `bounces`, `samples`: as for `render`.
    - `mask`: bool of shape `(height, width)` or `(height, width, 3)`: which numbers count.
    - `weights`: what each number counts, at least 0.
    - `noise`: the standard deviation of the target's numbers; residuals and cost are then
      multiples of it.
    - `darkest`: numbers up to this are under-exposed and do not count. 0 leaves out what is black.
    - `loss`: `"square"`; `"huber"` or `"cauchy"` for targets with outliers, in units of the noise,
      which is estimated from the residuals if it is not given.
    - `start`: `"lights"` looks for the lights first, from where they are in the scene, each time
      with the materials that suit them best, in closed form (variable projection); `"scene"` does
      so only if it finds nothing that explains the picture. `"auto"` starts from nothing: of
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
      target, mask, weights or noise may be an array whose parts lie with several processes, such
      as rows of one picture, or pictures of a list that is one array of shape `(pictures, height,
      width, 3)` (`jax.make_array_from_process_local_data`): it is sent to all of them once.

    With several pictures `mask`, `weights` and `noise` are lists, or one value for all.

    **Returns:** a `Fit`. A KeyboardInterrupt between two steps ends the fit with the best scene
    so far.

    **Raises:** `InputError` (a `ValueError`) for unusable targets and names.
    """
    problem = make_problem(
        scene, target, tuple(free), tuple(own), highlight, bounces, samples, sharding,
        mask=mask, weights=weights, noise=noise, darkest=darkest, loss=loss,
    )  # fmt: skip
    edges = _geometry(free)
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
        for begin in _starts(problem, start):
            if solver is None:
                bounds = _begin(begin)[1]
                method = BoundedLevenbergMarquardt(rtol, atol, *bounds, cautious=bool(edges))
            else:
                method = solver
            run = Driver(method, jacobian == "dense", rtol + atol, max_steps, callback)
            found = _found(run, begin, gauge, noise)
            if best is None or not found.cost >= best.cost:
                best = found
            # another start after the scene's own is for what it does not find, not for too few
            # steps
            if found.interrupted or (start == "scene" and found.steps >= max_steps):
                break
            if found.converged and explains(found.problem, found.values, found.cost):
                break
    except KeyboardInterrupt:  # while the next start is sought
        if best is None:
            raise
        best = dataclasses.replace(best, interrupted=True)
    assert best is not None
    if throw and not best.interrupted and not best.converged:
        raise RuntimeError(f"the fit did not converge: {best.result_message}")
    return best


def _geometry(free: Sequence[str]) -> str:
    return ", ".join(name for name in free if name in GEOMETRY)


def _starts(problem: Problem, start: Start) -> Iterator[Problem]:
    """The problem from each of the starts that are to be tried."""
    if start not in get_args(Start):
        raise InputError(f"start must be one of {', '.join(get_args(Start))}, got {start!r}")
    free = problem.parameters[0].free
    if start == "scene":
        yield problem
        if not _projects(problem):
            return
    elif GEOMETRY & set(free):
        raise InputError(f"start {start} needs a known geometry, got {_geometry(free)} free")
    elif not len(problem.parameters[0].scene.lights):
        raise InputError(
            f"start {start} needs to know how many lights there are, the scene has none"
        )
    propose = start_from_nothing if start == "auto" else start_from_lights
    own = "light_position" in problem.own
    pictures = zip(problem.parameters, problem.targets, problem.settings, strict=True)
    proposals = [
        propose(parameters.scene, target, settings, free)
        for parameters, target, settings in (pictures if own else [next(pictures)])
    ]
    for scenes in zip(*proposals, strict=False):
        yield problem.starting_at(scenes)


def _projects(problem: Problem) -> bool:
    """Whether pictures are linear in what is free of the spheres, and the lights are free."""
    parameters = problem.parameters[0]
    known = not GEOMETRY & set(parameters.free) and "light_position" in parameters.free
    plain = all(
        not o.needs.textures and not (o.bounces and o.needs.bounces) for o in problem.settings
    )
    square = all(t.loss == "square" for t in problem.targets)
    return known and plain and square and len(parameters.scene.spheres) > 0


@compiled
def _begin(problem: Problem) -> tuple[PyTree, tuple[PyTree, PyTree]]:
    return problem.start(), problem.bounds()


@compiled
def _finish(problem: Problem, values: PyTree, gauge: Gauge) -> tuple[PyTree, list]:
    values = settle(problem, values, gauge)
    return values, problem.place(values)


def _found(run: Driver, problem: Problem, gauge: Gauge, noise: Any) -> Fit:
    """What is found from a problem's start."""
    values, _ = _begin(problem)
    estimated = problem.targets[0].loss != "square" and noise is None
    steps = 0
    try:
        for _ in range(_MOST_ROUNDS if estimated else 1):
            if estimated:
                again = problem.with_noise_at(values)
                if run.costs and np.allclose(again.noise, problem.noise, rtol=0.02):
                    break
                problem = again
            values = run.solve(problem, values)
            steps = len(run.costs)
            if run.interrupted or not run.converged:
                break
        if run.converged and not run.interrupted and not estimated:
            values = _past_shadows(run, problem, values)
            steps = len(run.costs)
    except KeyboardInterrupt:  # between two solutions: what the first one found is kept
        run.interrupted = True
        del run.costs[steps:]
    values, placed = _finish(problem, values, gauge)
    return Fit(
        scenes=[scene for scene, _ in placed],
        exposures=[exposure for _, exposure in placed],
        result=run.result,
        steps=len(run.costs),
        cost=run.costs[-1] if run.costs else float("nan"),
        costs=tuple(run.costs),
        left_out=sum(t.image.size for t in problem.targets) - problem.counted,
        counted=problem.counted,
        interrupted=run.interrupted,
        problem=problem,
        values=values,
        noise_given=noise is not None,
    )


def _past_shadows(run: Driver, problem: Problem, values: PyTree) -> PyTree:
    """A second look where single rays may hold a light on the wrong side of a shadow's edge.

    As the edge moves, such a picture jumps from pixel to pixel, without a derivative. The few
    numbers that fit worst are left out, others each time as long as that helps (least trimmed
    squares, Rousseeuw 1984); where the rest leads is kept if all then fit better.
    """
    shadows = any(o.needs.shadows and not o.antialias for o in problem.settings)
    if not shadows or "light_position" not in values:
        return values
    cost, before, result = run.costs[-1], len(run.costs), run.result
    if explains(problem, values, cost) and not resting_on_outliers(
        find_outliers(problem, values, cost), problem, values
    ):
        return values
    elsewhere, least = values, np.inf
    for _ in range(_MOST_ROUNDS):
        elsewhere = run.solve(problem.without_worst_at(elsewhere), elsewhere)
        if run.interrupted or not run.costs[-1] < 0.5 * least:
            break
        least = run.costs[-1]
    without = len(run.costs)
    if run.converged and not run.interrupted:
        elsewhere = run.solve(problem, elsewhere)
    better = run.converged and len(run.costs) > without and run.costs[-1] < cost
    # what is reported is the least cost so far, of all that counts
    after = [min(cost, c) for c in run.costs[without:]] if better else []
    run.costs[before:] = [cost] * (len(run.costs) - before - len(after)) + after
    run.result = run.result if better else result
    return elsewhere if better else values
