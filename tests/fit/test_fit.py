import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix as optx
import pytest
from helpers.scenes import SCENES, nine_spheres, three_apart

import spheretrace_jax as st
from spheretrace_jax.fit.model.parameters import Parameters
from spheretrace_jax.fit.model.products import determined_products
from spheretrace_jax.fit.model.target import make_target
from spheretrace_jax.fit.solver.driver import check_solver
from spheretrace_jax.study.benchmarks.wrong_start import wrong_start

LIGHT = (100.0, 500, 800)
PLAIN = dict(bounces=0, samples=1)  # of most fits here, so that they compile quickly
SIZE = dict(width=32, height=32)


def with_random_colors(scene: st.Scene) -> st.Scene:
    color = np.random.default_rng(0).uniform(0.2, 0.9, scene.spheres.color.shape)
    return eqx.tree_at(lambda s: s.spheres.color, scene, jnp.asarray(color, scene.dtype))


def errors(found: st.Scene, truth: st.Scene) -> dict[str, float]:
    """Returns the largest errors of the determined products, as parts of their largest values."""
    true = determined_products(truth)
    return {
        k: np.abs(v - true[k]).max() / np.abs(true[k]).max()
        for k, v in determined_products(found).items()
    }


@pytest.mark.parametrize(
    ("size", "antialias", "options"),
    [
        pytest.param(128, 0, PLAIN, id="one ray"),
        pytest.param(128, 1, PLAIN, id="antialiased", marks=pytest.mark.slow),
        pytest.param(48, 1, {}, id="antialiased with reflections", marks=pytest.mark.slow),
        pytest.param(128, 1, {}, id="antialiased with reflections, large", marks=pytest.mark.slow),
    ],
)
def test_nine_spheres_from_wrong_start(size, antialias, options):
    lecture = nine_spheres(LIGHT)
    truth = with_random_colors(lecture.with_antialias(antialias))
    target = st.render(truth, width=size, height=size, **options)
    found = st.fit(wrong_start(truth), target, **options)
    assert found.converged and found.result == optx.RESULTS.successful
    assert found.steps <= 12
    assert max(errors(found.scene, truth).values()) < 1e-8
    assert found.cost < 1e-15 and found.left_out == 0


def test_colors_on_bounds():
    truth = nine_spheres(LIGHT)  # green and blue are 0, the first ks too
    noise = 0.01 * np.random.default_rng(0).standard_normal((64, 64, 3))
    target = st.render(truth, width=64, height=64, **PLAIN) + noise
    visited = []
    found = st.fit(wrong_start(truth), target, callback=lambda p: visited.append(p.cost), **PLAIN)
    assert found.converged and found.steps <= 15
    assert visited == list(found.costs) and all(np.diff(visited) <= 0)
    s = found.scene.spheres
    for value in (s.color, s.ka, s.kd, s.ks):
        assert value.min() >= 0 and value.max() <= 1
    assert (s.color[:, 1:] == 0).any()  # held exactly where noise pulls outwards
    assert errors(found.scene, truth)["light_position"] < 0.01


@pytest.mark.parametrize("bound", [0.0, 1.0])
def test_bounds_are_left_again(bound):
    truth = with_random_colors(nine_spheres(LIGHT))
    target = st.render(truth, width=64, height=64, **PLAIN)
    names = ("color", "ka", "kd", "ks") if bound else ("ka", "kd", "ks")
    places = lambda s: [getattr(s.spheres, name) for name in names]
    start = eqx.tree_at(places, truth, [jnp.full_like(x, bound) for x in places(truth)])
    found = st.fit(start, target, **PLAIN)
    assert found.converged and max(errors(found.scene, truth).values()) < 1e-8


def test_float32_accuracy():
    truth = with_random_colors(nine_spheres(LIGHT, np.float32))
    target = st.render(truth, width=64, height=64, **PLAIN)
    found = st.fit(wrong_start(truth), target, **PLAIN)
    assert found.converged
    worst = errors(found.scene, truth)
    assert max(worst["ka*color"], worst["kd*color"], worst["ks"]) < 1e-5
    assert worst["light_position"] < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "free", "places"),
    [
        ("shadows", ("exponent",), lambda s: [s.spheres.exponent]),
        ("two_coloured_lights", ("light_color",), lambda s: [s.lights.color]),
        ("glass", ("kgr", "kt"), lambda s: [s.spheres.kgr, s.spheres.kt]),
        ("shadows", ("ks", "exponent"), lambda s: [s.spheres.ks, s.spheres.exponent]),
    ],
)
def test_other_parameters(name, free, places):
    truth = SCENES[name]
    target = st.render(truth, bounces=2, **SIZE)
    start = eqx.tree_at(places, truth, [0.6 * x + 0.1 for x in places(truth)])
    found = st.fit(start, target, free=free, bounces=2)
    assert found.converged
    for value, true in zip(places(found.scene), places(truth), strict=True):
        np.testing.assert_allclose(value, true, rtol=1e-7, atol=1e-9)


