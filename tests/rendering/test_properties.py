"""Properties of every picture, tried on random scenes of one shape, which share a compilation."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as strategy

import spheretrace_jax as st

SPHERES, LIGHTS = 5, 2
SIZE = dict(width=16, height=12, bounces=2)
EVERYTHING = st.Needs(textures=False)

seeds = strategy.integers(0, 2**32 - 1)
several = settings(max_examples=25, deadline=None, derandomize=True)


def random_scene(seed: int, dtype=np.float64) -> st.Scene:
    """Makes overlapping spheres, also around the eye and lights, a checkered table, mirrors."""
    rng = np.random.default_rng(seed)
    unit = lambda *shape: rng.uniform(0, 1, shape)
    zero_or = lambda x: x * (rng.uniform(size=x.shape) > 0.4)
    n = SPHERES
    spheres = st.Spheres(
        rng.uniform(-200, 200, (n, 3)), 10 ** rng.uniform(0.5, 2.5, n), zero_or(unit(n, 3)),
        unit(n), unit(n), zero_or(unit(n)), zero_or(10 ** rng.uniform(-1, 3, n)),
        zero_or(unit(n)), zero_or(unit(n)),
    )  # fmt: skip
    table = st.Planes(
        rng.uniform(-300, 0, (1, 3)), rng.standard_normal((1, 3)), unit(1, 3), unit(1), unit(1),
        unit(1), 5.0, zero_or(unit(1)), unit(1, 3), zero_or(100 * unit(1)),
    )  # fmt: skip
    lights = st.Lights(rng.uniform(-900, 900, (LIGHTS, 3)), np.ones((LIGHTS, 3)))
    camera = st.Camera(*rng.uniform(-3, 3, 2), rng.uniform(0, 600), rng.uniform(200, 900))
    return st.Scene(spheres, lights, camera, table, background=unit(3)).astype(dtype)


@jax.jit
def draw(scene: st.Scene):
    return st.render(scene, needs=EVERYTHING, **SIZE)


@jax.jit
def gradient(scene: st.Scene, weights):
    return jax.grad(lambda s: jnp.sum(weights * st.render(s, needs=EVERYTHING, **SIZE)))(scene)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float32, pytest.param(np.float64, marks=pytest.mark.slow)])
@several
@given(seed=seeds)
def test_finite_pictures_and_gradients(dtype, seed):
    scene = random_scene(seed, dtype)
    picture = draw(scene)
    assert np.isfinite(picture).all() and (picture >= 0).all()
    for leaf in jax.tree.leaves(gradient(scene, jnp.ones_like(picture))):
        assert np.isfinite(leaf).all()


@several
@given(seed=seeds, which=strategy.integers(0, LIGHTS - 1))
def test_more_light_never_darkens(seed, which):
    scene = random_scene(seed)
    dimmed = eqx.tree_at(lambda s: s.lights.color, scene, scene.lights.color.at[which].set(0.0))
    assert (draw(scene) >= draw(dimmed) - 1e-12).all()


@several
@given(seed=seeds)
def test_order_of_spheres_does_not_matter(seed):
    scene = random_scene(seed)
    order = np.random.default_rng(seed).permutation(SPHERES)
    shuffled = jax.tree.map(lambda x: x[order], scene.spheres)
    other = eqx.tree_at(lambda s: s.spheres, scene, shuffled)
    np.testing.assert_allclose(draw(other), draw(scene), atol=1e-12)


@pytest.mark.parametrize("factor", [1e-6, 1e6])
@several
@given(seed=seeds)
def test_unit_of_length_does_not_matter(factor, seed):
    # in float32; the view plane's distance and window only set the angle of view
    scene = random_scene(seed, np.float32)
    lengths = lambda s: (
        s.spheres.center, s.spheres.radius, s.lights.position, s.camera.mu, s.planes.point,
        s.planes.checker_size,
    )  # fmt: skip
    scaled = eqx.tree_at(lengths, scene, tuple(jnp.float32(factor) * x for x in lengths(scene)))
    error = np.abs(draw(scaled) - draw(scene)).max(-1)
    # rounding may move an edge over a pixel's centre: at most 1 % of these coarse pictures' pixels
    assert np.sort(error.reshape(-1))[: int(0.99 * error.size)].max() < 2e-3
    assert np.median(error) < 2e-6
