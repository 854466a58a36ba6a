"""Fits of one light to the pixels of a ball: variable projection, many fits at once.

For a known light and material each channel is linear in its three amplitudes, which are at least
0. They are eliminated (Golub and Pereyra; Kaufman's Jacobian), and Levenberg-Marquardt finds the
six other unknowns.
"""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int

from ..fit.normal_equations.normal_equations import NormalEquations
from ..fit.problem.compression import compress
from ..fit.solver.levenberg_marquardt import BoundedLevenbergMarquardt
from ..xla.jit import compiled
from .ball_radiance import (
    BallSamples,
    LightModel,
    light_direction,
    radiance_terms,
    residual_weights,
)

#: Fits that are solved at once, and samples of a ball: always as many, for one compilation.
LANES, SAMPLES = 6, 2048

# Most steps; most fits take 10 to 25.
_STEPS = 30

# Relative tolerances of unknowns and residuals: a light turns by less than 0.005 degrees.
_RTOL, _ATOL = 1e-4, 1e-5

# Part of a term's square that is added to it: terms that are alike, as a very broad highlight is
# like the ambient light, are then both as small as possible.
_RIDGE = 1e-6

# All choices of terms with an amplitude above 0.
_CHOICES = np.array(list(itertools.product([0, 1], repeat=3)))


class LightFit(eqx.Module):
    """A light that was found, and how the ball looks; with an axis in front for several fits."""

    unknowns: Float[Array | np.ndarray, " 6"]
    model: LightModel
    #: rows: red, green, blue; columns: diffuse, highlight, ambient
    amplitudes: Float[Array | np.ndarray, "3 3"]
    cost: Float[Array | np.ndarray, ""]  #: half the sum of the squared weighted residuals
    direction: Float[Array | np.ndarray, " 3"]  #: unit vector to the light, in the camera's frame
    steps: Int[Array | np.ndarray, ""]


class WeightedRows(eqx.Module):
    """Residuals and Jacobian of a fit, divided by the residuals' size."""

    residual: Float[Array, "3 samples"]
    columns: Float[Array, "6 3 samples"]  #: by the unknowns
    terms: Float[Array, "3 3 samples"]  #: channel, term: by the channel's amplitudes
    amplitudes: Float[Array, "3 3"]
    gram: Float[Array, "3 3 3"]  #: products of the terms, per channel

    @property
    def weights(self) -> Float[np.ndarray, "3 samples"]:
        """Returns what residuals and terms are multiplied by: the ambient term is 1."""
        return np.asarray(self.terms, float)[:, 2]


@compiled
def solve_lights(
    samples: BallSamples,
    models: LightModel,
    start: Float[Array | np.ndarray, "lanes 6"],
    lower: Float[Array | np.ndarray, "lanes 6"],
    upper: Float[Array | np.ndarray, "lanes 6"],
) -> LightFit:
    """Fits lights by several models, or from several starts, to the same samples.

    **Arguments:** `models`: with an axis of lanes in front. `lower`, `upper`: bounds; equal ones
    hold an unknown.
    """

    def solve_one(model, start, lower, upper):
        solver = BoundedLevenbergMarquardt(_RTOL, _ATOL, lower, upper)
        args = samples, model
        found = optx.least_squares(
            _compressed, solver, start, args=args, has_aux=True, max_steps=_STEPS, throw=False
        )
        amplitudes, cost = found.aux
        direction = light_direction(found.value, model)
        steps = found.stats["num_steps"]
        return LightFit(found.value, model, amplitudes, cost, direction, steps)

    return jax.vmap(solve_one)(models, start, lower, upper)


@compiled
def rows_at(fit: LightFit, samples: BallSamples) -> WeightedRows:
    """Returns residuals and Jacobian of one fit at other samples, say, or at its own."""
    return _rows(jnp.asarray(fit.unknowns), samples, fit.model)


def _rows(unknowns: Float[Array, " 6"], samples: BallSamples, model: LightModel) -> WeightedRows:
    weights = residual_weights(samples, model)
    terms_at = lambda unknowns: radiance_terms(unknowns, samples, model)
    terms, push = jax.linearize(terms_at, unknowns)
    weighted = terms[None] * weights[:, None]
    values = samples.values * weights
    gram = jnp.einsum("ckp,clp->ckl", weighted, weighted)
    amplitudes = jax.vmap(_amplitudes)(gram, jnp.einsum("ckp,cp->ck", weighted, values))
    residual = jnp.einsum("ck,ckp->cp", amplitudes, weighted) - values
    slopes = jax.vmap(push)(jnp.eye(unknowns.size, dtype=unknowns.dtype))
    columns = jnp.einsum("ck,ikp->icp", amplitudes, slopes) * weights[None]
    return WeightedRows(residual, columns, weighted, amplitudes, gram)


