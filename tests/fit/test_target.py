"""Targets: masks, weights, noise, clipping, losses and the exposure."""

import equinox as eqx
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from helpers.scenes import nine_spheres

import spheretrace_jax as st
from spheretrace_jax.fit.fit import DEFAULT_FREE
from spheretrace_jax.fit.model.parameters import bounding_sphere
from spheretrace_jax.fit.model.products import determined_products
from spheretrace_jax.fit.model.target import Target, make_target
from spheretrace_jax.fit.problem.make_problem import make_problem
from spheretrace_jax.fit.problem.problem import Problem, normal_at
from spheretrace_jax.study.benchmarks.wrong_start import wrong_start

PLAIN = dict(bounces=0, samples=1)
SIZE = dict(width=64, height=64)  # of all fits, so that few are compiled
DOUBLE = np.dtype(np.float64)


def colored(scene: st.Scene, seed: int = 0) -> st.Scene:
    """Returns the scene with random colours, so that every channel shows every sphere."""
    color = np.random.default_rng(seed).uniform(0.2, 0.9, scene.spheres.color.shape)
    return eqx.tree_at(lambda s: s.spheres.color, scene, jnp.asarray(color))


TRUTH = colored(nine_spheres((100.0, 500, 800)))
START = wrong_start(TRUTH)


@pytest.fixture(scope="module")
def picture() -> np.ndarray:
    return np.asarray(st.render(TRUTH, **SIZE, **PLAIN))


@pytest.fixture(scope="module")
def noisy(picture) -> np.ndarray:
    return picture + 0.01 * np.random.default_rng(1).standard_normal(picture.shape)


@pytest.fixture(scope="module")
def mask_4_5() -> np.ndarray:
    """Returns a mask of four pixels in five."""
    return np.random.default_rng(2).uniform(size=(64, 64)) < 0.8


def test_box_means():
    image = jnp.arange(7 * 6 * 3.0).reshape(7, 6, 3)
    weight = jnp.ones((7, 6, 3)).at[0, 5].set(0)
    boxes = Target(image, weight, jnp.ones(()), "square").box_means(3)
    assert {tuple(map(int, at)) for at in np.argwhere(np.asarray(boxes.counts))} == {
        (1, 1), (4, 1), (4, 4)  # the box at (1, 4) holds a pixel that does not count
    }  # fmt: skip
    np.testing.assert_allclose(boxes.image[4, 1], image[3:6, 0:3].mean((0, 1)))
    # as much as nine pixels with the same residual
    np.testing.assert_array_equal(boxes.weight[4, 1], 3)


@pytest.fixture
def unchecked():
    """Disables the tests' type checks, which refuse a wrong word before the user's message."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def fit(target, **settings) -> st.Fit:
    return st.fit(START, target, **settings, **PLAIN)


def problem_of(target, **counts) -> Problem:
    return make_problem(START, target, DEFAULT_FREE, bounces=0, **counts)


def normal_of(target, **counts):
    """Returns the normal equations at the start."""
    problem = problem_of(target, **counts)
    return normal_at(problem, problem.start())


def light_error(found: st.Scene) -> float:
    """Returns the light's error, as a part of its distance from the middle of the spheres."""
    middle, _ = bounding_sphere(TRUTH)
    off = found.lights.position - TRUTH.lights.position
    return float(jnp.linalg.norm(off) / jnp.linalg.norm(TRUTH.lights.position - middle[None]))


def product_error(found: st.Scene) -> float:
    """Returns the largest error of ka color and kd color, as a part of each one's largest."""
    pairs = [
        (determined_products(s)["ka*color"], determined_products(s)["kd*color"])
        for s in (found, TRUTH)
    ]
    return max(float(np.abs(a - b).max() / b.max()) for a, b in zip(*pairs, strict=True))


def assert_close(normal, other, rtol: float) -> None:
    """Checks that normal equations agree, in units of their columns' lengths."""
    scale = np.sqrt(np.diag(np.asarray(other.square)))
    size = float(jnp.sqrt(2 * other.cost))
    both = np.outer(scale, scale)
    np.testing.assert_allclose(normal.square / both, other.square / both, atol=rtol)
    for a, b in ((normal.gradient, other.gradient),):
        np.testing.assert_allclose(a / (scale * size), b / (scale * size), atol=rtol)
    np.testing.assert_allclose(normal.cost, other.cost, rtol=rtol)


# masks, weights, noise


