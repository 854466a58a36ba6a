"""Noise that grows with brightness, estimated from the picture alone."""

import jax
import numpy as np
import pytest
from helpers.wrong_models import START, drawn, texture

import spheretrace_jax as st
from spheretrace_jax.fit.model.photo_noise import PhotoNoise, estimate_photo_noise
from spheretrace_jax.fit.model.target import make_target


def shaded(size: int = 120) -> np.ndarray:
    x, y = np.meshgrid(*[np.linspace(-1, 1, size)] * 2)
    return np.clip(0.8 * np.exp(-(x**2) - y**2), 0, 1)[..., None] * [1, 0.7, 0.4]


def noisy(picture: np.ndarray, constant: float, slope: float, seed: int) -> np.ndarray:
    deviation = np.sqrt(constant + slope * picture)
    return picture + deviation * np.random.default_rng(seed).standard_normal(picture.shape)


@pytest.mark.parametrize(
    ("constant", "slope"), [(1e-4, 0.0), (1e-5, 1e-3), (0.0, 4e-4), (4e-4, 4e-4)]
)
def test_is_found(constant, slope):
    picture = shaded()
    found = estimate_photo_noise(noisy(picture, constant, slope, 0), np.full(picture.shape, True))
    expected = PhotoNoise(constant, slope)
    for level in (0.1, 0.4, 0.7):
        np.testing.assert_allclose(found.deviation(level), expected.deviation(level), rtol=0.06)


def test_shading_and_edges_are_no_noise():
    picture = shaded()
    picture[:, 50:] *= 0.5
    found = estimate_photo_noise(noisy(picture, 1e-6, 1e-5, 1), np.full(picture.shape, True))
    np.testing.assert_allclose(found.deviation(0.5), np.sqrt(6e-6), rtol=0.15)
    exact = estimate_photo_noise(picture, np.full(picture.shape, True))
    assert 0 < exact.deviation(0.5) < 5e-4


def test_black_backgrounds_and_masks():
    picture = noisy(shaded(), 1e-4, 0.0, 2)
    counts = np.full(picture.shape, True)
    counts[:40] = False
    picture[:40] = 100 * np.random.default_rng(0).uniform(size=(40, 120, 3))
    picture[100:] = 0
    found = estimate_photo_noise(picture, counts)
    np.testing.assert_allclose(found.deviation(0.3), 1e-2, rtol=0.06)


def test_weights_follow():
    picture = noisy(shaded(), 1e-4, 1e-3, 3)
    target = make_target(picture, np.dtype(np.float64), noise="photo")
    estimated = estimate_photo_noise(picture, np.asarray(target.weight) > 0)
    np.testing.assert_allclose(target.weight, 1 / estimated.deviation(picture))
    np.testing.assert_allclose(target.photo_noise, estimated)


def test_bad_words():
    with pytest.raises(st.InputError, match="noise must hold numbers or be \"photo\", got 'film'"):
        make_target(shaded(), np.dtype(np.float64), noise="film")
    with pytest.raises(st.PictureError, match='noise "photo" needs 64 numbers'):
        make_target(shaded(4), np.dtype(np.float64), noise="photo")


@pytest.mark.slow
def test_fit():
    picture = noisy(drawn(START, width=96, height=96), 1e-5, 1e-4, 4)
    found = st.fit(START, picture, noise="photo", bounces=0)
    (noise,) = found.photo_noise
    np.testing.assert_allclose(noise.deviation(0.4), np.sqrt(5e-5), rtol=0.2)
    assert found.noise_given and "noise of variance" in str(found.trust) and found.trust.ok
    # residuals are about as large as the noise
    np.testing.assert_allclose(2 * found.cost / found.counted, 1, atol=0.3)
    jax.tree.leaves(found)  # a tree, whatever the noise
    assert st.fit(START, texture((100.0, 100, 900)), bounces=0, max_steps=1).photo_noise == []
