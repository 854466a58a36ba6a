"""The search for lights: fits whose geometry and number of lights are known."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import three_apart as world

import spheretrace_jax as st
from spheretrace_jax.fit.model.products import determined_products
from spheretrace_jax.fit.problem.make_problem import make_problem
from spheretrace_jax.fit.solver.light_search import problem_starts

PLAIN = dict(bounces=0)
SIZE = dict(width=64, height=64)


def grey(truth: st.Scene) -> st.Scene:
    """Returns the geometry alone: all that is free is the same, all lights are at one place."""
    s = truth.spheres
    places = lambda x: (
        x.spheres.color, x.spheres.ka, x.spheres.kd, x.spheres.ks, x.lights.position,
    )  # fmt: skip
    light = jnp.broadcast_to(jnp.asarray([0.0, 0, 900]), truth.lights.position.shape)
    half = [jnp.full_like(x, 0.5) for x in (s.color, s.ka, s.kd, s.ks)]
    return eqx.tree_at(places, truth, (*half, light))


@pytest.mark.parametrize(
    "truth",
    [
        pytest.param(world([900.0, -400, 700]), id="one light"),
        pytest.param(world([-40000.0, 30000, 9000]), id="far and from the side"),
        pytest.param(
            world([600.0, -300, 1500], [-500, 400, 1200]), id="two lights", marks=pytest.mark.slow
        ),
        pytest.param(
            world([900.0, -400, 700], [-600, 100, 900]),
            id="in shadow of one another",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_start_from_nothing(truth):
    target = st.render(truth, **SIZE, **PLAIN)
    found = st.fit(grey(truth), target, start="auto", **PLAIN)
    assert found.converged and found.trust.ok
    a, b = determined_products(found.scene), determined_products(truth)
    for name in ("ka*color", "kd*color", "ks"):
        np.testing.assert_allclose(a[name], b[name], atol=1e-8)
    order = [np.linalg.norm(a["light_position"] - p, axis=1).argmin() for p in b["light_position"]]
    np.testing.assert_allclose(a["light_position"][order], b["light_position"], rtol=1e-6)


def test_start_from_lights():
    truth = world([900.0, -400, 700])
    target = st.render(truth, **SIZE, **PLAIN)
    plain, projected = (st.fit(grey(truth), target, start=s, **PLAIN) for s in ("scene", "lights"))
    assert plain.trust.ok and projected.trust.ok and projected.steps <= 3 < plain.steps
    for found in (plain, projected):
        at = found.scene.lights.position
        np.testing.assert_allclose(at, truth.lights.position, rtol=1e-8)


@pytest.mark.slow
def test_starts_of_separable_problems():
    target = np.full((8, 8, 3), 0.5)
    starts = lambda scene, free, bounces=0: list(
        problem_starts(make_problem(scene, target, free, bounces=bounces), "scene")
    )
    scene, free = world([900.0, -400, 700]), ("color", "light_position")
    mirrors = eqx.tree_at(lambda s: s.spheres.kgr, scene, jnp.full(3, 0.5))
    assert len(starts(scene, free)) == 2
    assert len(starts(mirrors, free, bounces=1)) == 1  # not linear in the colours
    assert len(starts(scene, ("color",))) == 1
    assert len(starts(scene, (*free, "radius"))) == 1


@pytest.mark.slow
def test_invisible_spheres_stay():
    away = eqx.tree_at(lambda s: s.spheres.center, world([9.0, 9, 9]), jnp.full((3, 3), 1e4))
    found = st.fit(away, np.full((8, 8, 3), 0.5), bounces=0, max_steps=20)
    assert eqx.tree_equal(found.scene.spheres, away.spheres) and not found.trust.ok


def test_fixed_parameters_are_used():
    truth = world([900.0, -400, 700])
    known = eqx.tree_at(lambda s: s.lights.position, truth, jnp.asarray([[0.0, 0, 900]]))
    target = st.render(truth, **SIZE, **PLAIN)
    found = st.fit(known, target, free=("light_position",), start="auto", **PLAIN)
    np.testing.assert_allclose(found.scene.lights.position, truth.lights.position, rtol=1e-8)
    assert eqx.tree_equal(found.scene.spheres, truth.spheres)


@pytest.mark.slow
def test_picture_of_another_scene():
    truth = world([900.0, -400, 700])
    other = eqx.tree_at(lambda s: s.spheres.center, truth, truth.spheres.center[::-1])
    target = st.render(other, **SIZE, **PLAIN)
    found = st.fit(grey(world([0.0, 0, 900])), target, start="auto", **PLAIN)
    assert not found.trust.ok
    assert "does NOT explain" in found.trust.verdict or "NOT converged" in found.trust.verdict


@pytest.mark.parametrize(
    ("scene", "settings", "message"),
    [
        (world([0.0, 0, 900]), dict(free=("radius",)), "a known geometry, got radius free"),
        (
            world(),
            dict(free=("color",)),
            "the scene has none",
        ),
    ],
)
@pytest.mark.filterwarnings("ignore:radius free")
def test_bad_starts(scene, settings, message):
    with pytest.raises(st.InputError, match=message):
        st.fit(scene, np.full((8, 8, 3), 0.5), **(dict(start="auto") | settings))
