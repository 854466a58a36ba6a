"""Constraints: numbers of free parameters that are held, tied, bounded, or known beforehand."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from jax.flatten_util import ravel_pytree

import spheretrace_jax as st
from spheretrace_jax.fit.model.constraints import make_constraints
from spheretrace_jax.fit.model.parameters import Parameters
from spheretrace_jax.fit.problem.labels import labels_of, unknown_indices
from spheretrace_jax.fit.problem.make_problem import make_problem
from spheretrace_jax.fit.problem.problem import normal_at
from spheretrace_jax.fit.solution import solution

SIZE = dict(width=24, height=24)
PLAIN = dict(bounces=0)
TRUTH = st.Scene(
    st.Spheres(
        [[-60.0, 0, 0], [70, 20, 10], [0, 60, 60]], [60.0, 50, 30],
        [[0.8, 0.3, 0.2], [0.2, 0.6, 0.9], [0.5, 0.7, 0.3]], 0.2, 0.6, 0.3, exponent=12.0,
    ),
    st.Lights([[200.0, 300, 500], [-300, 100, 400]], [[0.6, 0.6, 0.6], [0.3, 0.4, 0.5]]),
    st.Camera(theta=-1.2, phi=0.5),
)  # fmt: skip
SMOOTH = TRUTH.with_antialias(1)
TARGET = np.asarray(st.render(TRUTH, **SIZE, **PLAIN))
MASK = np.array([[False, False, True], [True, True, True], [False, False, False]])


def with_(scene: st.Scene, **changes) -> st.Scene:
    """Returns a scene with other parameters of spheres, or positions of lights."""
    for name, x in changes.items():
        at = lambda s, n=name: s.lights.position if n == "light" else getattr(s.spheres, n)
        scene = eqx.tree_at(at, scene, jnp.broadcast_to(jnp.asarray(x), at(scene).shape))
    return scene


def parameters_of(scene: st.Scene, free, tie=None, bounds=None, priors=None) -> Parameters:
    constraints = make_constraints(scene, free, tie or {}, bounds or {}, priors or {})
    return Parameters(scene, tuple(free), constraints)


# from unknowns to numbers


def test_held_numbers_stay_as_they_are():
    scene = with_(TRUTH, exponent=[0.0, 5, 7])
    free = {
        "color": MASK, "ka": [2], "exponent": [1], "center": [0, 2], "radius": [1],
        "light_position": [1], "light_color": [0], "exposure": [1], "theta": True,
    }  # fmt: skip
    parameters = parameters_of(scene, free, bounds={"theta": (-2, 2)})
    start = parameters.start()
    sizes = {name: y.size for name, y in start.items()}
    assert sizes == dict(
        color=4, ka=1, exponent=1, center=6, radius=1, light_position=3, light_color=3,
        exposure=1, theta=1,
    )  # fmt: skip
    same = parameters.natural(start)
    moved = parameters.natural(jax.tree.map(lambda y: y + 0.01, start))
    for name, numbers in moved.items():
        before = np.ones(3) if name == "exposure" else np.asarray(parameters_start(scene, name))
        np.testing.assert_allclose(same[name], before, rtol=1e-14, atol=1e-14)
        held = ~parameters.free_numbers(name)
        np.testing.assert_array_equal(np.asarray(numbers)[held], before[held])
        assert (np.asarray(numbers)[~held] != before[~held]).all(), name


def parameters_start(scene: st.Scene, name: str):
    plain = Parameters(scene, (name,))
    return plain.natural(plain.start())[name] if name == "exposure" else _leaf(scene, name)


def _leaf(scene: st.Scene, name: str):
    if name.startswith("light_"):
        return getattr(scene.lights, name.removeprefix("light_"))
    return getattr(scene.camera if name == "theta" else scene.spheres, name)


def test_tied_numbers_agree():
    """Also centres of spheres of different radii, which are scaled by these."""
    scene = with_(TRUTH, center=[[10.0, 20, 30], [1, 2, 3], [10, 20, 30]], radius=[60.0, 50, 60])
    parameters = parameters_of(
        with_(scene, radius=[60.0, 50, 30]), ("center", "kd"), {"center": [[2, 0]], "kd": True}
    )
    start = parameters.start()
    assert start["center"].size == 6 and start["kd"].size == 1
    moved = parameters.natural(jax.tree.map(lambda y: y + 0.1, start))
    np.testing.assert_array_equal(moved["center"][0], moved["center"][2])
    np.testing.assert_allclose(moved["center"][0], np.array([16.0, 26, 36]), rtol=1e-12)
    assert np.ptp(np.asarray(moved["kd"])) == 0
    grey = parameters_of(TRUTH, ("exposure",), {"exposure": True})
    assert np.ptp(np.asarray(grey.natural({"exposure": jnp.asarray([0.3])})["exposure"])) == 0


@pytest.mark.slow
def test_any_unknowns_are_within_bounds():
    bounds = dict(
        color=(0.1, 0.9), ka=(-np.inf, 0.3), exponent=(2, 30),
        radius=(np.array([50.0, 40, -np.inf]), 70),
        light_color=(0.2, np.inf), theta=(-1.3, -1.1), center=(-100, np.inf), exposure=(0.5, 2),
    )  # fmt: skip
    parameters = parameters_of(TRUTH, tuple(bounds), bounds=bounds)
    start = parameters.start()
    lower, upper = parameters.bounds()
    for name, y in start.items():
        assert (lower[name] <= y).all() and (y <= upper[name]).all()
        for shift in (-7.3, -0.4, 0.6, 5.1):
            numbers = np.asarray(parameters.natural({name: y + shift})[name])
            least, most = (np.asarray(b) for b in bounds[name])
            assert (numbers >= least * (1 - 1e-12 * np.sign(least))).all(), name
            assert (numbers <= most * (1 + 1e-12 * np.sign(most))).all(), name
        # a solver that comes to a bound can leave it again
        for limit in (lower[name], upper[name]):
            at = {name: jnp.where(jnp.abs(limit) < 1e300, limit, y)}
            slope = jax.jvp(parameters.natural, (at,), (jax.tree.map(jnp.ones_like, at),))[1]
            assert (np.asarray(slope[name]) > 0).all(), name


# normal equations


@pytest.mark.slow
def test_normal_equations():
    """Checks them against the residuals of all pixels and priors."""
    problem = make_problem(
        TRUTH, TARGET + 0.01, {"color": True, "kd": True, "light_position": [0]}, noise=0.1,
        tie={"kd": True}, priors={"kd": (0.5, 0.1), "light_position": (100.0, 50.0)},
        limits={"color": (0.1, 0.95)}, **PLAIN,
    )  # fmt: skip
    y, unravel = ravel_pytree(problem.start())
    y = y + 0.01 * np.random.default_rng(0).uniform(-1, 1, y.shape)
    normal = normal_at(problem, unravel(y))
    jacobian = jax.jacfwd(lambda y: problem.residual(unravel(y)))(y)
    residual = problem.residual(unravel(y))
    square = jacobian.T @ jacobian
    np.testing.assert_allclose(normal.square, square, atol=1e-12 * float(square.max()))
    np.testing.assert_allclose(normal.gradient, jacobian.T @ residual, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(normal.cost, 0.5 * residual @ residual, rtol=1e-12)


CASES = {
    "held": (TRUTH, {"color": [0, 2], "kd": True, "light_position": [1]}, {}),
    "mask": (TRUTH, {"color": MASK, "exposure": [1]}, {}),
    "tied": (
        TRUTH,
        {"color": True, "kd": True, "ka": [0, 1]},
        dict(tie={"kd": [[0, 2]], "ka": [0, 1]}),
    ),
    "covered edges": (SMOOTH, {"color": [1, 2], "light_position": [0]}, {}),
    "geometry": (
        with_(SMOOTH, radius=[60.0, 50, 50]),
        {"radius": True, "center": [2], "theta": True, "color": [1]},
        dict(limits={"theta": (-1.3, -1.1)}, tie={"radius": [[1, 2]]}),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_restricted_normal_equations(case):
    """Checks that rows and columns of held numbers go and those of tied ones add up."""
    scene, free, settings = CASES[case]
    problem = make_problem(scene, TARGET + 0.01, free, **PLAIN, **settings)
    whole = make_problem(scene, TARGET + 0.01, tuple(free), **PLAIN)
    normal, full = (normal_at(p, p.start()) for p in (problem, whole))
    places = [unknown_indices(p) for p in (problem, whole)]
    unknown, number = (
        np.concatenate([array.ravel() for name in sorted(free) for array in of[name]])
        for of in places
    )
    gather = np.zeros((full.gradient.size, normal.gradient.size))
    gather[number[unknown >= 0], unknown[unknown >= 0]] = 1
    square = gather.T @ full.square @ gather
    np.testing.assert_allclose(normal.square, square, atol=1e-12 * square.max())
    np.testing.assert_allclose(normal.gradient, gather.T @ full.gradient, rtol=1e-9, atol=1e-10)
    assert labels_of(problem).size == normal.gradient.size < full.gradient.size


def test_labels():
    free = {"color": MASK, "kd": True, "light_position": [1], "exposure": True, "theta": True}
    tie = {"kd": [[0, 2]], "exposure": True}
    problem = make_problem(TRUTH, TARGET, free, tie=tie, limits={"theta": (-2, 0)}, **PLAIN)
    assert labels_of(problem).tolist() == [
        "sphere 1's color", *["sphere 2's color"] * 3, "the exposure of red, green and blue",
        "the kd of spheres 1 and 3", "sphere 2's kd", *["light 2's position"] * 3,
        "the camera's theta",
    ]  # fmt: skip


# fits


def test_fit_of_single_objects():
    start = with_(
        TRUTH, color=[[0.4, 0.4, 0.4], [0.2, 0.6, 0.9], [0.4, 0.4, 0.4]], kd=[0.6, 0.5, 0.6]
    )
    free = {"color": [0, 2], "kd": np.array([False, True, False])}
    found = st.fit(start, TARGET, free=free, **PLAIN)
    assert found.trust.ok and found.identifiability.free == found.identifiability.rank == 7
    np.testing.assert_allclose(found.scene.spheres.color, TRUTH.spheres.color, atol=1e-9)
    np.testing.assert_allclose(found.scene.spheres.kd, TRUTH.spheres.kd, atol=1e-9)
    for name in ("color", "kd"):
        held = ~found.problem.parameters[0].free_numbers(name)
        before, after = (np.asarray(getattr(s.spheres, name)) for s in (start, found.scene))
        np.testing.assert_array_equal(after[held], before[held])
        assert (found.uncertainty.standard_deviations[name][held] == 0).all()
    assert "free: color of 2 of 3 spheres, kd of 1 of 3 spheres" in str(found)


@pytest.mark.slow
def test_fit_of_one_material():
    truth = with_(TRUTH, color=[0.5, 0.7, 0.3])
    noise = 0.01 * np.random.default_rng(0).standard_normal(TARGET.shape)
    target = np.asarray(st.render(truth, **SIZE, **PLAIN)) + noise
    start = with_(truth, color=0.4, ka=0.3, kd=0.4, ks=0.2)
    names = ("color", "ka", "kd", "ks")
    found = st.fit(start, target, tie=dict.fromkeys(names, True), free=names, **PLAIN)
    alone = st.fit(start, target, free=names, **PLAIN)
    assert found.trust.ok and found.identifiability.free == 6
    assert found.identifiability.undetermined == (
        "sphere 1: the scale of color against ka and kd is not determined",
    )
    s = found.scene.spheres
    for name in names:
        assert np.ptp(np.asarray(getattr(s, name)), axis=0).max() == 0
    assert s.ka[0] == pytest.approx(0.3, abs=1e-12)  # the gauge
    product = lambda s: s.spheres.kd[:, None] * s.spheres.color
    error = lambda f: np.abs(np.asarray(product(f.scene) - product(truth))).max()
    assert error(found) < 0.01
    assert (found.uncertainty.of(product) < alone.uncertainty.of(product)).all()


@pytest.mark.slow
@pytest.mark.parametrize("solver", [None, optx.BFGS])
def test_fit_with_bounds(solver):
    start = with_(TRUTH, kd=0.5, color=0.5)
    made = None if solver is None else solver(rtol=1e-8, atol=1e-8)
    found = st.fit(
        start, TARGET, free=("kd",), bounds={"kd": (0.3, [0.9, 0.55, 0.9])}, solver=made, **PLAIN
    )
    kd = np.asarray(found.scene.spheres.kd)
    free = st.fit(start, TARGET, free=("kd",), **PLAIN)
    expected = np.clip(np.asarray(free.scene.spheres.kd), 0.3, [0.9, 0.55, 0.9])
    assert (np.asarray(free.scene.spheres.kd) > 0.55)[1]
    np.testing.assert_allclose(kd, expected, atol=0.02)
    assert kd[1] <= 0.55 * (1 + 1e-12)
    if solver is None:
        assert kd[1] == pytest.approx(0.55, abs=1e-15)
        assert "at its bound: sphere 2's kd" in str(found.trust)


@pytest.mark.slow
@pytest.mark.parametrize("solver", [optx.GaussNewton, optx.Dogleg, optx.LevenbergMarquardt])
def test_solvers_that_know_no_bounds_stay_within_them(solver):
    """They may not settle at a bound, and the verdict says so."""
    solver = solver(rtol=1e-8, atol=1e-8)
    bounds = {"kd": (0.3, 0.55)}
    start = with_(TRUTH, kd=0.5)
    found = st.fit(start, TARGET, free=("kd",), bounds=bounds, solver=solver, max_steps=20, **PLAIN)
    assert not found.trust.ok
    assert found.scene.spheres.kd.min() >= 0.3 and found.scene.spheres.kd.max() <= 0.55


@pytest.mark.slow
def test_fit_with_priors():
    """Against the closed form, as pictures are linear in kd."""
    noise, mean, sigma = 0.05, np.array([0.5, 0.7, 0.4]), np.array([0.01, np.inf, 0.002])
    noisy = TARGET + noise * np.random.default_rng(0).standard_normal(TARGET.shape)
    plain = st.fit(TRUTH, noisy, free=("kd",), noise=noise, **PLAIN)
    found = st.fit(TRUTH, noisy, free=("kd",), noise=noise, priors={"kd": (mean, sigma)}, **PLAIN)
    square = np.asarray(plain.normal.square)
    posterior = square + np.diag(1 / sigma**2)
    kd = np.linalg.solve(posterior, square @ plain.scene.spheres.kd + mean / sigma**2)
    np.testing.assert_allclose(found.scene.spheres.kd, kd, rtol=1e-9)
    np.testing.assert_allclose(
        # priors that contradict the picture leave a residual that is no white noise
        found.uncertainty.white.standard_deviations["kd"],
        np.sqrt(np.diag(np.linalg.inv(posterior))),
        rtol=1e-6,
    )
    assert "what is known of kd counts: priors, as given" in found.trust.remarks
    off = np.asarray(found.scene.spheres.kd - mean) / sigma
    residual = np.asarray(st.render(found.scene, **SIZE, **PLAIN) - noisy) / noise
    np.testing.assert_allclose(found.cost, 0.5 * np.sum(residual**2) + 0.5 * off @ off, rtol=1e-9)


def test_priors_determine_what_pictures_do_not():
    """The scale of color against ka and kd."""
    free = ("color", "ka", "kd")
    priors = {"ka": ([0.2, 0.3, 0.2], [0.01, 0.01, np.inf])}
    found = st.fit(TRUTH, TARGET, free=free, noise=0.01, priors=priors, **PLAIN)
    assert found.identifiability.undetermined == (
        "sphere 3: the scale of color against ka and kd is not determined",
    )
    spread = found.uncertainty.standard_deviations["ka"]
    np.testing.assert_allclose(spread[:2], 0.01, rtol=0.05)
    assert spread[2] == np.inf
    np.testing.assert_allclose(found.scene.spheres.ka[:2], [0.2, 0.3], atol=0.005)


@pytest.mark.slow
def test_priors_determine_the_scale_of_the_world():
    free = ("center", "radius", "light_position")
    target = st.render(SMOOTH, **SIZE, **PLAIN)
    sentence = "the scale of the world is not determined"
    plain = st.fit(SMOOTH, target, free=free, noise=0.01, **PLAIN)
    assert sentence in plain.identifiability.undetermined
    priors = {"radius": ([60.0, 50, 30], [0.5, np.inf, np.inf])}
    found = st.fit(SMOOTH, target, free=free, noise=0.01, priors=priors, **PLAIN)
    assert sentence not in found.identifiability.undetermined
    np.testing.assert_allclose(found.uncertainty.standard_deviations["radius"][0], 0.5, rtol=0.05)
    part = {"center": [0, 1], "radius": True, "light_position": True}
    held = st.fit(SMOOTH, target, free=part, **PLAIN)
    assert sentence not in held.identifiability.undetermined


@pytest.mark.slow
@pytest.mark.parametrize("start", ["lights", "auto"])
def test_searches_for_lights_with_constraints(start):
    grey = with_(TRUTH, color=[[0.5, 0.5, 0.5], [0.2, 0.6, 0.9], [0.5, 0.5, 0.5]])
    moved = np.array(TRUTH.lights.position)
    moved[0] = [100.0, 200, 700]
    free = {"color": [0, 2], "light_position": [0]}
    found = st.fit(with_(grey, light=moved), TARGET, free=free, start=start, **PLAIN)
    assert found.trust.ok
    np.testing.assert_allclose(found.scene.spheres.color, TRUTH.spheres.color, atol=1e-8)
    np.testing.assert_allclose(found.scene.lights.position, TRUTH.lights.position, rtol=1e-8)
    np.testing.assert_array_equal(found.scene.lights.position[1], TRUTH.lights.position[1])


@pytest.mark.slow
def test_start_from_nothing_with_tied_material():
    truth = with_(TRUTH, color=[0.5, 0.7, 0.3])
    truth = eqx.tree_at(lambda s: s.lights, truth, st.Lights(TRUTH.lights.position[:1]))
    target = st.render(truth, **SIZE, **PLAIN)
    start = with_(truth, color=0.5, kd=0.5, light=[0.0, 0, 900])
    free = ("color", "kd", "light_position")
    tie = {"color": True, "kd": True}
    bounds = {"kd": (0.55, 0.9)}
    settings = dict(free=free, tie=tie, bounds=bounds, start="auto", **PLAIN)
    with pytest.raises(st.InputError, match=r"kd of sphere 1 starts at 0\.5, outside of its"):
        st.fit(start, target, **settings)
    found = st.fit(with_(start, kd=0.7), target, **settings)
    assert found.trust.ok
    np.testing.assert_allclose(found.scene.lights.position, truth.lights.position, rtol=1e-7)
    assert np.ptp(np.asarray(found.scene.spheres.color), axis=0).max() == 0
    assert ((found.scene.spheres.kd >= 0.55) & (found.scene.spheres.kd <= 0.9)).all()


@pytest.mark.slow
def test_several_pictures():
    other = with_(TRUTH, light=np.array([[500.0, 100, 400], [-300, 100, 400]]))
    targets = [np.asarray(st.render(s, **SIZE, **PLAIN)) for s in (TRUTH, other)]
    start = [with_(s, kd=0.4, color=[0.5, 0.5, 0.5]) for s in (TRUTH, other)]
    off = np.array([[30.0], [0]])
    first = [with_(s, light=np.asarray(s.lights.position) + off) for s in start]
    free = {"color": True, "kd": True, "light_position": [0]}
    found = st.fit(
        first, targets, free=free, own=("light_position",), tie={"kd": True}, noise=0.01,
        priors={"kd": (0.55, 0.01), "light_position": (200.0, 1e4)}, **PLAIN,
    )  # fmt: skip
    assert found.identifiability.free == 9 + 1 + 2 * 3
    for scene, truth in zip(found.scenes, (TRUTH, other), strict=True):
        np.testing.assert_array_equal(scene.lights.position[1], truth.lights.position[1])
        np.testing.assert_allclose(scene.lights.position[0], truth.lights.position[0], rtol=0.02)
    # the prior of what pictures share counts once, of what each has for each
    off = (np.asarray(found.scene.spheres.kd)[0] - 0.55) / 0.01
    lights = [(np.asarray(s.lights.position[0]) - 200) / 1e4 for s in found.scenes]
    pairs = zip(found.scenes, targets, strict=True)
    residuals = [np.asarray(st.render(s, **SIZE, **PLAIN) - t) / 0.01 for s, t in pairs]
    expected = off**2 + np.sum(np.square(lights)) + np.sum(np.square(residuals))
    np.testing.assert_allclose(2 * found.cost, expected, rtol=1e-8)


@pytest.mark.slow
def test_robust_and_dense_fits():
    start = with_(TRUTH, color=0.5)
    settings = dict(
        free={"color": [0], "kd": True}, tie={"kd": True}, bounds={"kd": (0.1, 0.8)},
        priors={"kd": (0.6, 0.1)}, noise=0.01, **PLAIN,
    )  # fmt: skip
    expected = st.fit(start, TARGET, **settings)
    dense = st.fit(start, TARGET, jacobian="dense", **settings)
    np.testing.assert_allclose(dense.scene.spheres.kd, expected.scene.spheres.kd, rtol=1e-6)
    np.testing.assert_allclose(dense.scene.spheres.color, expected.scene.spheres.color, rtol=1e-6)
    robust = st.fit(start, TARGET, loss="huber", **settings)
    assert robust.converged and np.ptp(np.asarray(robust.scene.spheres.kd)) == 0


@pytest.mark.slow
def test_solution():
    """Derivatives of the solution by a prior's mean, and by what is held, against refits."""
    noisy = TARGET + 0.02 * np.random.default_rng(0).standard_normal(TARGET.shape)
    free = {"color": [0, 2], "kd": True}
    problem = st.fit(
        TRUTH, noisy, free=free, tie={"kd": True}, priors={"kd": (0.5, 0.002)}, noise=0.02, **PLAIN
    ).problem
    mean = lambda p: p.parameters[0].constraints["kd"].mean
    held = lambda p: p.parameters[0].scene.spheres.color

    def kd(place, x):
        return solution(eqx.tree_at(place, problem, x))[0][0].spheres.kd[0]

    for place, step in ((mean, jnp.ones(3)), (held, jnp.zeros((3, 3)).at[1].set(1.0))):
        x = place(problem)
        slope = jax.jvp(lambda x, p=place: kd(p, x), (x,), (step,))[1]
        h = 1e-4
        apart = (kd(place, x + h * step) - kd(place, x - h * step)) / (2 * h)
        np.testing.assert_allclose(slope, apart, rtol=1e-5)
        assert abs(slope) > 1e-3