@pytest.mark.slow
def test_mirrors_from_none():
    truth = SCENES["mirrors"]
    blank = eqx.tree_at(lambda s: s.spheres.kgr, truth, jnp.zeros(3))
    found = st.fit(blank, st.render(truth, bounces=2, **SIZE), free=("kgr",), bounces=2)
    np.testing.assert_allclose(found.scene.spheres.kgr, truth.spheres.kgr, atol=1e-9)


@pytest.mark.slow
def test_fixed_parameters_stay():
    truth = nine_spheres(LIGHT)
    found = st.fit(wrong_start(truth), st.render(truth, **SIZE, **PLAIN), free=("ks",), **PLAIN)
    start = wrong_start(truth)
    changed = eqx.tree_at(lambda s: s.spheres.ks, found.scene, start.spheres.ks)
    assert eqx.tree_equal(changed, start)


@pytest.mark.slow
def test_ka_stays_where_color_allows():
    truth = with_random_colors(nine_spheres(LIGHT))
    target = st.render(truth, **SIZE, **PLAIN)
    found = st.fit(wrong_start(truth), target, **PLAIN).scene.spheres
    kept = np.isclose(found.ka, 0.3, rtol=1e-12)
    # the first two have kd .9 and .8: a ka of .3 would ask for more than 1
    assert kept.sum() >= 6
    full = np.isclose(found.kd, 1) | np.isclose(found.color.max(1), 1) | np.isclose(found.ka, 1)
    assert (kept | full).all()


def test_clipped_pixels(tmp_path):
    truth = nine_spheres(LIGHT)
    truth = eqx.tree_at(lambda s: s.lights.color, truth, 1.5 * truth.lights.color)
    picture = st.render(truth, width=64, height=64, **PLAIN)
    assert float(picture.max()) > 1.2
    st.write_image(tmp_path / "target.png", picture, bits=16)
    target = st.read_image(tmp_path / "target.png")
    found = st.fit(wrong_start(truth), target, **PLAIN)
    assert found.left_out == int(np.count_nonzero(np.asarray(picture) >= 1 - 1e-5)) > 10
    assert found.counted + found.left_out == target.size
    assert errors(found.scene, truth)["light_position"] < 1e-5
    taken_for_true = np.minimum(target, 0.9999)
    naive = st.fit(wrong_start(truth), taken_for_true, max_steps=12, brightest=np.inf, **PLAIN)
    assert errors(naive.scene, truth)["light_position"] > 5e-3


def test_ones_count_below_brighter_pixels():
    picture = np.full((2, 2, 3), 0.5)
    picture[0, 0] = 1.0
    assert make_target(picture, np.dtype(np.float64)).counted == 9
    picture[1, 1] = 1.7
    assert make_target(picture, np.dtype(np.float64)).counted == 12


@pytest.mark.slow
@pytest.mark.parametrize(
    "solver",
    [
        optx.GaussNewton,
        optx.BFGS,
        *(pytest.param(s, marks=pytest.mark.slow) for s in (optx.Dogleg, optx.LevenbergMarquardt)),
    ],
)
def test_optimistix_solvers(solver):
    truth = with_random_colors(nine_spheres(LIGHT))
    target = st.render(truth, **SIZE, **PLAIN)
    start = eqx.tree_at(lambda s: s.spheres.color, truth, jnp.full((9, 3), 0.5))
    found = st.fit(start, target, free=("color",), solver=solver(rtol=1e-9, atol=1e-9), **PLAIN)
    assert found.converged
    np.testing.assert_allclose(found.scene.spheres.color, truth.spheres.color, atol=1e-8)


@pytest.mark.parametrize(
    "solver",
    [
        optx.OptaxMinimiser(optax.adam(0.03), 1e-6, 1e-6),
        pytest.param(optx.NelderMead(1e-4, 1e-4), marks=pytest.mark.slow),
    ],
)
def test_other_solvers(solver):
    truth, seen = three_apart([900.0, -400, 700]), dict(width=24, height=24, bounces=0)
    target = st.render(truth, **seen)
    start = eqx.tree_at(lambda s: s.spheres.ka, truth, truth.spheres.ka * 0.5)
    told = []
    with jax.numpy_dtype_promotion("standard"):  # as Optax needs it
        found = st.fit(
            start, target, free=("ka",), bounces=0, solver=solver, max_steps=400,
            callback=told.append,
        )  # fmt: skip
    assert found.converged and len(told) == found.steps
    assert found.cost < 1e-4
    np.testing.assert_allclose(found.scene.spheres.ka, truth.spheres.ka, atol=0.01)


def test_out_of_steps():
    truth = nine_spheres(LIGHT)
    target = st.render(truth, **SIZE, **PLAIN)
    found = st.fit(wrong_start(truth), target, max_steps=2, **PLAIN)
    assert not found.converged and found.steps == 2
    assert "maximum number of steps" in found.result_message
    with pytest.raises(RuntimeError, match="did not converge in 1 steps") as caught:
        st.fit(wrong_start(truth), target, max_steps=1, throw=True, **PLAIN)
    assert "root" not in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("solver", "got"),
    [
        ("lm", "'lm'"),
        (optx.Chord(1e-6, 1e-6), "a Chord"),
        (optx.Newton(1e-6, 1e-6), "a Newton"),
        (optx.FixedPointIteration(1e-6, 1e-6), "a FixedPointIteration"),
        (optx.BFGS, "the class BFGS in place of one of it"),
        (1e-6, "a float"),
    ],
)
def test_what_is_no_solver_of_fits_is_refused(solver, got):
    with pytest.raises(st.InputError, match="such as optimistix") as caught:
        check_solver(solver)
    assert str(caught.value).endswith(f", got {got}")


