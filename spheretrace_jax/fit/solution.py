"""The solution of a fit as a pure function: under jit, and differentiable by what it depends on."""

from typing import Any

import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, PyTree

from ..scene.scene import Scene
from .problem.problem import Problem, compressed_residual
from .solver.levenberg_marquardt import BoundedLevenbergMarquardt

# Singular values of the Hessian, as parts of the largest, below which nothing is determined.
_HIDDEN = 1e-11


def solution(
    problem: Problem, *, max_steps: int = 100, rtol: float = 1e-10, atol: float = 1e-10
) -> list[tuple[Scene, Float[Array, " 3"]]]:
    """What `fit` finds for a problem, its derivatives by the implicit function theorem.

    For questions such as how the light moves with a pixel of the target, or with a sphere that
    was measured wrongly. At the solution the gradient of the cost is 0; differentiating that gives
    the solution's derivatives without those of the steps that led there. What the pictures do not
    determine, and what is at a bound, does not move.

    **Arguments:** `problem`: of a `Fit` (`found.problem`); every array of it may be differentiated
    or replaced (`equinox.tree_at(lambda p: p.targets[0].image, problem, image)`).

    **Returns:** for each picture its scene and exposure.

    **Raises:** an error at run time if the solver does not converge.
    """
    # functions without closures, which those that are checked at test time have
    primal, rewrite = lambda inputs: _solve(inputs), lambda *inputs: _pull(*inputs)
    inputs = problem, max_steps, rtol, atol
    values, _ = optx.internal.implicit_jvp(
        primal, rewrite, inputs, frozenset(), lx.SVD(rcond=_HIDDEN)
    )
    return problem.place(values)


def _solve(inputs: tuple) -> tuple[PyTree, Bool[Array, " free"]]:
    """The unknowns at the solution, and which of them are held at a bound."""
    problem, max_steps, rtol, atol = inputs
    solver = BoundedLevenbergMarquardt(rtol, atol, *problem.bounds())
    found = optx.least_squares(
        compressed_residual, solver, problem.start(), problem, {"jac": "bwd"}, max_steps=max_steps
    )
    return found.value, problem.at_bounds(found.value)


def _pull(values: PyTree, held: Bool[Array, " free"], inputs: tuple) -> Float[Array, " free"]:
    """The gradient of the cost, 0 at the solution; of what is held how far it moved."""
    problem: Any = inputs[0]
    gradient = jax.grad(lambda v: jnp.sum(problem.residual(v) ** 2) / 2)(values)
    y, _ = ravel_pytree(values)
    return jnp.where(held, y - jax.lax.stop_gradient(y), ravel_pytree(gradient)[0])