@pytest.mark.parametrize("channels", [False, True], ids=["pixels", "numbers"])
def test_masked_numbers_change_nothing(noisy, mask_4_5, channels):
    mask = mask_4_5
    if channels:
        mask = np.random.default_rng(3).uniform(size=noisy.shape) < 0.8
    garbage = np.random.default_rng(4).choice([np.nan, np.inf, -1e30, 7.0], noisy.shape)
    broken = np.where(mask if channels else mask[..., None], noisy, garbage)
    clean, found = (fit(target, mask=mask) for target in (noisy, broken))
    assert found.converged and found.costs == clean.costs
    assert eqx.tree_equal(found.scene, clean.scene)
    assert found.left_out == clean.left_out == np.count_nonzero(~mask) * (1 if channels else 3)
    assert light_error(found.scene) < 0.01


def test_mask_and_its_complement(noisy, mask_4_5):
    """Checks that the masked picture and the rest of it add up."""
    whole, inside, outside = (normal_of(noisy, mask=m) for m in (None, mask_4_5, ~mask_4_5))
    assert float(inside.cost) < 0.9 * float(whole.cost)
    added = eqx.tree_at(
        lambda n: (n.square, n.gradient, n.cost),
        inside,
        (
            inside.square + outside.square,
            inside.gradient + outside.gradient,
            inside.cost + outside.cost,
        ),
    )
    assert_close(added, whole, 1e-13)


def test_weight_2_counts_twice(noisy, mask_4_5):
    once = normal_of(noisy)
    twice = normal_of(noisy, weights=2.0)
    doubled = eqx.tree_at(
        lambda n: (n.square, n.gradient, n.cost),
        once,
        (2 * once.square, 2 * once.gradient, 2 * once.cost),
    )
    assert_close(twice, doubled, 1e-13)
    # some of it twice
    part = normal_of(noisy, mask=mask_4_5)
    partly = normal_of(noisy, weights=np.where(mask_4_5, 2.0, 1.0))
    both = eqx.tree_at(
        lambda n: (n.square, n.gradient, n.cost),
        once,
        (once.square + part.square, once.gradient + part.gradient, once.cost + part.cost),
    )
    assert_close(partly, both, 1e-13)


def test_weight_0_is_a_mask(noisy, mask_4_5):
    masked = problem_of(noisy, mask=mask_4_5)
    broken = np.where(mask_4_5[..., None], noisy, np.nan)
    weighted = problem_of(broken, weights=mask_4_5.astype(float))
    assert eqx.tree_equal(weighted, masked)


def test_cost_in_units_of_noise(picture, noisy):
    plain, known = fit(noisy), fit(noisy, noise=0.01)
    np.testing.assert_allclose(known.costs[0], plain.costs[0] / 1e-4, rtol=1e-12)
    np.testing.assert_allclose(known.cost, plain.cost / 1e-4, rtol=1e-9)
    # half of one for each number that is not taken up by a parameter, give or take 3 sigma
    free = noisy.size - known.identifiability.rank
    np.testing.assert_allclose(2 * known.cost / free, 1, atol=3 * np.sqrt(2 / free))
    # of numbers with more noise residuals of 1 are larger
    noise = np.full(picture.shape, 0.01)
    noise[:, :32] = 0.1
    mixed = normal_of(noisy, noise=noise)
    weighted = normal_of(noisy, weights=1 / noise**2)
    assert_close(mixed, weighted, 1e-13)


def test_deviations_scale_with_noise(noisy):
    small, large = (fit(noisy, noise=s).uncertainty for s in (0.01, 0.1))
    assert small.noise == large.noise == 1
    for name, spread in small.standard_deviations.items():
        other = large.standard_deviations[name]
        assert (np.isfinite(other) == np.isfinite(spread)).all()
        known = np.isfinite(spread)
        np.testing.assert_allclose(other[known], 10 * spread[known], rtol=1e-6)
    assert np.isfinite(small.standard_deviations["light_position"]).all()
    # estimated from what is left, it is what was given
    guessed = fit(noisy).uncertainty
    np.testing.assert_allclose(guessed.noise, 0.01, rtol=0.03)


def test_deviations_of_many_fits(picture):
    """Checks the light's over 40 noises; an estimate from 40 is good to 11 %."""
    rng = np.random.default_rng(5)
    fits = [
        fit(picture + 0.003 * rng.standard_normal(picture.shape), noise=0.003) for _ in "x" * 40
    ]
    positions = np.stack([f.scene.lights.position for f in fits])
    spread = np.stack([f.uncertainty.standard_deviations["light_position"] for f in fits[:1]])
    np.testing.assert_allclose(positions.std(0, ddof=1) / spread[0], 1, atol=0.35)


# clipping


