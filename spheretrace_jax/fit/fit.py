"""`fit`: finds the scene whose picture is nearest to a target picture."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import optimistix as optx
from jax.sharding import NamedSharding
from jaxtyping import PyTree

from ..base.errors import InputError, SceneWarning
from ..base.progress import working
from ..base.types import Highlight
from ..scene.numbers import whole_number
from ..scene.scene import Scene
from ..xla.jit import compiled
from .model.accessors import GEOMETRY
from .model.constraints import Free, free_names
from .model.target import Loss
from .multistart import fit_from_starts
from .problem.make_problem import make_problem
from .problem.problem import Problem
from .result import TOLERANCE, Fit
from .solver.driver import Driver, Progress, check_solver
from .solver.gauge import GAUGES, Gauge, fix_gauge
from .solver.levenberg_marquardt import BoundedLevenbergMarquardt, tolerances
from .solver.light_search import Start, last_starts, problem_starts

#: What is free by default where all lights are at points.
DEFAULT_FREE = ("color", "ka", "kd", "ks", "light_position")


def fit(
    scene: Scene | Sequence[Scene],
    target: Any,
    *,
    free: Free | None = None,
    own: str | Sequence[str] = (),
    tie: Mapping[str, Any] | None = None,
    bounds: Mapping[str, Any] | None = None,
    priors: Mapping[str, Any] | None = None,
    highlight: Highlight = "phong",
    bounces: int = 5,
    samples: int = 1,
    mask: Any = None,
    weights: Any = None,
    noise: Any = None,
    darkest: float | None = None,
    brightest: Any = None,
    loss: Loss = "square",
    shrink: int = 1,
    start: Start = "scene",
    gauge: Gauge = "ka",
    jacobian: Literal["structured", "dense"] = "structured",
    solver: optx.AbstractLeastSquaresSolver[Any, Any, Any, Any]
    | optx.AbstractMinimiser[Any, Any, Any]
    | None = None,
    max_steps: int = 300,
    rtol: float | None = None,
    atol: float | None = None,
    tolerance: float = TOLERANCE,
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
    - `target`: linear RGB of shape `(height, width, 3)`, or grey, `(height, width)`; as many as
      there are scenes. uint8, uint16 and floating numbers over 0..255 or 0..65535 are divided by
      these, with a warning; other arguments then speak of numbers up to 1.
    - `free`: among `color ka kd ks exponent kgr kt ior center radius` (of all spheres),
      `light_position` (of lights at points), `light_direction` (of directional ones),
      `light_color`, `theta phi mu distance roll look_at principal_point pixel_aspect` (of the
      camera; the focal length is `distance`) and `exposure` (a factor per channel of the whole
      picture); by default color, ka, kd, ks and where all lights are. An exponent of 0 starts as
      0.01, an index of refraction of 1 as 1.5; the latter ends in 1..2.5. For centers,
      radii and the camera the scene's antialias flag must be 1, or no derivative tells how edges
      move.
      A mapping says which objects' numbers are: `{"color": [0, 2], "kd": True}` holds all other
      colours. Values are True, False, indices, or a boolean array of shape `(objects,)` or the
      parameter's own.
    - `tie`: what objects share: `{"kd": [[0, 1, 2]]}` gives three spheres one kd, `{"kd": True}`
      all of them. Tied parameters must start alike.
    - `bounds`: `{"radius": (50, 120)}` keeps numbers between two, in the scene's units; each may be
      an array with a number for each object, -inf and inf for none. Not for where lights are.
    - `priors`: `{"kd": (mean, sigma)}` adds ((kd - mean) / sigma)² / 2 to the cost, for each number
      or each tied group: a Gaussian prior of standard deviation sigma, in the scene's units. Needs
      `noise`. Standard deviations and what is determined then count the priors. Not for
      `light_direction`.
    - `own`: which of these have a value for each picture, among those of lights and camera;
      parameters that start differently must be named here. Each picture has its exposure.
    - `highlight`, `bounces`, `samples`: as for `render`.
    - `mask`: of shape `(height, width)` or `(height, width, 3)`: which numbers count. Bool, or
      numbers over 0..1 or 0..255, of which more than half says yes.
    - `weights`: how much each number's square counts, at least 0.
    - `noise`: the standard deviation of the target's numbers; residuals and cost are then
      multiples of it. `"photo"`: of variance a + b I at level I, estimated from differences of
      neighbours in the picture; `photo_noise` holds a and b.
    - `darkest`: numbers up to `darkest` are under-exposed and do not count. 0 leaves out black.
    - `brightest`: numbers from `brightest` on are saturated and do not count: one level, or one for
      each channel; inf for none. By default these are numbers at 1 in a picture without brighter
      ones, as in 8- and 16-bit files, and those at a level that a channel does not exceed, if the
      picture falls steadily around them. `trust` asks about a level where the picture jumps.
    - `loss`: `"square"`; `"huber"` or `"cauchy"` for targets with outliers, in units of the noise,
      which is estimated from the residuals if it is not given.
    - `shrink`: fits the means of boxes of `shrink` x `shrink` pixels, of which those count whose
      numbers all count. It must divide width and height. Memory and time are `shrink`² times
      less. A mean is one of an area: set antialias to 1, or `samples`.
    - `start`: `"lights"` searches for the lights first, from where they are in the scene. Each step
      takes the materials that suit them best, in closed form (variable projection). `"scene"`
      does so only if it finds nothing that explains the picture. `"auto"` starts from nothing: of
      `scene` only the geometry, the number of lights and what is not free are used, and directions
      all around are tried for the lights. Where exponents are free, `"lights"` and `"auto"` try a
      few. If nothing explains the picture they begin from the scene as well, and the nearest to the
      picture is kept; a light within 1.5 radii of a sphere's middle only if it is nearer by far.
    - `gauge`: where color, ka and kd are all free, their common scale does not show: `"ka"` keeps
      ka at its start where the bounds allow it, `"color"` makes the brightest channel 1, `"none"`
      leaves what the solver came to.
    - `jacobian`: `"dense"` hands the solver the residuals of all pixels and their whole Jacobian,
      for comparison.
    - `solver`: any Optimistix least-squares solver or minimiser, by default Levenberg-Marquardt
      with bounds.
    - `rtol`, `atol`: the solver's tolerances on the unknowns, which are scaled to order one, and
      on the residuals; by default 1e-10 in float64 and 1e-6 in float32.
    - `max_steps`: the limit of the steps of the whole fit, over coarse pictures, all starts and
      whatever is solved again; the search for lights on a sample of pixels has none of these.
    - `tolerance`: the structured part of the residual, as a part of the picture's
      root-mean-square, up to which `trust` calls the result usable; up to a quarter of it, good.
    - `throw`: raise an error if the solver does not converge.
    - `callback`: called with a `Progress` after each step. If it returns True or raises
      StopIteration, the fit ends with the best scene so far.
    - `sharding`: how the pictures' rows lie on several devices, as for `render`: each device sums
      up the normal equations of its own rows, and what is found lies whole on all of them. Where
      devices are those of several processes, all of these call `fit` with the same arguments. A
      target, mask, weights or noise may be one array over several processes
      (`jax.make_array_from_process_local_data`), which is sent to all of them once: rows of one
      picture, or a list of pictures as one array of shape `(pictures, height, width, 3)`.

    With several pictures `mask`, `weights`, `noise`, `darkest` and `brightest` are lists, or one
    value for all.

    **Returns:** a `Fit`. A KeyboardInterrupt ends the fit with the best scene so far, too; its
    `stopped_by` says what ended it.

    **Warns:** `PictureWarning` of the memory that a large picture takes.

    **Raises:** `InputError` (a `ValueError`) for unusable targets, scenes, names and solvers, and
    inside jit, vmap and grad, where `solution` is the same fit.
    """
    check_solver(solver)
    problem = make_problem(
        scene, target, free, per_picture=free_names(own), tie=tie, limits=bounds, priors=priors,
        highlight=highlight, bounces=bounces, samples=samples, sharding=sharding, mask=mask,
        weights=weights, noise=noise, darkest=darkest, brightest=brightest, loss=loss,
        shrink=shrink,
    )  # fmt: skip
    edges = ", ".join(name for name in problem.parameters[0].free if name in GEOMETRY)
    if edges and not all(p.scene.antialias for p in problem.parameters):
        warnings.warn(
            f"{edges} free: a picture of single rays has no derivative where edges "
            "move; set antialias to 1",
            SceneWarning,
            stacklevel=2,
        )
    if gauge not in GAUGES:
        raise InputError(f"gauge must be one of {', '.join(GAUGES)}, got {gauge!r}")
    if not 0 < tolerance <= 1:
        raise InputError(f"tolerance must be above 0 and at most 1, got {tolerance}")
    max_steps = whole_number("max_steps", max_steps)
    if max_steps < 0:
        raise InputError(f"max_steps must be at least 0, got {max_steps}")
    rtol, atol = tolerances(problem.dtype, rtol, atol)

    def method(started: Problem) -> Any:
        if solver is not None:
            return solver
        return BoundedLevenbergMarquardt(rtol, atol, *started.bounds(), cautious=bool(edges))

    with working("fitting", max_steps) as step:
        driver = Driver(method, jacobian == "dense", rtol + atol, max_steps, callback, step)
        starts = problem_starts(problem, start), last_starts(problem, start)
        found = fit_from_starts(driver, *starts, noise is not None)
        values, pairs = _finish(found.problem, found.values, gauge)
    best = Fit(
        scenes=[scene for scene, _ in pairs],
        exposures=[exposure for _, exposure in pairs],
        result=found.result,
        steps=len(driver.costs),
        cost=found.cost,
        costs=tuple(driver.costs),
        left_out=sum(t.image.size for t in found.problem.targets) - found.problem.counted,
        counted=found.problem.counted,
        stopped_by=driver.stopped_by,
        problem=found.problem,
        values=values,
        starts=[p.scene for p in problem.parameters],
        noise_given=noise is not None,
        brightest_given=brightest is not None,
        tolerance=tolerance,
    )
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
