"""`solution`: the result of a fit as a function, and its derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spheretrace_jax as st
from spheretrace_jax.fit.model.products import PRODUCTS

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


@pytest.mark.slow
def test_equals_fit(problem):
    [(scene, exposure)] = eqx.filter_jit(st.solution)(problem)
    np.testing.assert_allclose(scene.lights.position, TRUTH.lights.position, rtol=1e-9)
    assert (exposure == 1).all()


def _with_image(problem, image):
    return eqx.tree_at(lambda p: p.targets[0].image, problem, image)


@pytest.mark.parametrize(
    ("where", "value", "message"),
    [
        (lambda p: p.targets[0].image, TARGET[:8], r"targets\[0\].image .* got \(8, 24, 3\)"),
        (lambda p: p.targets[0].weight, TARGET[..., 0], r"targets\[0\].weight .* got \(24, 24\)"),
        (lambda p: p.targets[0].image, TARGET.astype(jnp.float32), "image must be float64, as"),
        (lambda p: p.targets[0].noise, None, r"targets\[0\].noise must be an array .* got None"),
        (lambda p: p.parameters[0].scene.spheres.ks, jnp.ones(3), r"spheres.ks must be .* \(2,\)"),
    ],
)
def test_changes_of_a_problem_are_checked(problem, where, value, message):
    with pytest.raises(st.InputError, match=message):
        st.solution(eqx.tree_at(where, problem, value))


@pytest.mark.slow
def test_many_fits_at_once(problem):
    """Several pictures, draws of noise and starts: equal to fits one by one, by vmap."""
    noise = 1e-2 * np.random.default_rng(1).standard_normal((3, *TARGET.shape))
    images = TARGET[None] + jnp.asarray(noise)
    light = lambda scenes: scenes.lights.position
    diffuse = PRODUCTS["kd*color"]  # a scale of color and kd is left to the gauge

    one = lambda image: st.solution(_with_image(problem, image))[0][0]
    many = jax.jit(jax.vmap(one))(images)
    for k, image in enumerate(images):
        found = st.fit(problem.parameters[0].scene, image, free=FREE, **PLAIN)
        np.testing.assert_allclose(light(many)[k], light(found.scene), rtol=1e-9)
        alone = jax.tree.map(lambda x, k=k: x[k], many)
        np.testing.assert_allclose(diffuse(alone), diffuse(found.scene), rtol=1e-8)

    def of_start(position):
        start = eqx.tree_at(lambda s: s.lights.position, TRUTH, position)
        return st.solution(problem.starting_at([start]))[0][0]

    starts = TRUTH.lights.position[None] + jnp.array([50.0, -40, 90])[:, None, None]
    found = jax.jit(jax.vmap(of_start))(starts)
    for position in light(found):
        np.testing.assert_allclose(position, light(TRUTH), rtol=1e-9)


@pytest.mark.slow
def test_solver_out_of_steps(problem):
    with pytest.raises(RuntimeError, match="did not converge in 1 steps") as caught:
        st.solution(problem, max_steps=1)
    assert "\n" not in str(caught.value)
    [(scene, _)] = st.solution(problem, max_steps=1, throw=False)
    before = problem.parameters[0].scene.lights.position
    assert 0 < np.abs(scene.lights.position - TRUTH.lights.position).max()
    assert np.abs(scene.lights.position - before).max() > 0
    with pytest.raises(RuntimeError, match="did not converge in 1 steps"):
        eqx.filter_jit(lambda p: st.solution(p, max_steps=1))(problem)


@pytest.mark.slow
def test_derivative_by_target(problem):
    noise = 1e-2 * np.random.default_rng(0).standard_normal(TARGET.shape)

    def light(step):
        moved = _with_image(problem, TARGET + step * noise)
        return st.solution(moved)[0][0].lights.position[0]

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
