"""The driver: steps a solver from the host, from a problem's start to its end."""

from collections.abc import Callable
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, PyTree, Scalar

from ...base.errors import InputError
from ...scene.arrays import described
from ...scene.parameters import LIGHT_PLACES
from ...xla.jit import compiled
from ..normal_equations.normal_equations import NormalEquations
from ..problem.compression import compress, compressed_residual
from ..problem.problem import Problem, normal_at
from .levenberg_marquardt import CautiousTrustRegion

# The decrease of the cost, as a part of it, below which a step in a coarser picture is the last
# one. A smaller one takes more steps there, towards a minimum that is not the finer picture's; a
# larger one leaves the finer picture more of the way.
_COARSE_DECREASE = 0.1

# The decrease of the cost, as a part of it, below which a step gains little.
_LEAST_GAIN = 0.1

# How often samples are traced again at most, and how far lights may move, in tolerances, for the
# edges of their shadows to stay in their pixels. Fits of the lecture's scene trace twice.
_MOST_TRACES, _STILL = 6, 10


StoppedBy = Literal["interrupt", "callback", "max_steps"]
"""What ended a fit before it was done: the user, the user's callback, or the number of steps."""


class Progress(eqx.Module):
    """The state of a fit: passed to its callback after every step."""

    step: int
    max_steps: int
    cost: float  #: the least so far
    damping: float  #: of the step that was tried, in units of the solver's first
    scene: Any  #: the best one so far, a list of them where there are several pictures


class _Linearization(eqx.Module):
    """A compressed residual and its Jacobian at one point."""

    y: Float[Array, " free"]
    residual: Float[Array, " compressed"]
    jacobian: Float[Array, "compressed free"]


@compiled
def _linearize(normal: NormalEquations, values: PyTree) -> _Linearization:
    y, _ = ravel_pytree(values)
    return _Linearization(y, *compress(normal, y.dtype))


def _linear_residual(
    values: PyTree, point: _Linearization
) -> tuple[Float[Array, " compressed"], None]:
    """Returns the residual near a point, to first order.

    A step of the Gauss-Newton family asks for no more. So the picture's program is compiled once,
    whatever the solver, and the solver's quickly.
    """
    return point.residual + point.jacobian @ (ravel_pytree(values)[0] - point.y), None


def _cost(values: PyTree, problem: Problem) -> tuple[Scalar, None]:
    """Returns the cost, for solvers that minimise."""
    return jnp.sum(compressed_residual(values, problem) ** 2) / 2, None


def _dense_residual(values: PyTree, problem: Problem) -> tuple[Float[Array, " numbers"], None]:
    return problem.residual(values), None


@compiled
def _init(solver: Any, fn: Callable, args: Any, values: PyTree) -> Any:
    shape, _ = jax.eval_shape(fn, values, args)
    return solver.init(fn, values, args, _solver_options(fn), shape, None, frozenset())


def _solver_options(fn: Callable) -> dict[str, str]:
    # as a matrix, not as a function that would be another for each fit and be compiled again
    return {"jac": "bwd"} if fn is _linear_residual else {}


@compiled
def _step(solver: Any, fn: Callable, args: Any, values: PyTree, state: Any) -> tuple:
    """Takes one step of the solver.

    **Returns:** the best values so far, their cost, the state, and how far from the best values
    the solver evaluates next.
    """
    values, state, _ = solver.step(fn, values, args, _solver_options(fn), state, frozenset())
    moves = jax.tree.map(
        lambda a, b: jnp.max(jnp.abs(a - b) / (1 + jnp.abs(b))), _next(values, state), values
    )
    cost = _cost_after(fn, values, args, state)
    return values, cost, state, jnp.max(jnp.stack(jax.tree.leaves(moves)))


def _next(values: PyTree, state: Any) -> PyTree:
    """Returns where a solver evaluates next: its best values, unless it tries others first."""
    return getattr(state, "y_eval", values)


def _cost_after(fn: Callable, values: PyTree, args: Any, state: Any) -> Scalar:
    """Returns the cost that a solver's step came to, from its state if that keeps the cost."""
    if hasattr(state, "f_info"):
        return state.f_info.as_min()
    if hasattr(state, "f"):  # Optax's: of the values before the step
        return state.f
    return jnp.sum(fn(values, args)[0])


