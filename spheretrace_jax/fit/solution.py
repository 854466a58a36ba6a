"""`solution`: what a fit finds, as a pure function that is differentiable under jit."""

from typing import Any

import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, PyTree

from ..scene.scene import Scene
from .problem.compression import compressed_residual
from .problem.problem import Problem
from .solver.levenberg_marquardt import BoundedLevenbergMarquardt

# Singular values of the Hessian, as parts of the largest, below which nothing is determined.
# Smaller ones are rounding errors in float64; a larger cutoff freezes what is weakly determined.
_NULL = 1e-11


def solution(
    problem: Problem, *, max_steps: int = 100, rtol: float = 1e-10, atol: float = 1e-10
) -> list[tuple[Scene, Float[Array, " 3"]]]:
    """Returns what `fit` finds for a problem, differentiable (implicit function theorem).

    For questions such as how the light moves with a pixel of the target, or with a sphere that
    was measured wrongly. At the solution the gradient of the cost is 0; differentiating that
    equation gives the solution's derivatives without those of the solver's steps. What the pictures
    do not determine, and what is at a bound, does not move.

    **Arguments:** `problem`: of a `Fit` (`found.problem`); every array of it may be differentiated
    or replaced (`equinox.tree_at(lambda p: p.targets[0].image, problem, image)`).

    **Returns:** for each picture its scene and exposure.

    **Raises:** an error at run time if the solver does not converge.
    """
    # functions without closures, which those that are checked at test time have
    primal, rewrite = lambda inputs: _solve(inputs), lambda *inputs: _optimality(*inputs)
    inputs = problem.without_stale_samples(), max_steps, rtol, atol
    values, _ = optx.internal.implicit_jvp(
        primal, rewrite, inputs, frozenset(), lx.SVD(rcond=_NULL)
    )
    return problem.scenes_at(values)


def _solve(inputs: tuple) -> tuple[PyTree, Bool[Array, " free"]]:
    """Returns the unknowns at the solution, and which of them are held at a bound."""
    problem, max_steps, rtol, atol = inputs
    solver = BoundedLevenbergMarquardt(rtol, atol, *problem.bounds())
    solved = optx.least_squares(
        compressed_residual, solver, problem.start(), problem, {"jac": "bwd"}, max_steps=max_steps
    )
    return solved.value, problem.at_bounds(solved.value)


def _optimality(values: PyTree, held: Bool[Array, " free"], inputs: tuple) -> Float[Array, " free"]:
    """Returns the gradient of the cost, 0 at the solution; of what is held how far it moved."""
    problem: Any = inputs[0]
    gradient = jax.grad(lambda v: jnp.sum(problem.residual(v) ** 2) / 2)(values)
    y, _ = ravel_pytree(values)
    return jnp.where(held, y - jax.lax.stop_gradient(y), ravel_pytree(gradient)[0])
