"""Intervals of wrong models: how often they hold, and that those of right ones stay tight."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.wrong_models import START, TRUTH, WRONG, ball, drawn, moved

import spheretrace_jax as st

LIGHT = (500.0, 400, 700)


def noise_of(picture: np.ndarray, seed: int, size: float = 0.005) -> np.ndarray:
    """Returns noise of the ball alone; the background is black."""
    return size * np.random.default_rng(seed).standard_normal(picture.shape) * (picture > 0)


def axes_inside(found: st.Fit, truth, uncertainty) -> list[bool]:
    """Tells along which of two axes across its direction the light is inside of 95 %."""
    direction = np.asarray(truth) / np.linalg.norm(truth)
    across = jnp.asarray(np.linalg.svd(direction[None])[2][1:])
    off = lambda s: across @ (s.lights.position[0] / jnp.linalg.norm(s.lights.position[0]))
    return list(np.abs(np.asarray(off(found.scene))) <= 1.96 * uncertainty.of(off))


def test_a_right_model_has_the_intervals_of_white_noise():
    picture = drawn(TRUTH)
    found = st.fit(START, picture + noise_of(picture, 0), bounces=0)
    assert found.trust.ok and found.trust.grade == "exact"
    assert found.uncertainty.model_error.shape[1] == 0
    # black numbers, which are exact, do not make the noise smaller
    np.testing.assert_allclose(found.uncertainty.noise, 0.005, rtol=0.05)
    assert found.trust.effects == ()


@pytest.mark.slow
@pytest.mark.parametrize("kind", WRONG)
def test_a_wrong_model_has_wider_ones(kind):
    picture = WRONG[kind](LIGHT)
    found = st.fit(START, picture + noise_of(picture, 0), bounces=0)
    honest, white = found.uncertainty, found.uncertainty.white
    assert all(axes_inside(found, LIGHT, honest))
    degrees = [np.degrees(u.of_light(0, 0)[0]) for u in (honest, white)]
    assert 2 * degrees[1] < degrees[0] < 20
    assert found.trust.ok and found.trust.grade in ("good", "usable")
    assert "sphere 1" in found.trust.verdict and "explains 99." in found.trust.verdict
    assert f"light 1's direction by {degrees[0]:.2g} degrees" in str(found.trust)
    for name, deviation in honest.standard_deviations.items():
        assert (deviation >= white.standard_deviations[name]).all()
    np.testing.assert_allclose(
        np.sqrt(np.diag(honest.covariance))[-3:],
        honest.standard_deviations["light_position"][0], rtol=1e-3,
    )  # fmt: skip


def test_tolerance():
    picture = WRONG["texture"](LIGHT)
    found = st.fit(START, picture, bounces=0, tolerance=0.01)
    assert found.converged and not found.trust.ok and found.trust.grade == "not to be used"
    assert "does NOT explain" in found.trust.verdict and found.trust.effects == ()
    allowed = eqx.tree_at(lambda f: f.tolerance, found, 1.0)
    assert allowed.trust.grade == "good" and allowed.trust.unexplained == found.trust.unexplained
    for wrong in (0.0, -1.0, 1.5, np.nan):
        with pytest.raises(st.InputError, match="tolerance must be above 0 and at most 1"):
            st.fit(START, picture, bounces=0, tolerance=wrong)


def lights(count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    directions = rng.standard_normal((count, 3)) * [1, 1, 0.3] + [0, 0, 1]
    units = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return units * rng.uniform(400, 2000, (count, 1))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["right", *WRONG])
def test_coverage(kind):
    inside, narrow = [], []
    for k, light in enumerate(lights(60, 1)):
        picture = drawn(ball(light)) if kind == "right" else WRONG[kind](light)
        start = moved(ball(light))
        found = st.fit(start, picture + noise_of(picture, k), bounces=0)
        assert found.trust.ok
        inside += axes_inside(found, light, found.uncertainty)
        narrow += axes_inside(found, light, found.uncertainty.white)
    print(f"{kind}: {np.mean(inside):.2f} covered, {np.mean(narrow):.2f} by white noise alone")
    assert np.mean(inside) >= (0.85 if kind == "right" else 0.8)
    assert kind != "right" or np.mean(inside) <= 0.99