@pytest.mark.slow
def test_under_exposed_numbers(picture):
    crushed = np.where(picture <= 0.05, 0.0, picture)
    dark = np.count_nonzero(crushed <= 0.05)
    found = fit(crushed, darkest=0.05)
    assert found.left_out == dark > 1000
    assert found.counted == picture.size - dark
    assert found.converged and light_error(found.scene) < 1e-8
    naive = fit(crushed)
    assert naive.left_out == 0 and light_error(naive.scene) > 1e-3


def test_darkest_0(picture):
    black = np.count_nonzero(picture == 0)
    left_out = picture.size - problem_of(picture, darkest=0.0).targets[0].counted
    assert left_out == black > 1000


def test_saturated_numbers_with_mask(picture, mask_4_5):
    clipped = np.minimum(1.6 * picture, 1.0)
    bright = clipped == 1
    start = eqx.tree_at(lambda s: s.lights.color, START, jnp.asarray([[1.6] * 3]))
    # what is masked out may be brighter than 1: the picture is clipped all the same
    target = np.where(mask_4_5[..., None], clipped, 9.0)
    found = st.fit(start, target, mask=mask_4_5, **PLAIN)
    assert found.left_out == np.count_nonzero(bright | ~mask_4_5[..., None])
    assert np.count_nonzero(bright & mask_4_5[..., None]) > 20
    assert found.converged and light_error(found.scene) < 1e-8


# losses


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_robust_residuals(loss, dtype):
    k = {"huber": 1.345, "cauchy": 2.385}[loss]
    noise = 0.02
    x = np.concatenate([[0, 1e-170, 1e-30, 1e-24, 1e-9], np.geomspace(1e-4, 1e4, 91), [1.0]])
    r = np.concatenate([-x[::-1], x]) * k * noise
    target, one = _target_of_zeros(r.size, loss, noise, dtype), jnp.ones(3, dtype)
    shown = jnp.asarray(np.repeat(r, 3).reshape(1, -1, 3), dtype)
    residual = np.asarray(target.residual(shown, one), np.float64)[0, :, 0]
    x = np.abs(r) / (k * noise)
    rho, force = {
        "huber": (np.where(x <= 1, x**2 / 2, x - 0.5), np.sign(r) * np.minimum(x, 1)),
        "cauchy": (np.log1p(x**2) / 2, np.sign(r) * x / (1 + x**2)),
    }[loss]
    scale = k * noise
    rtol = 1e-13 if dtype == np.float64 else 2e-6
    tiny = 10 * float(np.finfo(dtype).tiny)  # whose squares may be 0
    np.testing.assert_allclose(residual**2 / 2, scale**2 * rho, rtol=rtol, atol=tiny)
    assert (np.sign(residual) == np.sign(shown[0, :, 0])).all()
    # of the slopes, too: residual residual' = rho'
    slope = np.asarray(target.slopes(shown, one)[0], np.float64)[0, :, 0]
    assert np.isfinite(slope).all()
    np.testing.assert_allclose(residual * slope, scale * force, rtol=rtol, atol=tiny)
    np.testing.assert_array_equal(slope[x < 1e-8], 1)


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_robust_slopes_are_continuous(loss):
    target = _target_of_zeros(3, loss, 1.0, np.float64)
    k = {"huber": 1.345, "cauchy": 2.385}[loss]
    for place in (0.0, k, -k, 1e-8 * k):
        shown = np.repeat(np.array([place - 1e-9, place, place + 1e-9]), 3).reshape(1, 3, 3)
        slope, _ = target.slopes(jnp.asarray(shown), jnp.ones(3))
        assert np.ptp(np.asarray(slope)) < 3e-9


def test_slopes_by_exposure(noisy):
    target = make_target(noisy, DOUBLE, noise=0.01, loss="cauchy")
    exposure = jnp.asarray([0.8, 1.0, 1.3])
    shown = jnp.asarray(noisy) * 1.01
    by_picture, by_exposure = target.slopes(shown, exposure)
    h = 1e-6
    apart = [
        (target.residual(shown, exposure + h * e) - target.residual(shown, exposure - h * e))[
            ..., c
        ]
        / (2 * h)
        for c, e in enumerate(jnp.eye(3))
    ]
    largest = float(jnp.abs(by_exposure).max())
    np.testing.assert_allclose(by_exposure, np.stack(apart, -1), atol=1e-8 * largest)
    np.testing.assert_allclose(
        by_picture * shown, by_exposure * exposure[None, None], atol=1e-13 * largest
    )


