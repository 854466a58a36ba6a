"""Fits of directional lights and of lights whose distance does not show."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import SCENES, TABLE

import spheretrace_jax as st
from spheretrace_jax.display.parameter_rows import parameter_rows
from spheretrace_jax.fit.diagnosis.uncertainty import estimate
from spheretrace_jax.fit.model.accessors import default_free
from spheretrace_jax.fit.model.constraints import make_constraints
from spheretrace_jax.fit.model.light_position import LightPosition, light_direction_at
from spheretrace_jax.fit.model.parameters import Parameters
from spheretrace_jax.fit.problem.make_problem import make_problem
from spheretrace_jax.fit.problem.problem import normal_at
from spheretrace_jax.scene.values import with_values

SIZE = 24
SPHERES = st.Spheres(
    [[0.0, 0, 0], [70, 40, 60], [-80, 30, 10]],
    [50.0, 25, 30],
    color=[[0.8, 0.3, 0.2], [0.2, 0.7, 0.4], [0.5, 0.5, 0.9]],
    ks=0.3,
    exponent=8.0,
)
CAMERA = st.Camera(0.3, 0.4, 500.0, 400.0, window=200.0)
MIXED = st.Lights(
    [[300.0, 200, 500], [3, 2, -1], [-200, 100, 300]],
    [[0.5, 0.4, 0.4], [0.3, 0.3, 0.3], [0.2, 0.3, 0.2]],
    directional=(False, True, False),
    falloff=(600.0, 0, 0),
)
BOTH = ("light_position", "light_direction")


def scene(*place, **kinds) -> st.Scene:
    return st.Scene(SPHERES, st.Lights([list(map(float, place))], **kinds), CAMERA)


def mixed(antialias=0) -> st.Scene:
    return st.Scene(SPHERES, MIXED, CAMERA, antialias=antialias)


def angle(a, b) -> float:
    a, b = (np.asarray(x, np.float64) / np.linalg.norm(x) for x in (a, b))
    return float(np.degrees(np.linalg.norm(a - b)))


@pytest.mark.parametrize("length", [1e-20, 1.0, 1e20])
def test_two_numbers_turn_a_direction(length):
    start = length * jnp.array([1.0, -2, 2])
    light = light_direction_at(start)
    np.testing.assert_allclose(light.direction(jnp.zeros(2)), start, rtol=1e-15)
    turned = light.direction(jnp.array([np.tan(0.3), 0.0]))
    np.testing.assert_allclose(angle(turned, start), np.degrees(2 * np.sin(0.15)), rtol=1e-12)
    np.testing.assert_allclose(jnp.linalg.norm(turned / length), 3, rtol=1e-14)
    jacobian = jax.jacobian(light.direction)(jnp.zeros(2)) / length
    np.testing.assert_allclose(jacobian.T @ jacobian, 9 * np.eye(2), atol=1e-13)
    assert isinstance(light, LightPosition) and light.w == 0


def test_values_of_one_kind_leave_the_other():
    new = jnp.arange(9.0).reshape(3, 3)
    moved = with_values(mixed(), {"light_position": new}).lights.position
    np.testing.assert_array_equal(moved, [new[0], MIXED.position[1], new[2]])
    turned = with_values(mixed(), {"light_direction": new}).lights.position
    np.testing.assert_array_equal(turned, [MIXED.position[0], new[1], MIXED.position[2]])


def test_unknowns_of_both_kinds():
    start = mixed()
    assert default_free(start) == ("color", "ka", "kd", "ks", *BOTH)
    parameters = Parameters(start, BOTH, make_constraints(start, BOTH, {}, {}, {}))
    unknowns = parameters.start()
    assert {name: x.shape for name, x in unknowns.items()} == {BOTH[0]: (6,), BOTH[1]: (2,)}
    moved = {
        "light_position": unknowns["light_position"] + 0.01,
        "light_direction": jnp.array([0.1, 0]),
    }
    found, _ = parameters.scene_at(moved)
    changed = np.abs(found.lights.position - start.lights.position).max(axis=1)
    assert (changed > 1e-3).all()
    np.testing.assert_allclose(
        np.linalg.norm(found.lights.position[1]), np.linalg.norm(MIXED.position[1]), rtol=1e-14
    )
    alone = Parameters(start, BOTH[1:], make_constraints(start, BOTH[1:], {}, {}, {}))
    turned, _ = alone.scene_at({"light_direction": moved["light_direction"]})
    np.testing.assert_array_equal(turned.lights.position[0], MIXED.position[0])


SOME = np.array([[False] * 3, [True, False, True], [False] * 3])
REFUSED = [
    ("far", dict(free="light_position"), "light_position is free, but all lights are directional"),
    ("near", dict(free="light_direction"), "light_direction is free, but no light is directional"),
    ("mixed", dict(free={"light_position": [0, 1]}), "names light 2, which is directional"),
    ("mixed", dict(free={"light_direction": [0]}), "names light 1, which is not directional"),
    ("mixed", dict(free=BOTH, bounds={BOTH[1]: (0, 1)}), "bounds of light_direction"),
    ("mixed", dict(free=BOTH, priors={BOTH[1]: (0, 1)}, noise=1), "priors of light_direction"),
    ("mixed", dict(free={BOTH[1]: SOME}), "a light's direction is free or held as a whole"),
]


@pytest.mark.parametrize(("lights", "arguments", "message"), REFUSED)
def test_what_fits_nothing_is_refused(lights, arguments, message):
    start = {
        "far": scene(0, 0, 1, directional=True),
        "near": scene(0, 0, 900),
        "mixed": mixed(),
    }[lights]
    with pytest.raises(st.InputError, match=message) as error:
        st.fit(start, np.full((8, 8, 3), 0.5), **arguments)
    assert "\n" not in str(error.value)


def test_pictures_must_agree_on_what_is_directional():
    other = st.Lights(MIXED.position, MIXED.color, directional=(True, False, False))
    scenes = mixed(), eqx.tree_at(lambda s: s.lights, mixed(), other)
    with pytest.raises(st.InputError, match="scene 2 has other directional lights than the first"):
        make_problem(scenes, np.full((2, 4, 4, 3), 0.5), ("kd", *BOTH), bounces=0)


MANY = st.Lights(
    np.concatenate([MIXED.position, np.asarray(MIXED.position) * [[1, -1, 1]]]),
    np.concatenate([MIXED.color, MIXED.color]) / 2.0,
    MIXED.directional * 2,
    np.concatenate([MIXED.falloff, MIXED.falloff]),
)
CASES = {
    "one ray": (mixed(), ("color", "ks", "exponent", *BOTH)),
    "covered edges": (mixed(1), ("kd", "light_color", *BOTH)),
    "many lights, a plane": (st.Scene(SPHERES, MANY, CAMERA, TABLE), ("ks", *BOTH)),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["one ray", *(pytest.param(name, marks=pytest.mark.slow) for name in list(CASES)[1:])]
)
def test_shading_equations_equal_those_of_pixels(name):
    start, free = CASES[name]
    target = np.random.default_rng(0).uniform(0.1, 0.9, (SIZE, SIZE, 3))
    problem = make_problem(start, target, free, bounces=0)
    values = problem.start()
    found = normal_at(problem, values)
    traced = eqx.tree_at(lambda p: p.buffers, problem, (None,), is_leaf=lambda x: x is None)
    expected = normal_at(traced, values)
    for each in ("square", "gradient", "cost"):
        a, b = (np.asarray(getattr(n, each)) for n in (found, expected))
        np.testing.assert_allclose(a, b, atol=1e-12 * np.abs(b).max())
    assert (np.diag(found.square) > 0).all()


def fitted(truth, start, noise=0.0, dtype=np.float64, **settings) -> st.Fit:
    target = np.asarray(st.render(truth, width=SIZE, height=SIZE, bounces=0))
    target = target + noise * np.random.default_rng(0).standard_normal(target.shape)
    return st.fit(start.astype(dtype), target.astype(dtype), bounces=0, **settings)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float64, pytest.param(np.float32, marks=pytest.mark.slow)])
def test_a_direction_is_found(dtype):
    truth, start = scene(3, 2, 5, directional=True), scene(10, 25, 60, directional=True)
    found = fitted(truth, start, dtype=dtype)
    assert found.trust.ok and "light_direction" in found.problem.parameters[0].free
    limit = 1e-8 if dtype == np.float64 else 2e-2
    assert angle(found.scene.lights.position[0], [3, 2, 5]) < limit
    length = np.linalg.norm(found.scene.lights.position[0])
    np.testing.assert_allclose(length, np.linalg.norm([10, 25, 60]), rtol=1e-6)
    assert found.uncertainty.light_distance(0).infinite
    deviations = found.uncertainty.standard_deviations["light_direction"]
    assert deviations.shape == (1, 3) and np.isfinite(deviations).all()


@pytest.mark.slow
@pytest.mark.parametrize("start", ["lights", "auto"])
def test_a_direction_is_found_by_the_search(start):
    truth = scene(3, 2, 5, directional=True)
    found = fitted(truth, scene(-9, 5, 1, directional=True), start=start)
    assert found.trust.ok and angle(found.scene.lights.position[0], [3, 2, 5]) < 1e-8


@pytest.mark.slow
def test_the_search_finds_lights_of_both_kinds():
    truth = mixed()
    places = jnp.array([[100.0, 300, 500], [3, -2, 2], [-300, -100, 300]])
    start = eqx.tree_at(lambda s: s.lights.position, truth, places)
    found = fitted(truth, start, start="auto")
    assert found.trust.ok
    for k in range(3):
        assert angle(found.scene.lights.position[k], MIXED.position[k]) < 1e-6


@pytest.mark.slow
def test_a_far_light_is_at_infinity():
    truth = scene(2e5, 1e5, 3e5)
    distance = np.linalg.norm(truth.lights.position[0])
    found = fitted(truth, scene(200, 150, 300), noise=0.003)
    known = found.uncertainty.light_distance(0)
    assert known.infinite and known.most == np.inf
    middle = np.mean(SPHERES.center, axis=0)
    assert 500 < known.least < distance - np.linalg.norm(middle)
    assert angle(found.scene.lights.position[0], truth.lights.position[0]) < 1
    sentence = (
        f"light 1 is at infinity: its distance does not show, but is at least {known.least:.3g}"
    )
    for text in (str(found), str(found.trust)):
        assert sentence in text and "directional light, the simpler model" in text
    (row,) = [row for row in parameter_rows(found) if row.name == "light_position"]
    assert row.after.startswith(f"at infinity (at least {known.least:.3g}, 95 %), toward 0.")
    assert row.spread.endswith("degrees")


@pytest.mark.slow
def test_a_near_light_has_a_distance():
    truth = scene(200, 100, 300)
    found = fitted(truth, scene(220, 130, 280), noise=0.003)
    known = found.uncertainty.light_distance(0)
    assert not known.infinite and known.least < known.value < known.most < 1.5 * known.value
    assert "infinity" not in str(found)


def test_the_limits_of_a_distance_are_quantiles():
    """The least distance is the inverse of the 95 % quantile of 1/distance, cut off at 0."""
    found = fitted(scene(2e3, 1e3, 3e3), scene(220, 130, 280), noise=0.01)
    known = found.uncertainty.light_distance(0)
    _, relative = found.uncertainty.of_light(0, 0)
    inverse = (1 + relative * np.random.default_rng(0).standard_normal(400_000)) / known.value
    inverse = inverse[inverse > 0]
    np.testing.assert_allclose(known.least, 1 / np.quantile(inverse, 0.95), rtol=1e-2)
    with pytest.raises(st.InputError, match="light must be in 0"):
        found.uncertainty.light_distance(1)


def test_held_lights_have_their_distance():
    truth = scene(200, 100, 300)
    problem = make_problem(truth, st.render(truth, width=8, height=8), ("kd",), bounces=0)
    values = problem.start()
    known = estimate(problem, values, normal_at(problem, values), 0.1).light_distance(0)
    assert known.least == known.value == known.most


@pytest.mark.slow
def test_two_lights_of_one_direction():
    lights = st.Lights(
        [[1.0, 2, 3], [2, 4, 6], [1, 2, 3]], np.full((3, 3), 0.3), directional=(True, True, False)
    )
    truth = st.Scene(SPHERES, lights, CAMERA)
    target = st.render(truth, width=SIZE, height=SIZE, bounces=0)
    problem = make_problem(truth, target, ("light_color", *BOTH), bounces=0)
    values = problem.start()
    found = estimate(problem, values, normal_at(problem, values), 1e-3)
    assert any("lights 1 and 2 have one direction: how they part" in r for r in found.reasons)
    assert not any("one place" in r for r in found.reasons)


@pytest.mark.slow
def test_several_pictures_with_directions_of_their_own():
    truths = [scene(3, 2, 5, directional=True), scene(-3, 1, 4, directional=True)]
    starts = [scene(2, 3, 5, directional=True), scene(-2, 2, 4, directional=True)]
    targets = [st.render(t, width=SIZE, height=SIZE, bounces=0) for t in truths]
    found = st.fit(starts, targets, own=("light_direction",), bounces=0)
    assert found.trust.ok
    for one, truth in zip(found.scenes, truths, strict=True):
        assert angle(one.lights.position[0], truth.lights.position[0]) < 1e-7


def test_scenes_without_directions_keep_the_default():
    assert default_free(SCENES["shadows"]) == ("color", "ka", "kd", "ks", "light_position")
