"""From a scene and a picture to the scene that looks like the picture."""

import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, ArrayLike

from .._types import Highlight
from ..errors import SceneWarning
from ..needs import needs
from ..options import options as render_options
from ..render import render
from ..scene import Scene
from .bounded import BoundedLevenbergMarquardt
from .parameters import (
    GEOMETRY,
    Values,
    bounds,
    check_free,
    check_present,
    hold_ka,
    length_scales,
    to_scene,
    to_solver,
)
from .residual import make_target

DEFAULT_FREE = ("color", "ka", "kd", "ks", "light_position")


class Progress(eqx.Module):
    """Where a fit is: passed to its callback after every step."""

    step: int
    max_steps: int
    cost: float
    scene: Scene  #: the best one so far


class Fit(eqx.Module):
    """What a fit found."""

    scene: Scene  #: the best scene found
    result: optx.RESULTS  #: whether the solver converged; a readable message if not
    steps: int  #: evaluations of the picture and its Jacobian
    cost: float  #: half the sum of the squared residuals at `scene`
    costs: tuple[float, ...]  #: the least cost so far, after every step
    left_out: int  #: how many of the target's numbers are clipped and do not count
    counted: int  #: how many do
    interrupted: bool  #: whether the user stopped it: `scene` is the best so far

    @property
    def result_message(self) -> str:
        """Why the solver stopped, if it did not converge."""
        return str(optx.RESULTS[self.result])

    @property
    def converged(self) -> bool:
        """Whether no better scene is within the tolerance."""
        return bool(self.result == optx.RESULTS.successful)


def fit(
    scene: Scene,
    target: ArrayLike,
    *,
    free: Sequence[str] = DEFAULT_FREE,
    highlight: Highlight = "phong",
    bounces: int = 5,
    samples: int = 1,
    solver: optx.AbstractLeastSquaresSolver | None = None,
    max_steps: int = 100,
    rtol: float | None = None,
    atol: float | None = None,
    throw: bool = False,
    callback: Callable[[Progress], Any] | None = None,
) -> Fit:
    """Finds the scene whose picture is nearest to `target`, starting from `scene`.

    Levenberg-Marquardt (Optimistix) on the difference of the pictures. What is not free stays as
    it is. Colours and coefficients stay in 0..1, exponents stay positive. Multiplying color by c
    and dividing ka and kd by c changes no picture: where all three are free, ka is kept at its
    start where the bounds allow it.

    **Arguments:**

    - `scene`: the start; it also fixes the dtype of the fit. 1e-8 needs float64.
    - `target`: linear RGB of shape `(height, width, 3)`. Numbers at 1 in a picture without
      brighter ones are clipped, as in 8- and 16-bit files, and do not count.
    - `free`: among `color ka kd ks exponent kgr kt center radius` (of all spheres),
      `light_position light_color` (of all lights) and `theta phi mu distance` (of the camera). An
      exponent of 0 starts as 0.01. For centers, radii and the camera the scene's antialias flag
      must be 1, or no derivative tells how edges move.
    - `highlight`, `bounces`, `samples`: as for `render`.
    - `solver`: any Optimistix solver of the Gauss-Newton family, by default Levenberg-Marquardt
      with bounds.
    - `rtol`, `atol`: the solver's tolerances on the unknowns, which are scaled to order one, and
      on the residuals; by default 1e-10 in float64 and 1e-6 in float32.
    - `throw`: raise an error if the solver does not converge.
    - `callback`: called with a `Progress` after each step.

    **Returns:** a `Fit`. A KeyboardInterrupt between two steps ends the fit with the best scene
    so far.

    **Raises:** `InputError` (a `ValueError`) for unusable targets and names.
    """
    free = tuple(free)
    check_free(free)
    check_present(scene, free)
    edges = [name for name in free if name in GEOMETRY]
    if edges and not scene.antialias:
        warnings.warn(
            f"{', '.join(edges)} free: a picture of single rays has no derivative where edges "
            "move; set antialias to 1",
            SceneWarning,
            stacklevel=2,
        )
    goal = make_target(target, scene.dtype)
    height, width, _ = goal.image.shape
    wanted = needs(scene, free=free)
    # complains before anything is compiled
    render_options(scene, width, height, highlight, bounces, samples, wanted)
    draw = partial(
        render, width=width, height=height, highlight=highlight, bounces=bounces, samples=samples,
        needs=wanted,
    )  # fmt: skip
    scales = length_scales(scene)

    def residual(values: Values, args: tuple) -> tuple[Array, None]:
        scene, scales, goal = args
        return goal.residual(draw(to_scene(scene, values, scales))), None

    tolerance = 1e-10 if scene.dtype == jnp.float64 else 1e-6
    rtol, atol = (tolerance if t is None else t for t in (rtol, atol))
    values = to_solver(scene, free, scales)
    if solver is None:
        solver = BoundedLevenbergMarquardt(rtol, atol, *bounds(values), cautious=bool(edges))
    run = _Run(solver, residual, (scene, scales, goal), rtol + atol)
    values, result, interrupted = run.solve(values, max_steps, callback)
    if throw and not interrupted and result != optx.RESULTS.successful:
        raise RuntimeError(f"the fit did not converge: {optx.RESULTS[result]}")
    fitted = hold_ka(to_scene(scene, values, scales), scene, free)
    counted = int(jnp.sum(goal.counts))
    return Fit(
        scene=fitted,
        result=result,
        steps=len(run.costs),
        cost=run.costs[-1] if run.costs else float("nan"),
        costs=tuple(run.costs),
        left_out=goal.counts.size - counted,
        counted=counted,
        interrupted=interrupted,
    )


class _Run:
    """Steps a solver from the host, so that a fit shows its progress and can be interrupted."""

    def __init__(self, solver: Any, residual: Callable, args: tuple, tolerance: float):
        self.solver, self.residual, self.args, self.tolerance = solver, residual, args, tolerance
        self.costs: list[float] = []

    def solve(self, values: Values, max_steps: int, callback: Callable | None):
        """**Returns:** the best values, the solver's result, and whether it was interrupted."""
        problem: dict[str, Any] = dict(fn=self.residual, options={}, tags=frozenset())
        step = eqx.filter_jit(eqx.Partial(self.solver.step, **problem))
        problem["args"] = self.args
        shape, _ = jax.eval_shape(self.residual, values, self.args)
        state = self.solver.init(y=values, f_struct=shape, aux_struct=None, **problem)
        try:
            for number in range(max_steps):
                values, state, _ = step(y=values, args=self.args, state=state)
                self.costs.append(float(0.5 * jnp.sum(state.f_info.residual**2)))
                if callback is not None:
                    best = to_scene(self.args[0], values, self.args[1])
                    callback(Progress(number + 1, max_steps, self.costs[-1], best))
                if not jnp.isfinite(self.costs[-1]):
                    return values, optx.RESULTS.nonfinite, False
                done, result = self.solver.terminate(y=values, state=state, **problem)
                if done or self._at_rest(values, state):
                    return values, result, False
        except KeyboardInterrupt:
            return values, optx.RESULTS.nonlinear_max_steps_reached, True
        return values, optx.RESULTS.nonlinear_max_steps_reached, False

    def _at_rest(self, values: Values, state: Any) -> bool:
        """Whether only steps below the tolerance are left, none of which lowers the cost."""
        if state.num_steps_since_acceptance < 2:
            return False
        moves = jax.tree.map(
            lambda a, b: jnp.max(jnp.abs(a - b) / (1 + jnp.abs(b))), state.y_eval, values
        )
        return bool(max(jax.tree.leaves(moves)) < self.tolerance)