def _target_of_zeros(width: int, loss: str, noise: float, dtype) -> Target:
    """Makes a black target whose weighted residuals have a known noise."""
    target = make_target(np.zeros((1, width, 3)), np.dtype(dtype), loss=loss)
    return eqx.tree_at(lambda t: t.noise, target, jnp.asarray(noise, dtype))


def spoiled(picture: np.ndarray, folder, seed: int) -> np.ndarray:
    """Returns the picture in 8 bits, with a tenth of its pixels random."""
    st.write_image(folder / "target.png", picture, bits=8)
    rng = np.random.default_rng(seed)
    bad = rng.uniform(size=picture.shape[:2]) < 0.1
    eight = st.read_image(folder / "target.png")
    return np.where(bad[..., None], rng.uniform(size=picture.shape), eight)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_robust_losses_with_outliers(picture, tmp_path, loss, seed):
    found = fit(spoiled(picture, tmp_path, seed), loss=loss)
    assert found.converged
    assert light_error(found.scene) < 0.005
    assert product_error(found.scene) < 0.01


def test_square_loss_with_outliers(picture, tmp_path):
    found = fit(spoiled(picture, tmp_path, 0))
    assert light_error(found.scene) > 10 * 0.005
    assert product_error(found.scene) > 10 * 0.01


def test_noise_estimate():
    """Checks that neither a black background without noise nor outliers change the estimate."""
    rng = np.random.default_rng(6)
    shown = np.zeros((50, 50, 3))
    shown[10:30, 10:30] = rng.uniform(0.2, 0.8, (20, 20, 3))  # a sixth of the picture
    image = shown + 0.01 * rng.standard_normal(shown.shape) * (shown > 0)
    bad = rng.uniform(size=(50, 50)) < 0.1
    image[bad] = rng.uniform(size=(np.count_nonzero(bad), 3))
    image[0, 0], image[20, 20] = 1e6, 1e5
    target = make_target(image, DOUBLE, loss="huber")
    noise = float(target.with_estimated_noise(jnp.asarray(shown), jnp.ones(3)).noise)
    # a tenth of outliers shifts the median to the 56th percentile of the others: by 13 %
    np.testing.assert_allclose(noise, 1.13 * 0.01, rtol=0.1)
    # as seen through the exposure, and in units of the weights
    target = make_target(image, DOUBLE, weights=9.0, loss="huber")
    other = float(target.with_estimated_noise(jnp.asarray(shown) / 2, jnp.full(3, 2.0)).noise)
    np.testing.assert_allclose(other, 3 * noise, rtol=1e-12)


@pytest.mark.parametrize("shown", [0.0, 0.5])
def test_noise_is_never_0(shown):
    """Checks targets that fit exactly, black ones too."""
    picture = jnp.full((4, 4, 3), shown)
    target = make_target(np.asarray(picture), DOUBLE, loss="cauchy")
    assert float(target.with_estimated_noise(picture, jnp.ones(3)).noise) > 0


# exposure


def test_exposure(picture):
    exposure = np.array([0.7, 1.1, 1.3])
    start = eqx.tree_at(lambda s: s.lights.position, TRUTH, START.lights.position)
    found = st.fit(start, picture * exposure, free=("exposure", "light_position"), **PLAIN)
    assert found.converged
    np.testing.assert_allclose(found.exposure, exposure, rtol=1e-8)
    assert light_error(found.scene) < 1e-8
    assert found.identifiability.undetermined == ()


# mistakes

SMALL = np.full((4, 5, 3), 0.5)


@pytest.mark.parametrize(
    ("counts", "message"),
    [
        (dict(mask=np.ones((5, 4), bool)), r"mask must .* target's shape \(4, 5, 3\).* \(5, 4\)"),
        (dict(mask=np.ones((4, 5, 2), bool)), r"mask must .* got shape \(4, 5, 2\)"),
        (dict(mask=np.full((4, 5), 1.5)), "mask must hold yes and no: bool, numbers from 0 to 1"),
        (dict(mask=np.full((4, 5), -1)), "mask must hold yes and no: bool, numbers from 0 to 1"),
        (dict(mask=np.zeros((4, 5), bool)), "no number of the target counts"),
        (dict(weights=-1.0), "weights must be finite and at least 0"),
        (dict(weights=np.full((4, 5), np.nan)), "weights must be finite and at least 0"),
        (dict(weights=np.inf), "weights must be finite and at least 0"),
        (dict(weights=np.ones(3)), r"weights must .* got shape \(3,\)"),
        (dict(weights=np.full((4, 5), "1")), "weights must hold numbers, got <U1"),
        (dict(weights=0.0), "no number of the target counts"),
        (dict(noise=0.0), "noise must be finite and greater than 0"),
        (dict(noise="film"), "noise must hold numbers or be .photo., got 'film'"),
        (dict(noise=-0.1), "noise must be finite and greater than 0"),
        (dict(noise=np.full((4, 5, 3), np.nan)), "noise must be finite and greater than 0"),
        (dict(darkest=0.5), "no number of the target counts"),
        (dict(darkest=np.nan), "darkest must be a number, got nan"),
        (dict(loss="l1"), "loss must be one of square, huber, cauchy, got 'l1'"),
        (dict(gauge="kd"), "gauge must be one of ka, color, none, got 'kd'"),
        (dict(start="nothing"), "start must be one of scene, lights, auto, got 'nothing'"),
    ],
)
def test_mistakes(unchecked, counts, message):
    with pytest.raises(st.InputError, match=message) as caught:
        fit(SMALL, **counts)
    assert "\n" not in str(caught.value)