def check_solver(solver: Any) -> None:
    """Checks a fit's solver. **Raises:** `InputError` for all but least squares and minimisers."""
    if not isinstance(solver, optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser | None):
        got = repr(solver) if isinstance(solver, str) else described(solver)
        if isinstance(solver, type):
            got = f"the class {solver.__name__} in place of one of it"
        raise InputError(
            "solver must be a least-squares solver or a minimiser of Optimistix, such as "
            f"optimistix.LevenbergMarquardt(rtol, atol), got {got}"
        )


class Driver:
    """Steps of a fit's solvers from the host, so that it shows its progress and can be stopped.

    It counts the steps of all solves of a fit, and keeps the best scene so far.
    """

    def __init__(
        self,
        method: Callable[[Problem], Any],
        dense: bool,
        tolerance: float,
        max_steps: int,
        callback: Callable | None,
        step: Callable[[str, int], Any] = lambda text, done: None,
    ):
        """Takes how to solve.

        **Arguments:** `method`: from the problem of a start to its solver. `dense`: whether solvers
        see all residuals. `max_steps`: of all solves together. `step`: called with the cost, in
        words, and the number of steps after each.
        """
        self.method, self.dense, self.tolerance = method, dense, tolerance
        self.max_steps, self.callback, self.step = max_steps, callback, step
        self.costs: list[float] = []  #: the least so far, after every step
        self.result = optx.RESULTS.nonlinear_max_steps_reached
        self.stopped_by: StoppedBy | None = None
        self._best = np.inf, []  # the least cost before this solve, and its scenes
        self._last: tuple[Problem | None, float] = None, np.nan  # the cost of what was solved last

    def begin(self, problem: Problem) -> None:
        """Takes the solver that suits the problem of a start."""
        self.solver = self.method(problem)
        minimises = isinstance(self.solver, optx.AbstractMinimiser)
        self.fn = _dense_residual if self.dense else _cost if minimises else _linear_residual
        search = getattr(self.solver, "search", None)
        self.coarse_to_fine = self.fn is _linear_residual and isinstance(
            search, CautiousTrustRegion
        )

    @property
    def converged(self) -> bool:
        """Returns whether the last `solve` came to a minimum."""
        return bool(self.result == optx.RESULTS.successful)

    def cost_at(self, problem: Problem, values: PyTree) -> float:
        """Returns the cost of values that the last `solve` returned, for its problem or another."""
        solved, cost = self._last
        return cost if solved is problem else float(normal_at(problem, values).cost)

    def keep(self, problem: Problem, values: PyTree, cost: float) -> None:
        """Keeps values as the best so far, if they are, for what later steps report."""
        if cost < self._best[0]:
            self._best = cost, [scene for scene, _ in problem.scenes_at(values)]

    def solve(
        self, problem: Problem, values: PyTree, aside: bool = False, least_decrease: float = 0.0
    ) -> PyTree:
        """Solves a problem, coarse pictures first at the first call.

        **Arguments:** `aside`: of another cost than the fit's, so that nothing found is the best.
        `least_decrease`: a step that lowers the cost by less than this part of it is the last one.

        **Returns:** the best values, also if it is stopped.
        """
        coarser = problem.coarser() if self.coarse_to_fine and not self.costs else []
        step_size = None
        for coarse in coarser:
            values, step_size = self._solve(coarse, values, step_size, _COARSE_DECREASE)
            if self.stopped_by:
                return values
        return self._solve(problem, values, step_size, least_decrease, aside)[0]

    def solve_and_trace(self, problem: Problem, values: PyTree) -> tuple[Problem, PyTree]:
        """Solves a problem, and again with the samples of the lights found, until these stay.

        Where edges are covered, those of shadows move with the lights, and samples say which pixels
        have any.

        **Returns:** the problem with the last samples, and the best values.
        """
        for _ in range(_MOST_TRACES):
            before, values = values, self.solve(problem, values)
            if not problem.edges_move or self.stopped_by:
                break
            of_lights = lambda v: {n: v[n] for n in LIGHT_PLACES if n in v}
            lights = (ravel_pytree(of_lights(v))[0] for v in (before, values))
            moved = float(np.max(np.abs(np.subtract(*map(np.asarray, lights)))))
            if moved <= _STILL * self.tolerance:
                break
            problem = problem.traced_at(values)
            if not self.converged:
                break
        return problem, values

    def _solve(
        self,
        problem: Problem,
        values: PyTree,
        step_size: Scalar | None,
        least_decrease: float = 0.0,
        aside: bool = False,
    ) -> tuple[PyTree, Scalar | None]:
        """Solves a problem of one resolution.

        **Arguments:** `step_size`: the search's first one; None for the search's default.
        `least_decrease`: a step that lowers the cost by less than this part of it is the last one.

        **Returns:** the best values and the last step size, if they go on in a finer picture.
        """
        self.result = optx.RESULTS.nonlinear_max_steps_reached
        before, move_before = np.inf, np.inf
        state: Any = None
        try:
            while True:
                if len(self.costs) >= self.max_steps:
                    self.stopped_by = "max_steps"
                    break
                # what the residual function needs where it is evaluated next
                at = values if state is None else _next(values, state)
                args = self._args(problem, at)
                if state is None:
                    state = _init(self.solver, self.fn, args, values)
                    if step_size is not None:
                        state = eqx.tree_at(lambda s: s.search_state.step_size, state, step_size)
                stepped = _step(self.solver, self.fn, args, values, state)
                cost, move = float(stepped[1]), float(stepped[3])
                values, _, state, _ = stepped
                self._last = problem, cost
                self._report(problem, values, state, cost, aside)
                if self.stopped_by:
                    break
                if not np.isfinite(cost):
                    self.result = optx.RESULTS.nonfinite
                    break
                done, result = self.solver.terminate(
                    self.fn, values, args, _solver_options(self.fn), state, frozenset()
                )
                # or a step below the tolerance gained little, if any (the solver's own test asks
                # that residuals stay, but compressed ones turn); or only steps are left that are
                # so small that rounding hides what they do: a step changes the cost by its square
                rejected = getattr(state, "num_steps_since_acceptance", None)
                gained = before - cost > _LEAST_GAIN * before
                still = rejected is not None and move_before < self.tolerance and not gained
                hidden = move < np.sqrt(np.finfo(np.float64).eps)
                if done or still or (rejected is not None and rejected >= 2 and hidden):
                    self.result = result
                    break
                if not rejected and before * (1 - least_decrease) < cost < before:
                    break
                before, move_before = cost, move
        except KeyboardInterrupt:
            self.stopped_by = "interrupt"
        if state is None or not (least_decrease and self.coarse_to_fine):
            return values, None
        return values, state.search_state.step_size

    def _args(self, problem: Problem, values: PyTree) -> Any:
        """Returns what the residual function needs where it is evaluated next."""
        if self.fn is not _linear_residual:
            return problem
        normal = eqx.tree_at(lambda n: n.pictures, normal_at(problem, values), ())
        with jax.enable_x64(True):  # as the sums are in double precision
            return _linearize(normal, values)

    def _report(
        self, problem: Problem, values: PyTree, state: Any, cost: float, aside: bool
    ) -> None:
        """Notes a step's cost and tells the callback, which may stop the fit."""
        least, scenes = self._best
        better = not aside and (cost < least or np.isinf(least))
        self.costs.append(cost if better else least)
        self.step(f"cost {self.costs[-1]:.3e}", len(self.costs))
        if self.callback is None:
            return
        if better:
            scenes = [scene for scene, _ in problem.scenes_at(values)]
        search = getattr(state, "search_state", None)
        size = float(getattr(search, "step_size", 1.0))
        damping = 1 / size if size else float("inf")
        best = scenes[0] if len(scenes) == 1 else scenes
        progress = Progress(len(self.costs), self.max_steps, self.costs[-1], damping, best)
        try:
            answer = self.callback(progress)
        except StopIteration:
            answer = True
        if isinstance(answer, bool | np.bool_ | jax.Array) and np.all(answer):
            self.stopped_by = "callback"
