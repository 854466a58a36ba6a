"""Fits in long, flat valleys: all come back to what the picture determines."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import three_apart as scene

import spheretrace_jax as st

SIZE = dict(width=64, height=64)
LIGHT = [900.0, -400, 700]
FAINT = [[1e-6, 2e-6, 1e-6], [0.2, 0.7, 0.4], [0.5, 0.5, 0.9]]
IN_FRONT = [[-90.0, 60, 0], [10, -10, 40], [110, -110, 180]]


def off(truth: st.Scene, exponent: bool) -> st.Scene:
    """All that is free is 10 % off, lights are turned by some degrees and a fifth too far."""
    s = truth.spheres
    turn = np.array([[0.995, -0.1, 0], [0.1, 0.995, 0], [0, 0, 1]])
    places = lambda x: (x.spheres.color, x.spheres.ka, x.spheres.kd, x.spheres.ks)
    wrong = [x * 0.9 for x in (s.color, s.ka, s.kd, s.ks)]
    start = eqx.tree_at(places, truth, wrong)
    start = eqx.tree_at(lambda x: x.lights.position, start, truth.lights.position @ turn * 1.2)
    if exponent:
        start = eqx.tree_at(lambda x: x.spheres.exponent, start, s.exponent * 1.3)
    return start


@pytest.mark.parametrize(
    ("truth", "exponent"),
    [
        pytest.param(scene(LIGHT, exponent=[1.0, 3, 2]), True, id="wide highlights"),
        pytest.param(scene(LIGHT, exponent=[1e4, 1e3, 300]), False, id="highlights of a pixel"),
        pytest.param(scene(LIGHT, color=FAINT), False, id="a colour near 0"),
        pytest.param(scene([1e7, -4e6, 7e6]), False, id="a light at 1e5 radii"),
        pytest.param(scene(LIGHT, [850.0, -480, 720]), False, id="lights 5 degrees apart"),
        pytest.param(scene([300.0, -300, 600], center=IN_FRONT), False, id="in shadow"),
    ],
)
def test_what_the_picture_determines_comes_back(truth, exponent):
    free = ("color", "ka", "kd", "ks", "light_position", *(["exponent"] * exponent))
    target = st.render(truth, bounces=0, **SIZE)
    found = st.fit(off(truth, exponent), target, free=free, bounces=0)
    assert found.converged and found.trust.ok and found.steps <= 40
    products = (
        lambda s: s.spheres.ka[:, None] * s.spheres.color,
        lambda s: s.spheres.kd[:, None] * s.spheres.color,
        lambda s: s.spheres.ks,
    )
    for product in products:
        known = found.uncertainty.of(product) < 1e-3
        assert known.mean() >= 0.6
        error = np.where(known, product(found.scene) - product(truth), 0)
        np.testing.assert_allclose(error, 0, atol=1e-8)
    # in direction and inverse distance, which is all that a picture tells of what is far
    for x, y in zip(found.scene.lights.position, truth.lights.position, strict=True):
        lengths = jnp.linalg.norm(x), jnp.linalg.norm(y)
        np.testing.assert_allclose(x / lengths[0], y / lengths[1], atol=1e-8)
        np.testing.assert_allclose(100 / lengths[0], 100 / lengths[1], atol=1e-8)
