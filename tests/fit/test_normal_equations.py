"""Normal equations, summed in one pass, against those of the dense Jacobian."""

import importlib

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import SCENES, nine_spheres, three_spheres
from jax.flatten_util import ravel_pytree

from spheretrace_jax.fit.normal_equations.pixel_buckets import bucket_pixels
from spheretrace_jax.fit.problem.compression import compressed_residual
from spheretrace_jax.fit.problem.make_problem import make_problem
from spheretrace_jax.tracing import context as context_module
from spheretrace_jax.tracing.context import build_context, build_tables as tables

SHADED = ("color", "ka", "kd", "ks", "light_position")
SOLID = ("color", "ka", "light_position", "center", "radius", "theta", "exposure")
SHADOWED = (100.0, 900, 300)

CASES = {"one ray": (nine_spheres(SHADOWED), SHADED, {}, {})}
UNCHECKED = eqx.tree_at(
    lambda s: s.planes.checker_size, SCENES["planes"], replace_fn=jnp.zeros_like
)
SLOW = {
    "all of the shading, a channel left out here and there": (
        SCENES["two_coloured_lights"],
        (*SHADED, "exponent", "kgr", "light_color"),
        {},
        dict(loss="cauchy", weights=np.random.default_rng(1).uniform(0, 2, (20, 24, 3))),
    ),
    "samples, exposure, weights and outliers": (
        SCENES["two_coloured_lights"],
        (*SHADED, "exponent", "light_color", "exposure"),
        dict(samples=2),
        dict(loss="cauchy", weights=np.random.default_rng(1).uniform(0, 2, (20, 24, 3))),
    ),
    "a plane without squares": (UNCHECKED, ("ks", "kd", "exponent", "light_position"), {}, {}),
    "bubbles and mirrors": (
        SCENES["glass"],
        ("color", "kgr", "kt", "light_color", "theta", "mu"),
        dict(bounces=2),
        {},
    ),
    "planes": (SCENES["planes"], ("ks", "light_position", "phi", "distance"), dict(bounces=1), {}),
    "textures and a sky": (SCENES["textures"], ("kd", "theta", "mu"), dict(bounces=1), {}),
    "covered edges": (nine_spheres(SHADOWED).with_antialias(1), SOLID, {}, dict(loss="huber")),
    "covered edges in mirrors": (
        SCENES["mirrors"].with_antialias(1),
        ("kgr", "light_position", "center"),
        dict(bounces=1),
        {},
    ),
}


def problem_of(scene, free, settings, counts):
    target = np.random.default_rng(0).uniform(0, 0.9, (20, 24, 3)).astype(scene.dtype)
    settings = dict(samples=1, bounces=0) | settings
    return make_problem(scene, target, free, **settings, **counts)


@eqx.filter_jit
def dense(problem, values):
    y, unravel = ravel_pytree(values)
    residual = lambda y: problem.residual(unravel(y))
    push = lambda e: jax.jvp(residual, (y,), (e,))[1]
    return residual(y), jax.vmap(push)(jnp.eye(y.size, dtype=y.dtype))


@eqx.filter_jit
def normal(problem, values):
    return problem.normal(values)


def check(case):
    problem = problem_of(*case)
    values = problem.start()
    found = normal(problem, values)
    residual, rows = (np.asarray(x) for x in dense(problem, values))
    lengths = np.linalg.norm(rows, axis=1)
    assert (lengths > 0).sum() > len(lengths) / 2
    unit = np.where(lengths > 0, 1 / np.where(lengths > 0, lengths, 1), 0)
    both = np.outer(unit, unit)
    np.testing.assert_allclose(found.square * both, rows @ rows.T * both, atol=1e-12)
    size = np.linalg.norm(residual)
    np.testing.assert_allclose(
        found.gradient * unit / size, rows @ residual * unit / size, atol=1e-13
    )
    np.testing.assert_allclose(found.cost, residual @ residual / 2, rtol=1e-13)
    # what no pixel depends on is exactly 0, and no rounding error
    np.testing.assert_array_equal(np.asarray(found.square)[lengths == 0], 0)


@pytest.mark.parametrize("name", CASES)
def test_dense_jacobian(name):
    check(CASES[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", SLOW)
def test_dense_jacobian_slow(name):
    check(SLOW[name])


def test_masked_pixels_are_skipped():
    mask = np.random.default_rng(0).uniform(size=(20, 24)) < 0.3
    scene = nine_spheres(SHADOWED)
    problem = problem_of(scene, SHADED, {}, dict(mask=mask))
    counts = problem.targets[0].counts
    context = build_context(scene, problem.settings[0], accelerated=False)
    buckets = bucket_pixels(context, problem.index(0), counts)
    visited = np.asarray(buckets.order)[: int(buckets.starts[-1])]
    np.testing.assert_array_equal(np.sort(visited), np.flatnonzero(mask))


@pytest.mark.slow
def test_context_is_built_once(monkeypatch):
    problem = problem_of(three_spheres(antialias=1), ("color", "radius"), {}, {})
    built = []
    count = lambda *arguments, **settings: built.append(1) or build_context(*arguments, **settings)
    module = importlib.import_module("spheretrace_jax.fit.normal_equations.normal_equations")
    monkeypatch.setattr(module, "build_context", count)
    monkeypatch.setattr(context_module, "build_tables", lambda s: built.append(1) or tables(s))
    jax.eval_shape(lambda p: p.normal(p.start()), problem)
    assert len(built) == 2  # one context, and in it the tables


def test_replaced_target():
    scene, mask = nine_spheres(SHADOWED), np.random.default_rng(0).uniform(size=(20, 24)) < 0.3
    whole = problem_of(scene, SHADED, {}, {})
    masked = problem_of(scene, SHADED, {}, dict(mask=mask))
    opened = eqx.tree_at(lambda p: p.targets, masked, whole.targets)
    for a, b in zip(*(jax.tree.leaves(normal(p, p.start())) for p in (opened, whole)), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.slow
def test_compressed_residual():
    problem = problem_of(*CASES["one ray"])
    values = problem.start()
    whole = normal(problem, values)
    y, unravel = ravel_pytree(values)
    f = lambda y: compressed_residual(unravel(y), problem)
    residual, jacobian = jax.jit(lambda y: (f(y), jax.jacrev(f)(y)))(y)
    assert residual.shape == (y.size + 1,)
    np.testing.assert_allclose(residual @ residual / 2, whole.cost, rtol=1e-13)
    scale = np.sqrt(np.diag(whole.square))
    scale = np.where(scale > 0, scale, 1)
    off = np.asarray(jacobian.T @ jacobian - whole.square) / np.outer(scale, scale)
    np.testing.assert_allclose(off, 0, atol=1e-12)
    off = np.asarray(jacobian.T @ residual - whole.gradient) / scale
    np.testing.assert_allclose(off, 0, atol=1e-12 * np.linalg.norm(residual))


def test_float32_sums():
    double, single = (
        problem_of(nine_spheres(SHADOWED, d), SHADED, {}, {}) for d in (np.float64, np.float32)
    )
    a, b = (normal(p, p.start()) for p in (double, single))
    assert b.pictures[0].dtype == jnp.float32 and b.square.dtype == jnp.float64
    scale = np.sqrt(np.maximum(np.diag(a.square), 1e-12))
    both = np.outer(scale, scale)
    # an exponent of 250 makes rounding errors of float32 that many times larger
    np.testing.assert_allclose(np.asarray(b.square) / both, a.square / both, atol=5e-5)