def test_counted_numbers_are_finite():
    broken = SMALL.copy()
    broken[0, 0], broken[1, 1, 1] = np.nan, np.inf
    mask = np.full((4, 5), True)
    mask[0, 0] = False
    with pytest.raises(st.PictureError, match="must be finite, got 1 numbers that are nan or inf"):
        make_target(broken, DOUBLE, mask=mask)
    mask[1, 1] = False
    assert make_target(broken, DOUBLE, mask=mask).counted == 54


# --- smaller pictures -----------------------------------------------------------------------------


def test_a_smaller_target_holds_the_means_of_its_boxes():
    image = np.random.default_rng(0).uniform(0.1, 0.9, (4, 6, 3))
    image[0, 0, 1], image[3, 5] = 1, 0.01
    mask = np.full((4, 6), True)
    mask[0, 3] = False
    whole = make_target(image, DOUBLE, mask=mask, darkest=0.05)
    target = make_target(image, DOUBLE, mask=mask, darkest=0.05, shrink=2)
    means = image.reshape(2, 2, 3, 2, 3).mean((1, 3))
    counts = np.full((2, 3, 3), True)
    counts[0, 0, 1] = counts[0, 1] = counts[1, 2] = False  # clipped, masked, dark
    np.testing.assert_array_equal(np.asarray(target.weight) > 0, counts)
    np.testing.assert_allclose(np.asarray(target.image)[counts], means[counts], rtol=1e-14)
    np.testing.assert_allclose(np.asarray(target.weight)[counts], 1, rtol=1e-14)
    assert whole.counted == 4 * 6 * 3 - 1 - 3 - 3


def test_the_noise_of_a_mean_is_less():
    image = np.full((2, 4, 3), 0.5)
    noise = np.array([[1.0, 1, 3, 3], [1, 1, 4, 4]])
    target = make_target(image, DOUBLE, noise=noise, shrink=2)
    expected = [2, 4 / np.sqrt(9 + 9 + 16 + 16)]
    np.testing.assert_allclose(target.weight[0, :, 0], expected, rtol=1e-12)
    weighted = make_target(image, DOUBLE, weights=9.0, shrink=2)
    np.testing.assert_allclose(weighted.weight, 3, rtol=1e-12)


@pytest.mark.parametrize(
    ("shape", "shrink", "said"),
    [
        ((4, 6, 3), 3, "shrink must divide width and height of 6 x 4 pixels, such as 2; got 3"),
        ((4, 6, 3), 0, "such as 2; got 0"),
        ((5, 6, 3), 2, "shrink must divide width and height of 6 x 5 pixels, but none does; got 2"),
    ],
)
def test_sides_that_do_not_divide_a_picture_are_named(shape, shrink, said):
    with pytest.raises(st.InputError) as error:
        make_target(np.full(shape, 0.5), DOUBLE, shrink=shrink)
    assert said in str(error.value)


def test_a_picture_of_which_no_box_counts_whole_is_refused():
    mask = np.indices((4, 4)).sum(0) % 2 == 0
    with pytest.raises(st.PictureError, match="no box of 2 x 2 pixels counts"):
        make_target(np.full((4, 4, 3), 0.5), DOUBLE, mask=mask, shrink=2)


@pytest.mark.slow
def test_a_fit_of_a_smaller_picture():
    """Fits means of 2 x 2 rays to means of 2 x 2 pixels, which are the same numbers."""
    large = np.asarray(st.render(TRUTH, width=128, height=128, **PLAIN))
    found = st.fit(START, large, shrink=2, samples=2, bounces=0)
    assert found.problem.targets[0].image.shape == (64, 64, 3) and found.trust.ok
    assert light_error(found.scene) < 1e-7
    assert product_error(found.scene) < 1e-7
