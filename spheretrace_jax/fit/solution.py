"""`solution`: what a fit finds, as a pure function that is differentiable under jit."""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, PyTree

from ..base.errors import InputError
from ..scene.arrays import check_shapes, is_traced, with_one_dtype
from ..scene.scene import Scene, check_scene
from .problem.compression import compressed_residual
from .problem.problem import Problem
from .solver.levenberg_marquardt import BoundedLevenbergMarquardt, tolerances

# Singular values of the Hessian, as parts of the largest, below which nothing is determined.
# Smaller ones are rounding errors in float64; a larger cutoff freezes what is weakly determined.
_NULL = 1e-11


def solution(
    problem: Problem,
    *,
    max_steps: int = 100,
    rtol: float | None = None,
    atol: float | None = None,
    throw: bool = True,
) -> list[tuple[Scene, Float[Array, " 3"]]]:
    """Returns what `fit` finds for a problem, differentiable (implicit function theorem).

    For questions such as how the light moves with a pixel of the target, or with a sphere that
    was measured wrongly. At the solution the gradient of the cost is 0; differentiating that
    equation gives the solution's derivatives without those of the solver's steps. What the pictures
    do not determine, and what is at a bound, does not move.

    Many fits at once, of several pictures, draws of noise or starts, are `jax.vmap` of a function
    that puts each into the problem; they take as many steps as the slowest. Each compiled function
    around `solution` compiles it once. Inside jit a problem that is closed over, not an argument,
    keeps the shading samples that were traced for its fixed geometry.

    **Arguments:**

    - `problem`: of a `Fit` (`found.problem`); every array of it may be differentiated or replaced
      (`equinox.tree_at(lambda p: p.targets[0].image, problem, image)`), and the start with it
      (`problem.starting_at([scene])`). What a fit leaves out of a target, clipped numbers and
      masked ones, are weights of 0 in `problem.targets[0].weight`, which stay as they are.
    - `max_steps`, `rtol`, `atol`: as for `fit`.
    - `throw`: False returns the best that is found where the solver does not converge, as some of
      many starts may; derivatives are then of no use.

    **Returns:** for each picture its scene and exposure, as `fit` with `gauge="none"`. In float32
    they are right to some 1e-3: products are summed in float32, where `fit` sums in float64.

    **Raises:** `InputError` for a problem whose arrays do not fit. `RuntimeError` if the solver
    does not converge; of many at once, if any does not. (Under jit an error of Equinox, which is
    short under `equinox.filter_jit`.)
    """
    problem = _checked(problem)
    rtol, atol = tolerances(problem.dtype, rtol, atol)
    # functions without closures, which those that are checked at test time have
    primal, rewrite = lambda inputs: _solve(inputs), lambda *inputs: _optimality(*inputs)
    inputs = problem.without_stale_samples(), max_steps, rtol, atol
    values, (_, converged) = optx.internal.implicit_jvp(
        primal, rewrite, inputs, frozenset(), lx.SVD(rcond=_NULL)
    )
    if throw:
        message = f"the fit did not converge in {max_steps} steps: allow more (max_steps)"
        if not is_traced(converged) and not converged:
            raise RuntimeError(message)
        values = eqx.error_if(values, ~converged, message)
    return problem.scenes_at(values)


def _checked(problem: Problem) -> Problem:
    """Checks a problem's arrays, which `equinox.tree_at` replaces without a check.

    **Raises:** `InputError` for shapes and dtypes other than the scene's and the picture's.
    """
    scenes, targets = [check_scene(p.scene) for p in problem.parameters], []
    for k, (target, settings) in enumerate(zip(problem.targets, problem.settings, strict=True)):
        shape = settings.height, settings.width, 3
        if np.shape(target.image) != shape:
            raise InputError(
                f"targets[{k}].image must be an array of shape {shape}, got "
                f"{np.shape(target.image)}"
            )
        arrays = check_shapes(f"targets[{k}].", target)
        targets.append(with_one_dtype(target, arrays | {"the scene": scenes[k].background}))
    places = lambda p: [*(q.scene for q in p.parameters), *p.targets]
    return eqx.tree_at(places, problem, [*scenes, *targets])


def _solve(inputs: tuple) -> tuple[PyTree, tuple[Bool[Array, " free"], Bool[Array, ""]]]:
    """Returns the unknowns at the solution, which are held at a bound, and if it converged."""
    problem, max_steps, rtol, atol = inputs
    solver = BoundedLevenbergMarquardt(rtol, atol, *problem.bounds())
    solved = optx.least_squares(
        compressed_residual, solver, problem.start(), problem, {"jac": "bwd"},
        max_steps=max_steps, throw=False,
    )  # fmt: skip
    converged = solved.result == optx.RESULTS.successful
    return solved.value, (problem.at_bounds(solved.value), converged)


def _optimality(values: PyTree, ended: tuple, inputs: tuple) -> Float[Array, " free"]:
    """Returns the gradient of the cost, 0 at the solution; of what is held how far it moved."""
    problem, (held, _) = inputs[0], ended
    gradient = jax.grad(lambda v: jnp.sum(problem.residual(v) ** 2) / 2)(values)
    y, _ = ravel_pytree(values)
    return jnp.where(held, y - jax.lax.stop_gradient(y), ravel_pytree(gradient)[0])
