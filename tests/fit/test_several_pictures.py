"""Several pictures of the same spheres: parameters that they share, and that each has apart."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import spheretrace_jax as st
from spheretrace_jax.fit.fit import DEFAULT_FREE
from spheretrace_jax.fit.model.products import determined_products
from spheretrace_jax.fit.problem.make_problem import make_problem
from spheretrace_jax.fit.problem.problem import Problem, normal_at
from spheretrace_jax.study.benchmarks.wrong_start import wrong_start

PLAIN = dict(bounces=0, samples=1)
SIZE = dict(width=48, height=48)

# A large sphere between two small ones, in line with the eyes of FRONT and BACK.
SPHERES = st.Spheres(
    [[0.0, 0, 0], [150, 30, 10], [-150, 30, -10]],
    [60.0, 30, 30],
    [[0.8, 0.5, 0.3], [0.3, 0.7, 0.5], [0.4, 0.4, 0.8]],
    ka=[0.2, 0.3, 0.25],
    kd=[0.6, 0.7, 0.5],
    ks=[0.4, 0.3, 0.2],
    exponent=[10.0, 20, 5],
)


def view(theta: float, phi: float = np.pi / 2, light=(200.0, 800, 500)) -> st.Scene:
    return st.Scene(SPHERES, st.Lights([light]), st.Camera(theta, phi, 500.0, 800.0))


FRONT, BACK = view(0.0), view(np.pi)
CAMERAS = [FRONT, BACK]
LIGHTS = [view(0.3, 0.6), view(0.3, 0.6, light=(-300.0, 500, 600))]
FRONT_ONLY, BACK_ONLY = 1, 2  # the spheres that one of the cameras sees


def pictures_of(scenes: list[st.Scene]) -> list[np.ndarray]:
    return [np.asarray(st.render(scene, **SIZE, **PLAIN)) for scene in scenes]


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    return pictures_of(CAMERAS)


def starts(scenes: list[st.Scene]) -> list[st.Scene]:
    return [wrong_start(scene) for scene in scenes]


def errors(found: st.Scene, truth: st.Scene) -> np.ndarray:
    """Returns the largest error of each sphere's, and the light's, determined numbers.

    In units of the largest of each kind.
    """
    true, worst = determined_products(truth), np.zeros(len(SPHERES) + 1)
    for name, x in determined_products(found).items():
        off = np.abs(x - true[name]).reshape(len(x), -1).max(1) / np.abs(true[name]).max()
        at = np.s_[-1:] if name == "light_position" else np.s_[:-1]
        worst[at] = np.maximum(worst[at], off)
    return worst


def problem_of(scenes, targets, **counts) -> Problem:
    return make_problem(scenes, targets, DEFAULT_FREE, bounces=0, **counts)


def normal_of(scenes, targets, **counts):
    """Returns the normal equations at the start."""
    problem = problem_of(scenes, targets, **counts)
    return normal_at(problem, problem.start())


def assert_sum(whole, *parts) -> None:
    """Checks that normal equations are the sum of others."""
    scale = np.sqrt(np.diag(np.asarray(whole.square)))
    some = np.where(scale > 0, scale, 1)
    square = sum(np.asarray(p.square) for p in parts)
    np.testing.assert_allclose(
        whole.square / np.outer(some, some), square / np.outer(some, some), atol=1e-13
    )
    gradient, size = sum(np.asarray(p.gradient) for p in parts), np.sqrt(2 * float(whole.cost))
    np.testing.assert_allclose(whole.gradient / (some * size), gradient / (some * size), atol=1e-13)
    np.testing.assert_allclose(whole.cost, sum(float(p.cost) for p in parts), rtol=1e-13)


@pytest.mark.slow
def test_two_cameras(pictures):
    found = st.fit(starts(CAMERAS), pictures, **PLAIN)
    assert found.converged and found.trust.ok
    for scene, truth in zip(found.scenes, CAMERAS, strict=True):
        assert errors(scene, truth).max() < 1e-8
        assert eqx.tree_equal(scene.camera, truth.camera)
    first, second = found.scenes
    assert eqx.tree_equal((first.spheres, first.lights), (second.spheres, second.lights))
    assert found.counted == 2 * pictures[0].size and found.left_out == 0
    # each alone leaves the sphere that it does not see at its start
    for scene, picture, hidden in zip(CAMERAS, pictures, (BACK_ONLY, FRONT_ONLY), strict=True):
        alone = st.fit(wrong_start(scene), picture, **PLAIN)
        worst = errors(alone.scene, scene)
        assert alone.converged and worst[hidden] > 0.1
        assert np.delete(worst, hidden).max() < 1e-8
        assert f"sphere {hidden + 1} is not visible" in "".join(alone.identifiability.undetermined)
        assert alone.scene.spheres.ka[hidden] == 0.3
    assert not any("not visible" in words for words in found.identifiability.undetermined)


@pytest.mark.slow
def test_normal_equations_add_up(pictures):
    noisy = [p + 0.01 * np.random.default_rng(0).standard_normal(p.shape) for p in pictures]
    both = normal_of(starts(CAMERAS), noisy)
    each = [normal_of(wrong_start(s), p) for s, p in zip(CAMERAS, noisy, strict=True)]
    assert min(float(n.cost) for n in each) > 0.1 * float(both.cost)
    assert_sum(both, *each)
    # what each picture counts, too
    mask = np.random.default_rng(1).uniform(size=(48, 48)) < 0.5
    counts = dict(noise=[0.01, 0.1], mask=[mask, None], weights=3.0)
    both = normal_of(starts(CAMERAS), noisy, **counts)
    first = normal_of(wrong_start(FRONT), noisy[0], noise=0.01, mask=mask, weights=3.0)
    second = normal_of(wrong_start(BACK), noisy[1], noise=0.1, weights=3.0)
    assert_sum(both, first, second)


def test_picture_twice_is_weight_2(pictures):
    start = wrong_start(FRONT)
    twice = normal_of([start, start], [pictures[0], pictures[0]])
    assert_sum(twice, normal_of(start, pictures[0], weights=2.0))


@pytest.mark.slow
def test_costs_add_up(pictures):
    """Checks the cost at the fit of two pictures that do not agree."""
    darker = [pictures[0], 0.9 * pictures[1]]
    found = st.fit(starts(CAMERAS), darker, **PLAIN)
    assert found.converged and found.cost > 1e-3
    costs = [
        0.5 * np.sum((picture - target) ** 2)
        for picture, target in zip(pictures_of(found.scenes), darker, strict=True)
    ]
    np.testing.assert_allclose(sum(costs), found.cost, rtol=1e-10)


def test_light_per_picture():
    found = st.fit(starts(LIGHTS), pictures_of(LIGHTS), own=("light_position",), **PLAIN)
    assert found.converged and found.trust.ok
    for scene, truth in zip(found.scenes, LIGHTS, strict=True):
        assert errors(scene, truth).max() < 1e-8
    first, second = found.scenes
    assert eqx.tree_equal(first.spheres, second.spheres)
    deviations = found.uncertainty.standard_deviations
    assert deviations["light_position"].shape == (2, 1, 3) and deviations["ks"].shape == (3,)


@pytest.mark.slow
def test_exposure_per_picture(pictures):
    exposures = np.array([[0.7, 1.1, 1.3], [1.5, 0.9, 0.8]])
    moved = [
        eqx.tree_at(lambda s: s.lights.position, truth, start.lights.position)
        for truth, start in zip(CAMERAS, starts(CAMERAS), strict=True)
    ]
    targets = [p * e for p, e in zip(pictures, exposures, strict=True)]
    found = st.fit(moved, targets, free=("exposure", "light_position"), **PLAIN)
    assert found.converged and found.trust.ok
    np.testing.assert_allclose(np.stack(found.exposures), exposures, rtol=1e-8)
    np.testing.assert_allclose(found.exposure, exposures[0], rtol=1e-8)
    for scene, truth in zip(found.scenes, CAMERAS, strict=True):
        assert errors(scene, truth).max() < 1e-8


def test_known_lights_may_differ():
    """Checks that only what is free and shared must start alike."""
    targets = [np.full((4, 4, 3), 0.5)] * 2
    problem = make_problem(LIGHTS, targets, ("color",), bounces=0)
    for (scene, _), truth in zip(problem.scenes_at(problem.start()), LIGHTS, strict=True):
        assert eqx.tree_equal(scene.lights, truth.lights)


TARGET = np.full((4, 5, 3), 0.5)
PLANE = st.Planes([[0.0, 0, -80]], [[0.0, 0, 1]])
DARK = eqx.tree_at(lambda s: s.spheres.ka, FRONT, jnp.zeros(3))
FLOORED = eqx.tree_at(lambda s: s.planes, FRONT, PLANE)
TWO_LIGHTS = eqx.tree_at(lambda s: s.lights, FRONT, st.Lights([[0.0, 0, 900], [0, 900, 0]]))
COUNT = "one target for each scene, got {} scenes and {} targets"
ALIKE = "{} is free and starts differently in scene {}: name it in own"
OWN = "own must name free parameters of lights or camera, got {}"


@pytest.mark.parametrize(
    ("scenes", "targets", "settings", "message"),
    [
        (CAMERAS, [TARGET], {}, COUNT.format(2, 1)),
        (CAMERAS, [TARGET] * 3, {}, COUNT.format(2, 3)),
        (FRONT, [TARGET, TARGET], {}, COUNT.format(1, 2)),
        (FRONT, [TARGET, TARGET[1:]], {}, COUNT.format(1, 2)),
        ([FRONT], TARGET, {}, COUNT.format(1, 4)),
        ([], [], {}, COUNT.format(0, 0)),
        ([FRONT, DARK], [TARGET] * 2, {}, "scene 2 has other spheres than the first"),
        ([FRONT, BACK, FLOORED], [TARGET] * 3, {}, "scene 3 has other planes than the first"),
        ([FRONT, TWO_LIGHTS], [TARGET] * 2, {}, ALIKE.format("light_position", 2)),
        (LIGHTS, [TARGET] * 2, {}, ALIKE.format("light_position", 2)),
        (CAMERAS, [TARGET] * 2, dict(free=("ks", "theta")), ALIKE.format("theta", 2)),
        (
            [FRONT, FRONT, BACK], [TARGET] * 3, dict(free=("mu", "theta"), own=("mu",)),
            ALIKE.format("theta", 3),
        ),
        (LIGHTS, [TARGET] * 2, dict(free=("ks",), own=("light_position",)),
         OWN.format("light_position")),
        (LIGHTS, [TARGET] * 2, dict(own=("ks", "light_position")), OWN.format("ks")),
        (LIGHTS, [TARGET] * 2, dict(own=("light_position", "lights")), OWN.format("lights")),
        ([FRONT, BACK], [TARGET, np.full((4, 5, 2), 0.5)], {}, r"target must have shape .*4, 5, 2"),
    ],
)  # fmt: skip
def test_mistakes(scenes, targets, settings, message):
    with pytest.raises(st.InputError, match=message) as caught:
        st.fit(scenes, targets, **settings)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("counts", "message"),
    [
        (dict(mask=[np.ones((4, 5), bool)] * 3), "mask must be one for all or one for each of 2"),
        (dict(weights=(1.0,)), "weights must be one for all or one for each of 2, got 1"),
        (dict(noise=[0.1, None]), "noise must be given for all pictures or for none"),
        (dict(noise=[0.1, 0.0]), "noise must be finite and greater than 0"),
    ],
)
def test_mistakes_of_counts(counts, message):
    with pytest.raises(st.InputError, match=message):
        problem_of(CAMERAS, [TARGET, TARGET], **counts)
