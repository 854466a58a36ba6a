"""Pictures with directional lights and fall-off, against the plain path tracer and limits."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import SCENES, TABLE

import spheretrace_jax as st
from spheretrace_jax.acceleration import accelerator
from spheretrace_jax.tracing.plain import plain_picture

SIZE = dict(width=28, height=24)

ONE = st.Lights([[0.6, 0.7, 0.8]], directional=True)
MIXED = st.Lights(
    [[300.0, 350, 400], [-0.5, 0.2, 0.9], [60, -80, 150]],
    [[0.5, 0.4, 0.3], [0.3, 0.3, 0.4], [0.2, 0.3, 0.3]],
    directional=(False, True, False),
    falloff=(0, 0, 180),
)
MANY = st.Lights(
    np.random.default_rng(1).uniform(-1, 1, (6, 3)) * 300 + [[0, 0, 350]],
    np.full((6, 3), 0.2),
    directional=(True, False, True, True, False, False),
    falloff=(0, 300, 0, 0, 0, 500),
)
LIGHTS = {"one": ONE, "mixed": MIXED, "many": MANY}


def lit(name, lights, **changes):
    return eqx.tree_at(lambda s: s.lights, SCENES[name], lights)


CASES = [("shadows", "one"), ("planes", "mixed"), ("mirrors", "many"), ("inside", "mixed")]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "lights"), CASES)
def test_pictures_equal_the_plain_tracer_s(name, lights):
    scene = lit(name, LIGHTS[lights])
    found, expected = st.render(scene, **SIZE, bounces=2), plain_picture(scene, 28, 24, bounces=2)
    np.testing.assert_allclose(found, expected, atol=1e-11)
    dark = lit(name, eqx.tree_at(lambda x: x.color, LIGHTS[lights], replace_fn=jnp.zeros_like))
    assert np.abs(found - st.render(dark, **SIZE, bounces=2)).max() > 0.1


@pytest.mark.parametrize("lights", ["one", "mixed"])
def test_pictures_in_float32(lights):
    scene = lit("planes", LIGHTS[lights])
    found = np.asarray(st.render(scene.astype(np.float32), **SIZE, bounces=2))
    off = np.abs(found - np.asarray(plain_picture(scene, 28, 24, bounces=2)))
    assert found.dtype == np.float32
    assert np.quantile(off, 0.99) < 1e-4  # but for pixels that an edge runs through


@pytest.mark.parametrize("name", ["shadows", pytest.param("planes", marks=pytest.mark.slow)])
def test_covered_edges_are_near_many_rays(name):
    scene = lit(name, MIXED if name == "planes" else ONE)
    if name == "planes":  # checkers are single rays
        scene = eqx.tree_at(lambda s: s.planes, scene, TABLE)
        scene = eqx.tree_at(lambda s: s.spheres.kgr, scene, replace_fn=jnp.zeros_like)
    truth = np.asarray(plain_picture(scene, 28, 24, bounces=0, samples=8))
    error = lambda scene: np.sqrt(np.mean((st.render(scene, **SIZE, bounces=0) - truth) ** 2))
    assert error(scene.with_antialias(1)) < error(scene) / 3


@pytest.mark.slow
@pytest.mark.parametrize("antialias", [0, 1])
def test_a_directional_light_is_the_limit_of_a_point_that_moves_away(antialias):
    scene = lit("shadows", ONE).with_antialias(antialias)
    scene = eqx.tree_at(lambda s: s.planes, scene, TABLE)
    parallel = st.render(scene, **SIZE, bounces=0)
    off = []
    for sizes in (1e4, 1e6, 1e8):
        far = st.Lights(150 * sizes * ONE.position / jnp.linalg.norm(ONE.position))
        near = eqx.tree_at(lambda s, far=far: s.lights, scene, far)
        off.append(np.abs(st.render(near, **SIZE, bounces=0) - parallel).max())
    assert 0 < off[1] < 1e-5 and off[2] < 1e-7
    if antialias:  # without it a pixel's ray may fall on the other side of an edge
        np.testing.assert_allclose(off[1] / off[0], 1e-2, rtol=0.1)
    np.testing.assert_allclose(off[2] / off[1], 1e-2, rtol=0.1)


@pytest.mark.slow
def test_a_light_without_falloff_is_as_before():
    scene = SCENES["planes"]
    needs = st.needs(scene)
    without = st.render(scene, **SIZE, bounces=1)
    asked = st.render(scene, **SIZE, bounces=1, needs=dataclasses.replace(needs, falloff=True))
    np.testing.assert_allclose(asked, without, rtol=1e-14)


def test_falloff_scales_one_light():
    scene = lit("diffuse", st.Lights([[0.0, 0, 900]], falloff=900.0))
    scene = eqx.tree_at(lambda s: s.spheres.ka, scene, replace_fn=jnp.zeros_like)
    picture = lambda falloff: st.render(
        eqx.tree_at(lambda s: s.lights.falloff, scene, jnp.array([falloff])), **SIZE
    )
    np.testing.assert_allclose(picture(450.0), picture(900.0) / 4, rtol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("antialias", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_light_buffers_hold_all_occluders(antialias, monkeypatch):
    rng = np.random.default_rng(0)
    spheres = st.Spheres(rng.uniform(-100, 100, (160, 3)), rng.uniform(4, 12, 160), ks=0.2)
    lights = st.Lights(
        [[0.5, 0.3, 1], [200, 300, 500], [-1, 0.2, 0.4]], np.full((3, 3), 0.3), (True, False, True)
    )
    scene = st.Scene(spheres, lights, st.Camera(0.2, 0.8, 500.0, 600.0, 300.0), antialias=antialias)
    fast = st.render(scene, width=40, height=32, bounces=0)
    monkeypatch.setattr(accelerator, "MAX_BRUTE_FORCE", 1000)
    jax.clear_caches()
    slow = st.render(scene, width=40, height=32, bounces=0)
    jax.clear_caches()
    np.testing.assert_allclose(fast, slow, atol=1e-12)
    clear = dataclasses.replace(st.needs(scene), shadows=False)
    assert np.abs(slow - st.render(scene, width=40, height=32, bounces=0, needs=clear)).max() > 0.1


MOVES = {
    "direction": (lambda s: s.lights.position, [[0.0] * 3, [0.2, 0.3, -0.1], [0.0] * 3], 2e-5),
    "falloff": (lambda s: s.lights.falloff, [0.0, 0, 7.0], 1e-3),
    "position": (lambda s: s.lights.position, [[5.0, -9, 4], [0.0] * 3, [9.0, 5, -3]], 2e-5),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", MOVES)
@pytest.mark.parametrize("antialias", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_derivatives_equal_differences(name, antialias):
    at, step, h = MOVES[name]
    scene = lit("shadows", MIXED).with_antialias(antialias)
    scene = eqx.tree_at(lambda s: s.planes, scene, TABLE)
    needs = st.needs(scene, free=("light_position", "light_falloff"))
    picture = jax.jit(
        lambda x: st.render(eqx.tree_at(at, scene, x), **SIZE, bounces=0, needs=needs)
    )
    x, step = at(scene), jnp.asarray(step)
    derivative = jax.jvp(picture, (x,), (step,))[1]
    difference = (picture(x + h * step) - picture(x - h * step)) / (2 * h)
    off = np.abs(derivative - difference)
    # single rays jump where an edge passes them; covered edges are steep, as their step is finite
    assert np.quantile(off, 0.97) < 1e-6 * np.abs(derivative).max()
    assert np.abs(derivative).max() > 1e-3
    weights = jnp.asarray(np.cos(np.arange(derivative.size)).reshape(derivative.shape))
    pulled = jax.grad(lambda x: jnp.sum(weights * picture(x)))(x)
    np.testing.assert_allclose(jnp.vdot(pulled, step), jnp.vdot(weights, derivative), rtol=1e-9)


def test_a_light_at_its_own_surface_point_has_finite_derivatives():
    scene = lit("shadows", st.Lights([[0.0, 0, 0]], falloff=5.0))
    scene = eqx.tree_at(lambda s: s.lights.position, scene, scene.spheres.center[:1])
    gradient = jax.grad(lambda lights: jnp.sum(st.render(lit("shadows", lights), **SIZE)))
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(gradient(scene.lights)))
