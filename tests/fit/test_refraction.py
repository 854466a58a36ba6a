"""Fits of coats: indices of refraction are found, or found to be 1, and named where none shows."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import SCENES, three_apart

import spheretrace_jax as st
from spheretrace_jax.fit.model.parameters import Parameters
from spheretrace_jax.fit.model.target import make_target
from spheretrace_jax.fit.problem.make_problem import make_problem
from spheretrace_jax.fit.problem.problem import normal_at
from spheretrace_jax.fit.solver.variable_projection import sample_pixels
from spheretrace_jax.scene.settings import render_settings

SIZE = dict(width=32, height=32, bounces=0)
FREE = ("color", "kd", "ks", "exponent", "ior", "light_position")
LIGHT = [300.0, 350, 900]


def uncoated_start(truth: st.Scene) -> st.Scene:
    """Returns the scene to start from, which knows geometry and ka alone."""
    s = truth.spheres
    dtype = truth.dtype
    flat = lambda x, value: jnp.full_like(x, value)
    turned = truth.lights.position * jnp.asarray([[1.2, 0.8, 1]], dtype)
    return eqx.tree_at(
        lambda x: [*(getattr(x.spheres, n) for n in FREE[:-1]), x.lights.position],
        truth,
        [flat(s.color, 0.5), flat(s.kd, 0.5), flat(s.ks, 0.25), flat(s.exponent, 12),
         flat(s.ior, 1), turned],
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ior", "dtype", "tolerance"),
    [
        ([1.5, 1.35, 1.7], np.float64, 1e-9),
        (1.0, np.float64, 1e-9),
        ([1.5, 1.35, 1.7], np.float32, 1e-4),
    ],
)
def test_a_picture_says_which_coats_there_are(ior, dtype, tolerance):
    truth = three_apart(LIGHT, ior=ior).astype(dtype)
    found = st.fit(uncoated_start(truth), st.render(truth, **SIZE), free=FREE, bounces=0)
    assert found.trust.ok
    close = lambda a, b: np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance)
    s, t = found.scene.spheres, truth.spheres
    for name in ("ks", "exponent", "ior"):
        close(getattr(s, name), getattr(t, name))
    close(s.kd[:, None] * s.color, t.kd[:, None] * t.color)
    close(found.scene.lights.position, truth.lights.position)


@pytest.mark.slow
def test_where_no_coat_shows_it_is_said():
    # the first is matt black but for its highlight, the second has no coat
    truth = three_apart(LIGHT, kd=[0.0, 0.5, 0.4], ior=[1.5, 1.0, 1.3])
    found = st.fit(truth, st.render(truth, **SIZE), free=("ks", "ior"), bounces=0)
    said = str(found.identifiability)
    assert "sphere 1 has kd 0: ior not determined" in said
    deviations = found.uncertainty.standard_deviations["ior"]
    assert np.isinf(deviations[0]) and np.isfinite(deviations[2])
    np.testing.assert_allclose(found.scene.spheres.ior[1:], [1.0, 1.3], atol=1e-9)


def test_one_of_1_starts_as_paint_within_its_bounds():
    scene = three_apart(LIGHT, ior=[1.0, 1.2, 3.0])
    start = lambda p: np.asarray(p.natural(p.start())["ior"])
    np.testing.assert_allclose(start(Parameters(scene, ("ior",))), [1.5, 1.2, 2.5])
    target = st.render(scene, **SIZE)
    bounded = make_problem(scene, target, {"ior": [0, 1]}, bounces=0, limits={"ior": (1, 1.3)})
    np.testing.assert_allclose(start(bounded.parameters[0]), [1.3, 1.2, 3.0])
    for pair, words in (((0.5, 2), "at least 1"), ((1, 2.6), "at most 2.5")):
        with pytest.raises(st.InputError, match=f"bounds of ior must be {words}"):
            st.fit(scene, target, free=("ior",), bounds={"ior": pair})


def test_lights_are_searched_with_the_coats_of_the_start():
    scene = three_apart(LIGHT)
    target = make_target(np.asarray(st.render(scene, **SIZE)), scene.dtype)
    settings = render_settings(scene, 32, 32)
    for free, ior in ((("ior",), 1.5), ((), 1.0)):
        sample = sample_pixels(Parameters(scene, free), target, settings)
        np.testing.assert_array_equal(sample.scene.spheres.ior, ior)


@pytest.mark.slow
def test_normal_equations_are_the_differences_of_pictures():
    at = lambda s: s.spheres.ior
    scene = eqx.tree_at(at, SCENES["diffuse"], jnp.array([1.5, 1.2, 2.0]))
    target = np.random.default_rng(0).uniform(0.1, 0.9, (24, 24, 3))
    settings = dict(width=24, height=24, bounces=0)
    problem = make_problem(scene, target, ("ior",), bounces=0)
    found = normal_at(problem, problem.start())
    residual = lambda ior: np.ravel(
        st.render(eqx.tree_at(at, scene, jnp.asarray(ior)), **settings) - target
    )
    start, h = np.asarray(at(scene)), 1e-6
    step = lambda i: h * np.eye(3)[i]
    columns = [(residual(start + step(i)) - residual(start - step(i))) / (2 * h) for i in range(3)]
    jacobian = 1.5 * np.stack(columns, axis=1)  # unknowns are parts of the range of 1.5
    np.testing.assert_allclose(found.square, jacobian.T @ jacobian, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.gradient, jacobian.T @ residual(start), rtol=1e-6, atol=1e-8)
