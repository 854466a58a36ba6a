"""Normal equations from samples that are traced once, against pixels traced at every step."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import SCENES, nine_spheres, three_spheres

import spheretrace_jax as st
from spheretrace_jax.fit.normal_equations.cells import Cells
from spheretrace_jax.fit.problem.make_problem import make_problem
from spheretrace_jax.fit.problem.problem import normal_at

SHADOWED = (100.0, 900, 300)
SIZE = 24


def coated(scene: st.Scene) -> st.Scene:
    """Returns the scene with coats, other ones on each sphere."""
    at = lambda s: (s.spheres.ior, s.planes.ior)
    values = jnp.linspace(1.2, 1.8, len(scene.spheres)), jnp.full(len(scene.planes), 1.4)
    return eqx.tree_at(at, scene, values)


CASES = {
    "one ray": (nine_spheres(SHADOWED), ("color", "ka", "kd", "ks", "light_position"), {}),
    "four rays, mirrors": (
        nine_spheres(SHADOWED),
        ("color", "exponent", "kgr", "light_position", "light_color", "exposure"),
        dict(bounces=3, samples=2),
    ),
    "planes, checkers": (SCENES["planes"], ("ks", "kd", "light_position"), dict(bounces=2)),
    "textures, a sky": (SCENES["textures"], ("color", "kd"), dict(bounces=1)),
    "coats": (
        coated(SCENES["two_coloured_lights"]),
        ("color", "exponent", "ior", "light_position", "light_color"),
        {},
    ),
    "coats in mirrors": (coated(SCENES["planes"]), ("ior", "ks", "kgr"), dict(bounces=1)),
}
EDGES = {
    "covered edges": (nine_spheres(SHADOWED), ("color", "ks", "light_position"), {}),
    "covered edges in mirrors": (
        nine_spheres(SHADOWED),
        ("color", "kd", "exponent", "kgr", "light_position", "light_color", "exposure"),
        dict(bounces=3),
    ),
    "covered edges of coats": (
        coated(SCENES["two_coloured_lights"]),
        ("exponent", "ior", "light_position"),
        {},
    ),
    "covered edges of bubbles": (
        SCENES["glass"],
        ("color", "kgr", "kt", "light_color"),
        dict(bounces=2),
    ),
}


def check(scene, free, settings):
    target = np.random.default_rng(0).uniform(0.1, 0.9, (SIZE, SIZE, 3))
    settings = dict(bounces=0) | settings
    problem = make_problem(scene, target, free, **settings)
    values = problem.start()
    found = normal_at(problem, values)
    none = (None,) * len(problem.buffers)
    traced = eqx.tree_at(lambda p: p.buffers, problem, none, is_leaf=lambda x: x is None)
    expected = normal_at(traced, values)
    for name in ("square", "gradient", "cost"):
        a, b = (np.asarray(getattr(n, name)) for n in (found, expected))
        np.testing.assert_allclose(a, b, atol=1e-12 * np.abs(b).max())
    picture = st.render(scene, width=SIZE, height=SIZE, needs=problem.settings[0].needs, **settings)
    np.testing.assert_allclose(found.pictures[0], picture, atol=1e-12)
    np.testing.assert_allclose(expected.pictures[0], picture, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [n if n == "coats" else pytest.param(n, marks=pytest.mark.slow) for n in CASES]
)
def test_same_as_traced_pixels(name):
    check(*CASES[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", EDGES)
def test_same_as_traced_edges(name):
    scene, *others = EDGES[name]
    check(scene.with_antialias(1), *others)


@pytest.mark.slow
def test_light_that_moves_edges_of_shadows():
    truth = three_spheres(antialias=1)
    target = st.render(truth, width=40, height=40, bounces=0)
    moved = truth.lights.position * 1.1
    start = eqx.tree_at(lambda s: s.lights.position, truth, moved)
    found = st.fit(start, target, bounces=0)
    assert found.trust.ok and found.cost < 1e-16
    # the picture of the fit is the renderer's, the pixels with edges included
    needs = found.problem.settings[0].needs
    again = st.render(found.scene, width=40, height=40, bounces=0, needs=needs)
    np.testing.assert_allclose(found.normal.pictures[0], again, atol=1e-9)


def test_stale_samples_are_dropped():
    scene, free = nine_spheres(SHADOWED), ("color",)
    target = np.random.default_rng(0).uniform(0.1, 0.9, (SIZE, SIZE, 3))
    problem = make_problem(scene, target, free, bounces=0)
    kept = problem.without_stale_samples()
    assert eqx.tree_equal(kept.buffers, problem.buffers)
    center = lambda p: p.parameters[0].scene.spheres.center
    other = eqx.tree_at(center, problem, replace_fn=lambda c: c + 1).without_stale_samples()
    assert other.buffers[0] is None
    traced = jax.eval_shape(lambda p: p.without_stale_samples().buffers[0], problem)
    assert traced is None


def test_samples_after_weights_that_underflow_count():
    weight = np.array([[0.5, 0, 0], [0, 0.5, 0], [0, 0, 0], [0, 0, 0.5]])
    none = np.zeros(4, np.int32)
    cells = Cells(np.zeros((4, 3), np.int32), weight, none, None, none)
    np.testing.assert_array_equal(cells.samples, [1, 2, 0, 3])