def _amplitudes(gram: Float[Array, "3 3"], right: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """Solves for amplitudes of at least 0: the best of all choices of terms (least squares)."""
    size = jnp.sqrt(jnp.diag(gram))
    size = jnp.where(size > 0, size, 1)
    gram = gram / size[:, None] / size[None] + _RIDGE * jnp.eye(3, dtype=gram.dtype)
    right = right / size
    chosen = jnp.asarray(_CHOICES, gram.dtype)
    left_out = jax.vmap(jnp.diag)(1 - chosen)
    matrices = gram[None] * chosen[:, :, None] * chosen[:, None, :] + left_out
    found = _solve_three(matrices, (chosen * right[None])[..., None])[..., 0] * chosen
    cost = jnp.einsum("si,ij,sj->s", found, gram, found) - 2 * found @ right
    allowed = jnp.all(found >= 0, axis=1)
    return found[jnp.argmin(jnp.where(allowed, cost, jnp.inf))] / size


def _solve_three(
    matrix: Float[Array, "*batch 3 3"], right: Float[Array, "*batch 3 columns"]
) -> Float[Array, "*batch 3 columns"]:
    """Solves three equations by Cholesky's decomposition, written out: no calls to LAPACK."""
    a = lambda i, j: matrix[..., i, j]
    root = lambda x: jnp.sqrt(jnp.maximum(x, _RIDGE / 4))
    d0 = root(a(0, 0))
    l10, l20 = a(1, 0) / d0, a(2, 0) / d0
    d1 = root(a(1, 1) - l10 * l10)
    l21 = (a(2, 1) - l20 * l10) / d1
    d2 = root(a(2, 2) - l20 * l20 - l21 * l21)
    d0, d1, d2, l10, l20, l21 = (x[..., None] for x in (d0, d1, d2, l10, l20, l21))
    b0, b1, b2 = (right[..., i, :] for i in range(3))
    y0 = b0 / d0
    y1 = (b1 - l10 * y0) / d1
    y2 = (b2 - l20 * y0 - l21 * y1) / d2
    x2 = y2 / d2
    x1 = (y1 - l21 * x2) / d1
    x0 = (y0 - l10 * x1 - l20 * x2) / d0
    return jnp.stack([x0, x1, x2], axis=-2)


Compressed = tuple[Float[Array, " 7"], tuple[Float[Array, "3 3"], Float[Array, ""]]]


@jax.custom_jvp
def _compressed(unknowns: Float[Array, " 6"], args: tuple[BallSamples, LightModel]) -> Compressed:
    """Returns seven numbers with the cost, gradient and J^T J of all residuals.

    And, beside them and without derivatives, the amplitudes and the cost.
    """
    normal, amplitudes = _normal(unknowns, *args)
    return compress(normal, np.dtype(unknowns.dtype))[0], (amplitudes, normal.cost)


@_compressed.defjvp
def _compressed_jvp(primals, tangents):
    normal, amplitudes = _normal(primals[0], *primals[1])
    residual, jacobian = compress(normal, np.dtype(primals[0].dtype))
    still = jnp.zeros_like(amplitudes), jnp.zeros_like(normal.cost)
    return (residual, (amplitudes, normal.cost)), (jacobian @ tangents[0], still)


def _normal(
    unknowns: Float[Array, " 6"], samples: BallSamples, model: LightModel
) -> tuple[NormalEquations, Float[Array, "3 3"]]:
    """Returns the normal equations of the six unknowns without the amplitudes, and these.

    The Schur complement of the amplitudes' columns: Kaufman, "A Variable Projection Method for
    Solving Separable Nonlinear Least Squares Problems", BIT 15 (1975).
    """
    rows = _rows(unknowns, samples, model)
    present = (rows.amplitudes > 0).astype(unknowns.dtype)
    mixed = jnp.einsum("icp,ckp->ick", rows.columns, rows.terms) * present[None]
    absent = jax.vmap(jnp.diag)(1 - present)
    gram = rows.gram * present[:, :, None] * present[:, None, :] + absent
    size = jnp.sqrt(jax.vmap(jnp.diag)(gram))
    gram = gram / size[:, :, None] / size[:, None, :] + _RIDGE * jnp.eye(3, dtype=gram.dtype)[None]
    mixed = mixed / size[None]
    solved = _solve_three(gram, jnp.moveaxis(mixed, 0, -1))
    flat = rows.columns.reshape(unknowns.size, -1)
    square = flat @ flat.T - jnp.einsum("ick,ckj->ij", mixed, solved)
    gradient, cost = flat @ rows.residual.reshape(-1), jnp.sum(rows.residual**2) / 2
    return NormalEquations(square, gradient, cost), rows.amplitudes