@pytest.mark.parametrize(
    "trace",
    [
        lambda fit, image: jax.jit(fit)(image),
        lambda fit, image: jax.vmap(fit)(image[None]),
        lambda fit, image: jax.grad(lambda x: fit(x).sum())(image),
        lambda fit, image: jax.jit(lambda x: fit(image) * x)(1.0),
        lambda fit, image: jax.lax.map(fit, image[None]),
        lambda fit, image: jax.eval_shape(fit, image),
    ],
)
def test_a_traced_fit_names_solution(trace):
    scene = nine_spheres(LIGHT)
    fit = lambda image: st.fit(scene, image, **PLAIN).scene.spheres.kd
    with pytest.raises(st.InputError, match=r"inside solution\(found.problem\)") as caught:
        trace(fit, jnp.full((4, 4, 3), 0.5))
    assert "\n" not in str(caught.value)
    traced = lambda light: fit_from(light, scene)
    with pytest.raises(st.InputError, match="solution"):
        jax.vmap(traced)(scene.lights.position[None])


def fit_from(light, scene):
    moved = eqx.tree_at(lambda s: s.lights.position, scene, light)
    return st.fit(moved, np.full((4, 4, 3), 0.5), mask=None, **PLAIN).scene.spheres.kd


def test_interrupted_fit():
    truth = nine_spheres(LIGHT)
    target = st.render(truth, **SIZE, **PLAIN)

    def stop(progress):
        if progress.step == 4:
            raise KeyboardInterrupt

    found = st.fit(wrong_start(truth), target, callback=stop, **PLAIN)
    assert found.interrupted and not found.converged and found.steps == 4
    residual = np.asarray(st.render(found.scene, **SIZE, **PLAIN) - target)
    np.testing.assert_allclose(0.5 * np.sum(residual**2), found.cost, rtol=1e-6)
    assert found.cost < found.costs[0] / 10


@pytest.mark.parametrize(
    ("target", "message"),
    [
        (np.zeros((4, 4, 2)), r"shape \(height, width, 3\), .* got \(4, 4, 2\)"),
        (np.zeros((0, 4, 3)), r"got \(0, 4, 3\)"),
        (np.full((4, 4, 3), np.nan), "48 numbers that are nan or inf"),
        (np.ones((4, 4, 3)), "every number of the target is clipped"),
        (np.full((4, 4, 3), 100, np.int32), "floating numbers, .*uint8 or uint16, got int32"),
    ],
)
def test_bad_targets(target, message):
    with pytest.raises(st.PictureError, match=message):
        st.fit(nine_spheres(), target)


@pytest.mark.parametrize("free", [(), ("colour",), ("color", "window"), ("ks", "ks")])
def test_bad_names(free):
    with pytest.raises(st.InputError, match=r"free parameter"):
        st.fit(nine_spheres(), np.zeros((4, 4, 3)), free=free)


def test_missing_lights_cannot_be_free():
    dark = st.Scene(nine_spheres().spheres, st.Lights(np.zeros((0, 3))))
    with pytest.raises(st.InputError, match="light_position is free, but the scene has no lights"):
        st.fit(dark, np.zeros((4, 4, 3)))


def test_unknowns_stand_for_valid_scenes():
    scene, free = (
        SCENES["glass"],
        (
            *("color", "ka", "ks", "exponent", "kt", "light_color", "light_position"),
            *("center", "radius", "theta", "phi", "mu", "distance"),
        ),
    )
    parameters = Parameters(scene, free)
    values = parameters.start()
    same, exposure = parameters.scene_at(values)
    assert (exposure == 1).all()
    assert all(
        np.allclose(a, b, rtol=1e-14)
        for a, b in zip(*map(jax.tree.leaves, (scene, same)), strict=True)
    )
    wild = jax.tree.map(lambda y: 3.7 * y - 2.2, values)
    valid, _ = parameters.scene_at(wild)
    s = valid.spheres
    for value in (s.color, s.ka, s.ks, s.kt):
        assert 0 <= value.min() and value.max() <= 1
    for value in (s.exponent, s.radius, valid.camera.mu, valid.camera.distance):
        assert value.min() > 0
    low, high = parameters.bounds()
    assert (
        (low["color"] == 0).all() and (high["color"] == 1).all() and (low["light_color"] == 0).all()
    )
    # no bounds, in numbers that `jax_debug_infs` bears
    most = np.finfo(np.float64).max
    assert (high["light_color"] == most).all() and (high["light_position"] == most).all()
    # two numbers turn a light, the third moves it away, at most to infinity
    assert (low["light_position"][:, :2] == -most).all()
    assert (low["light_position"][:, 2] > -most).all()
