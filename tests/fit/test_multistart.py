"""Fits from several starts: the limit of their steps, and how they are stopped."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from helpers.wrong_models import ambient_gradient, ball as wrong_ball, moved

import spheretrace_jax as st
from spheretrace_jax.fit.multistart import Found, _from_afar, _rank
from spheretrace_jax.fit.problem.make_problem import make_problem
from spheretrace_jax.fit.problem.problem import normal_at

SIZE = dict(width=40, height=40)
TRUTH = st.Scene(
    st.Spheres(
        [[-60.0, 0, 0], [70, 20, 10], [0, 60, 60]], [60.0, 50, 30], np.full((3, 3), 0.5),
        0.2, 0.6, 0.3, exponent=12.0,
    ),
    st.Lights([[200.0, 300, 500]]),
    st.Camera(theta=-1.2, phi=0.5),
)  # fmt: skip


def black(truth: st.Scene) -> st.Scene:
    """Returns the scene with color, ka and kd 0, where the cost has no slope by any of these."""
    places = lambda s: [s.spheres.color, s.spheres.ka, s.spheres.kd]
    return eqx.tree_at(places, truth, [jnp.zeros_like(x) for x in places(truth)])


@pytest.mark.slow
@pytest.mark.parametrize(
    "antialias", [0, pytest.param(1, marks=pytest.mark.slow, id="covered edges")]
)
def test_other_start_after_a_black_one(antialias):
    truth = TRUTH.with_antialias(antialias)
    target = st.render(truth, **SIZE)
    told = []
    found = st.fit(black(truth), target, callback=told.append)
    assert found.trust.ok and found.trust.unexplained < 1e-12
    np.testing.assert_allclose(found.scene.lights.position, truth.lights.position, rtol=1e-9)
    # all starts' steps are counted, and the least cost so far is told, of the scene that has it
    assert found.steps == len(told) == len(found.costs) <= told[0].max_steps
    assert [p.cost for p in told] == list(found.costs)
    # covered edges of shadows stay where the light was when they were traced: until then costs are
    # nearly those of the pictures, and when they are traced again the same scene's cost is another
    rises = np.diff(found.costs)[np.diff(found.costs) > 0]
    assert len(rises) <= antialias and all(rises < 1e-4 * found.costs[0])
    assert [p.step for p in told] == list(range(1, found.steps + 1))
    for p in told[:: len(told) // 4]:
        residual = np.asarray(st.render(p.scene, **SIZE) - target)
        rtol = 1e-3 if antialias else 1e-6
        np.testing.assert_allclose(0.5 * np.sum(residual**2), p.cost, rtol=rtol, atol=1e-20)


@pytest.mark.parametrize("start", ["scene", "lights", "auto"])
@pytest.mark.parametrize("max_steps", [0, 1, 2, 36, 60])
def test_limit_of_steps(start, max_steps):
    # the picture of another light, whose shadows and spheres the scene does not have
    other = eqx.tree_at(lambda s: s.spheres.center, TRUTH, TRUTH.spheres.center[::-1])
    target = st.render(other, **SIZE)
    told = []
    found = st.fit(black(TRUTH), target, start=start, max_steps=max_steps, callback=told.append)
    assert found.steps == len(told) == len(found.costs) <= max_steps
    assert not found.trust.ok and found.trust.unexplained <= 1
    assert np.isfinite(found.cost)
    if found.steps == max_steps:
        assert found.stopped_by == "max_steps" and "max_steps" in found.trust.verdict
    residual = np.asarray(st.render(found.scene, **SIZE) - target)
    np.testing.assert_allclose(0.5 * np.sum(residual**2), found.cost, rtol=1e-6, atol=1e-20)


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        dict(loss="huber"),
        dict(loss="cauchy", free=("color", "light_position")),
        dict(solver=optx.BFGS(rtol=1e-9, atol=1e-9)),
        pytest.param(dict(jacobian="dense"), marks=pytest.mark.slow),
    ],
)
def test_limit_of_other_fits(settings):
    noisy = np.asarray(st.render(TRUTH, **SIZE))
    noisy = noisy + 0.02 * np.random.default_rng(0).standard_cauchy(noisy.shape)
    start = eqx.tree_at(lambda s: s.spheres.color, TRUTH, jnp.full((3, 3), 0.3))
    found = st.fit(start, noisy, max_steps=9, **settings)
    assert found.steps == len(found.costs) <= 9
    again = st.fit(found.scene, noisy, max_steps=0, **settings)
    if "loss" not in settings:  # whose noise is estimated from other residuals
        np.testing.assert_allclose(again.cost, found.cost, rtol=1e-9)


@pytest.mark.slow
def test_too_few_steps_for_wide_pixels():
    """Checks that the cost is that of the pixels themselves, though only wider ones were fitted."""
    truth = TRUTH.with_antialias(1)
    size = dict(width=240, height=240, bounces=0)
    target = st.render(truth, **size)
    start = eqx.tree_at(lambda s: s.spheres.radius, truth, 1.1 * truth.spheres.radius)
    found = st.fit(start, target, free=("radius",), max_steps=1, bounces=0)
    assert found.steps == 1 and found.stopped_by == "max_steps"
    residual = np.asarray(st.render(found.scene, **size) - target)
    np.testing.assert_allclose(0.5 * np.sum(residual**2), found.cost, rtol=1e-6, atol=1e-20)


def stop_iteration(progress):
    if progress.step == 3:
        raise StopIteration


@pytest.mark.parametrize(
    "stop",
    [
        lambda p: p.step == 3,
        lambda p: np.bool_(p.step == 3),
        lambda p: jnp.asarray(p.step == 3),
        stop_iteration,
    ],
)
def test_callback_stops(stop):
    target = st.render(TRUTH, **SIZE)
    start = eqx.tree_at(lambda s: s.spheres.color, TRUTH, jnp.full((3, 3), 0.3))
    found = st.fit(start, target, callback=stop)
    assert found.steps == 3 and found.interrupted and found.stopped_by == "callback"
    assert not found.trust.ok
    assert found.trust.verdict.startswith("stopped by the callback: the best scene so far after 3")
    residual = np.asarray(st.render(found.scene, **SIZE) - target)
    np.testing.assert_allclose(0.5 * np.sum(residual**2), found.cost, rtol=1e-6, atol=1e-20)
    assert found.cost == min(found.costs)


def test_callback_that_returns_other_things():
    target = st.render(TRUTH, **SIZE)
    start = eqx.tree_at(lambda s: s.spheres.color, TRUTH, jnp.full((3, 3), 0.3))
    for answer in (None, False, 1, "go on", np.ones(3)):
        assert st.fit(start, target, callback=lambda p, a=answer: a).stopped_by is None


def test_callback_stops_a_later_start():
    """Checks that the best of all starts is kept, not the one that was tried last."""
    target = st.render(TRUTH, **SIZE)
    first = st.fit(black(TRUTH), target, callback=lambda p: p.damping < 1e-15)
    found = st.fit(black(TRUTH), target, callback=lambda p: p.step > first.steps + 3)
    assert found.stopped_by == "callback" and found.cost == min(found.costs) <= first.cost
    residual = np.asarray(st.render(found.scene, **SIZE) - target)
    np.testing.assert_allclose(0.5 * np.sum(residual**2), found.cost, rtol=1e-6, atol=1e-20)


def test_negative_limit():
    with pytest.raises(st.InputError, match="max_steps must be at least 0, got -1"):
        st.fit(TRUTH, np.full((4, 4, 3), 0.5), max_steps=-1)


@pytest.mark.slow
def test_robust_losses_begin_from_squares():
    """Checks that it is the sum of squares, by the same program, and that fits converge from it."""
    noisy = np.asarray(st.render(TRUTH, **SIZE))
    rng = np.random.default_rng(0)
    noisy = noisy + 0.01 * rng.standard_normal(noisy.shape)
    spoiled = rng.uniform(size=noisy.shape[:2]) < 0.05
    noisy[spoiled] = rng.uniform(size=(np.count_nonzero(spoiled), 3))
    problem = make_problem(TRUTH, noisy, ("color", "light_position"), bounces=5, loss="cauchy")
    plain = make_problem(TRUTH, noisy, ("color", "light_position"), bounces=5)
    values = problem.start()
    robust, square = (normal_at(p, values) for p in (problem.with_squares(), plain))
    np.testing.assert_allclose(robust.cost, square.cost, rtol=1e-12)
    np.testing.assert_allclose(robust.square, square.square, rtol=1e-9)
    start = eqx.tree_at(lambda s: s.lights.position, TRUTH, jnp.asarray([[-300.0, 100, 500]]))
    found = st.fit(start, noisy, free=("color", "light_position"), loss="cauchy")
    assert found.converged
    np.testing.assert_allclose(found.scene.lights.position, TRUTH.lights.position, rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("start", ["lights", "auto"])
def test_a_search_ends_no_worse_than_the_scene(start):
    """Of a picture that no start explains the nearest is kept, the scene's own among them."""
    light = (500.0, 400, 700)
    picture, ball = ambient_gradient(light), moved(wrong_ball(light))
    own, found = (st.fit(ball, picture, bounces=0, start=s) for s in ("scene", start))
    assert found.cost <= own.cost * (1 + 1e-6)
    assert found.converged and found.trust.grade != "exact"


@pytest.mark.slow
def test_lights_close_to_a_sphere_are_suspect():
    picture = ambient_gradient((500.0, 400, 700))
    start = wrong_ball([110.0, 0, 20])  # at 1.1 radii
    problem = make_problem(start, picture, ("color", "light_position"), bounces=0)
    near = Found(problem, problem.start(), 1.0, optx.RESULTS.successful)
    far = near._replace(problem=problem.starting_at([wrong_ball([500.0, 400, 700])]))
    far = far._replace(values=far.problem.start())
    assert _rank(far._replace(cost=1.1)) < _rank(near) < _rank(far._replace(cost=1.5))
    away = _from_afar(near)
    light = np.asarray(away.parameters[0].scene.lights.position[0])
    np.testing.assert_allclose(light / np.linalg.norm(light), np.array([11, 0, 2]) / np.sqrt(125))
    assert np.linalg.norm(light) > 300
    # lights that are held are not
    held = make_problem(start, picture, ("color",), bounces=0)
    known = Found(held, held.start(), 1.0, optx.RESULTS.successful)
    assert _rank(known) == 1