# mistakes


@pytest.fixture
def unchecked():
    """Disables the tests' type checks, which refuse a wrong word before the user's message."""
    import jaxtyping

    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.mark.parametrize(
    ("free", "constraints", "message"),
    [
        ({"colour": True}, {}, "free parameters must be among .* got colour"),
        ({"kd": False}, {}, "free parameters must be among .* got none"),
        ({}, {}, "free parameters must be among .* got none"),
        ({"kd": []}, {}, r"free\['kd'\] names no sphere"),
        ({"kd": np.zeros(3, bool)}, {}, r"free\['kd'\] names no sphere"),
        ({"kd": [0, 3]}, {}, r"free\['kd'\] must hold indices of spheres from 0 to 2, got 3"),
        ({"kd": [-1]}, {}, "from 0 to 2, got -1"),
        ({"kd": [1, 1]}, {}, r"must name each sphere once, got \[1, 1\]"),
        ({"kd": [0.5]}, {}, r"must hold indices of spheres, got \[0.5\]"),
        ({"kd": "all"}, {}, "must hold indices of spheres, got 'all'"),
        ({"kd": 1}, {}, "must hold indices of spheres, got 1"),
        ({"light_color": [2]}, {}, "indices of lights from 0 to 1, got 2"),
        ({"color": np.ones((2, 3), bool)}, {}, r"a mask of shape \(3,\) or \(3, 3\), got \(2, 3\)"),
        ({"theta": [0]}, {}, "must be True or False: it is one number"),
        ({"exposure": [3]}, {}, "indices of channels from 0 to 2, got 3"),
        ({"light_position": np.eye(3, dtype=bool)[:2]}, {}, "free or held as a whole"),
        (("kd",), dict(tie={"ka": True}), "tie must name free parameters, got ka"),
        (("kd",), dict(bounds={"ka": (0, 1)}), "bounds must name free parameters, got ka"),
        (("kd",), dict(priors={"ka": (0, 1)}, noise=1.0), "priors must name free .* got ka"),
        (("kd",), dict(tie={"kd": []}), r"tie\['kd'\] names no sphere"),
        (("kd",), dict(tie={"kd": [[0, 5]]}), "from 0 to 2, got 5"),
        (("kd",), dict(tie={"kd": [[0, 1], [1, 2]]}), "must name each sphere once"),
        (("kd",), dict(tie={"kd": "all"}), "must be True or lists of indices, got 'all'"),
        (("kd",), dict(tie=["kd"]), "tie must map names of free parameters"),
        (
            ("color",),
            dict(tie={"color": [[0, 1]]}),
            "color of spheres 1, 2 is tied and must start alike, got 0.8 0.3 0.2, 0.2 0.6 0.9",
        ),
        ({"kd": [0]}, dict(tie={"kd": [[0, 1]]}), "kd of spheres 1, 2 is tied, so all of it"),
        (("theta",), dict(tie={"theta": True}), "theta is one number"),
        (("kd",), dict(bounds={"kd": 0.5}), r"must be a pair \(lower, upper\), got 0.5"),
        (("kd",), dict(bounds={"kd": (0, 0.5, 1)}), r"must be a pair \(lower, upper\)"),
        (("kd",), dict(bounds={"kd": (0.7, 0.2)}), "the lower, 0.7, is above the upper, 0.2"),
        (("kd",), dict(bounds={"kd": (0.0, 0.5)}), "kd of sphere 1 starts at 0.6, outside of"),
        (("kd",), dict(bounds={"kd": (0.0, 2)}), "bounds of kd must be at most 1"),
        (("radius",), dict(bounds={"radius": (-5, 80)}), "bounds of radius must be at least 0"),
        (("kd",), dict(bounds={"kd": (np.nan, 1)}), "must hold numbers, got nan"),
        (("kd",), dict(bounds={"kd": ([0, 0], 1)}), r"have the shape \(3,\), got shape \(2,\)"),
        (("light_position",), dict(bounds={"light_position": (0, 1)}), "are not to be had"),
        (("kd",), dict(priors={"kd": (0.5, 0.1)}), "priors need noise"),
        (("kd",), dict(priors={"kd": (0.5, 0)}, noise=1.0), "sigma must be greater than 0, got 0"),
        (
            ("kd",),
            dict(priors={"kd": (0.5, -1)}, noise=1.0),
            "sigma must be greater than 0, got -1",
        ),
        (("kd",), dict(priors={"kd": (np.inf, 1)}, noise=1.0), "the mean must be finite"),
        (("kd",), dict(priors={"kd": 0.5}, noise=1.0), r"must be a pair \(mean, sigma\), got 0.5"),
        (
            ("kd",),
            dict(tie={"kd": True}, priors={"kd": ([0.5, 0.6, 0.5], 1)}, noise=1.0),
            "priors of kd must be the same where kd is tied",
        ),
        (
            ("light_position",),
            dict(tie={"light_position": True}, start="auto"),
            "must start alike",
        ),
    ],
)
@pytest.mark.filterwarnings("ignore:.* free")
def test_mistakes(unchecked, free, constraints, message):
    with pytest.raises(st.InputError, match=message) as caught:
        st.fit(TRUTH, TARGET, free=free, **constraints, **PLAIN)
    assert "\n" not in str(caught.value)


def test_tied_lights_are_not_searched_for():
    scene = with_(TRUTH, light=[200.0, 300, 500])
    with pytest.raises(st.InputError, match="start auto does not know lights whose positions"):
        st.fit(scene, TARGET, tie={"light_position": True}, start="auto", **PLAIN)


@pytest.mark.slow
def test_bounds_in_float32():
    """A start that is rounded is not outside of its bounds."""
    scene = with_(TRUTH, kd=0.2).astype(np.float32)
    target, bounds = TARGET.astype(np.float32), {"kd": (0.1, 0.2)}
    found = st.fit(scene, target, free=("kd",), bounds=bounds, **PLAIN)
    np.testing.assert_allclose(found.scene.spheres.kd, 0.2, rtol=1e-6)
