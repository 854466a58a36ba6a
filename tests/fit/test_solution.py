"""`solution`: the result of a fit as a function, and its derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spheretrace_jax as st
from spheretrace_jax.fit.solution import solution

PLAIN = dict(bounces=0)
FREE = ("color", "ka", "kd", "light_position")
TRUTH = st.Scene(
    st.Spheres(
        [[0.0, 0, 0], [120, 60, 40]], [100.0, 60], [[0.8, 0.3, 0.2], [0.2, 0.6, 0.9]], 0.2, 0.6
    ),
    st.Lights([[200.0, 300, 800]]),
    st.Camera(mu=1200.0, distance=1200.0),
)
TARGET = st.render(TRUTH, width=24, height=24, **PLAIN)


@pytest.fixture(scope="module")
def problem():
    start = eqx.tree_at(lambda s: s.lights.position, TRUTH, TRUTH.lights.position + 50)
    return st.fit(start, TARGET, free=FREE, **PLAIN).problem


def test_equals_fit(problem):
    [(scene, exposure)] = eqx.filter_jit(solution)(problem)
    np.testing.assert_allclose(scene.lights.position, TRUTH.lights.position, rtol=1e-9)
    assert (exposure == 1).all()


@pytest.mark.slow
def test_derivative_by_target(problem):
    noise = 1e-2 * np.random.default_rng(0).standard_normal(TARGET.shape)

    def light(step):
        moved = eqx.tree_at(lambda p: p.targets[0].image, problem, TARGET + step * noise)
        return solution(moved)[0][0].lights.position[0]

    # where residuals are not 0, so that the Hessian is more than J^T J
    at, step = jnp.asarray(0.5), 1e-3
    value, slope = jax.jit(lambda x: jax.jvp(light, (x,), (jnp.ones_like(x),)))(at)
    again = jax.jit(light)
    np.testing.assert_allclose(slope, (again(at + step) - again(at - step)) / (2 * step), rtol=1e-5)
    backward = jax.jit(jax.grad(lambda x: light(x)[2]))(at)
    np.testing.assert_allclose(backward, slope[2], rtol=1e-9)
    assert np.linalg.norm(value - TRUTH.lights.position[0]) > 1


@pytest.mark.slow
def test_interval_coverage():
    start = eqx.tree_at(lambda s: s.lights.position, TRUTH, TRUTH.lights.position + 5)
    rng, free = np.random.default_rng(0), ("color", "kd", "light_position")
    places = lambda s: (s.spheres.color, s.spheres.kd, s.lights.position)
    inside = []
    for _ in range(1000):
        target = TARGET + 0.02 * rng.standard_normal(TARGET.shape)
        found = st.fit(start, target, free=free, **PLAIN)
        assert found.converged
        spread = found.uncertainty.standard_deviations
        for name, value, true in zip(free, places(found.scene), places(TRUTH), strict=True):
            inside.append(np.ravel(np.abs(value - true) <= 1.96 * spread[name]))
    covered = np.mean(np.concatenate(inside))
    print(f"covered: {covered:.3f}")
    assert 0.93 <= covered <= 0.97
