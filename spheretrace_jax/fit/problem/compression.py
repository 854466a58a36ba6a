"""Compression of the residual: one number more than there are unknowns stand for all pixels.

With J^T J = R^T R the compressed residual is (R^-T J^T r, sqrt(r.r - |R^-T J^T r|^2)), and its
Jacobian (R, 0): solvers see the same cost, gradient and J^T J, and never the picture's J. Along
what the picture does not determine R is 0.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, PyTree

from ..normal_equations.normal_equations import NormalEquations
from .problem import Problem

# The part of a column of J, in rounding errors, that is nothing but rounding. A smaller one moves
# along what no picture shows, a larger one freezes what hardly shows.
_ROUNDING = 4


@jax.custom_jvp
def compressed_residual(values: PyTree, problem: Problem) -> Float[Array, " compressed"]:
    """Returns one number more than there are unknowns.

    The sum of their squares is twice the cost of all pixels, and the derivatives give the
    Gauss-Newton step of all.
    """
    return compress(problem.normal(values), problem.dtype)[0]


@compressed_residual.defjvp
def _compressed_jvp(primals, tangents):
    residual, jacobian = compress(primals[1].normal(primals[0]), primals[1].dtype)
    step, _ = ravel_pytree(tangents[0])
    return residual, jacobian @ step


def compress(
    normal: NormalEquations, dtype: np.dtype
) -> tuple[Float[Array, " compressed"], Float[Array, "compressed free"]]:
    """Returns the compressed residual and its Jacobian, in the dtype in which J was computed."""
    n = normal.gradient.size
    scale = jnp.sqrt(jnp.diag(normal.square))
    scale = jnp.where(scale > 0, scale, 1)
    values, vectors = jnp.linalg.eigh(normal.square / scale[:, None] / scale[None, :])
    # the rounding errors of J^T J, or the squares of those of J, if these are larger
    eps = lambda dtype: float(jnp.finfo(dtype).eps)
    rounding = max(eps(values.dtype), (_ROUNDING * eps(dtype)) ** 2)
    determined = values > n * rounding * jnp.max(values)
    root = jnp.sqrt(jnp.where(determined, values, 1))
    # the symmetric root: another would turn with every rounding, and seem to move
    factor = vectors @ (jnp.where(determined, root, 0)[:, None] * vectors.T) * scale[None, :]
    residual = vectors @ jnp.where(determined, vectors.T @ (normal.gradient / scale) / root, 0)
    rest = jnp.sqrt(jnp.maximum(2 * normal.cost - residual @ residual, 0))
    compressed = jnp.append(residual, rest), jnp.pad(factor, ((0, 1), (0, 0)))
    return compressed[0].astype(dtype), compressed[1].astype(dtype)
