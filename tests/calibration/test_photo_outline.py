"""Balls in photographs: against balls that this package draws."""

import numpy as np
import pytest
from scipy import ndimage

import spheretrace_jax as st
from spheretrace_jax.calibration.camera import Intrinsics
from spheretrace_jax.calibration.conic import outline_distance, outline_of_ball

SIZE = 112
FRONT, OBLIQUE, SIDE = (0.0, 0, 5000), (500.0, 700, 3000), (3000.0, 300, 500)


def draw(center, radius, light, background, ka=0.0, distance=400.0):
    """Draws a ball with exact edges. **Returns:** the picture and the ball's outline."""
    x, y = center
    ka, background = max(ka, 1e-6), max(background, 1e-6)  # one program for all pictures
    spheres = st.Spheres([[x, y, 0.0]], [radius], [[0.7, 0.6, 0.5]], ka=ka, kd=0.7, ks=0.3,
                         exponent=30.0)  # fmt: skip
    camera = st.Camera(-np.pi / 2, 0.0, distance, distance, float(SIZE))
    scene = st.Scene(spheres, st.Lights([light]), camera, antialias=1, background=[background] * 3)
    outline = outline_of_ball((x, -y, distance), radius, Intrinsics(distance, SIZE / 2, SIZE / 2))
    return np.array(st.render(scene, width=SIZE, height=SIZE), float), outline


@pytest.mark.parametrize(
    ("light", "background", "ka"),
    [
        (FRONT, 0.0, 0.0),
        (OBLIQUE, 0.0, 0.0),
        (OBLIQUE, 0.25, 0.0),
        (OBLIQUE, 0.0, 0.2),
        (SIDE, 0.0, 0.0),
        (SIDE, 0.25, 0.0),
    ],
)
def test_balls_are_found_and_intervals_hold(light, background, ka):
    random, errors, stds = np.random.default_rng(4), [], []
    for _ in range(3):
        picture, outline = draw(
            random.uniform(-18, 18, 2), random.uniform(18, 28), light, background, ka
        )
        picture += 0.005 * random.normal(size=picture.shape)
        found = st.ball_from_photo(picture, focal=400.0)
        errors.append(np.abs(found.numbers - outline.numbers))
        stds.append(found.std)
    assert np.max(errors) < 0.15
    assert np.mean(np.array(errors) < 1.96 * np.array(stds)) >= 0.75
    assert np.max(stds) < 0.15


def test_texture_blur_and_hints():
    picture, outline = draw((8.3, -6.1), 24.0, OBLIQUE, 0.3)
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    points = np.column_stack([x.ravel(), y.ravel()])
    outside = outline_distance(points, outline.numbers, outline.intrinsics)[0].reshape(x.shape) < 0
    random = np.random.default_rng(0)
    texture = ndimage.gaussian_filter(random.normal(size=(SIZE, SIZE)), 4)
    picture += 0.1 / texture.std() * (texture * outside)[..., None]
    for blur in (0.0, 1.2):
        blurred = ndimage.gaussian_filter(picture, (blur, blur, 0))
        noisy = blurred + 0.005 * random.normal(size=picture.shape)
        found = st.ball_from_photo(noisy, focal=400.0)
        assert np.abs(found.numbers - outline.numbers).max() < 0.3
    u, v, r = outline.numbers
    hinted = st.ball_from_photo(255 * noisy[..., 0], (u + 3, v - 3, r + 3), focal=400.0)
    assert np.abs(hinted.numbers - outline.numbers).max() < 0.3
    with pytest.raises(st.InputError, match="no outline near `near`"):
        st.ball_from_photo(picture, (10.0, 10.0, 5.0))


def test_large_pictures_are_searched_small():
    y, x = np.mgrid[:700, :900] + 0.5
    depth = 150.4 - np.hypot(x - 420.3, y - 333.8)
    picture = 0.1 + 0.5 * np.clip(depth + 0.5, 0, 1)
    picture += 0.01 * np.random.default_rng(0).normal(size=picture.shape)
    found = st.ball_from_photo(picture)
    np.testing.assert_allclose(found.numbers, [420.3, 333.8, 150.4], atol=0.03)


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        (np.zeros((60, 60, 3)), "no ball found in the picture: .* hardly an edge"),
        (np.random.default_rng(0).normal(size=(60, 60, 3)), "no ball found in the picture"),
        (np.add.outer(np.arange(60.0), np.zeros(60)) > 30, "no ball found in the picture"),
        (np.zeros((5, 60)), "at least 8 x 8 pixels"),
        (np.full((60, 60), np.nan), "expected finite numbers"),
    ],
)
def test_pictures_without_a_ball(picture, message):
    with pytest.raises(st.InputError, match=message):
        st.ball_from_photo(picture)
    with pytest.raises(st.InputError, match="near: expected"):
        st.ball_from_photo(np.zeros((60, 60)), near=(1.0, 2.0, -3.0))
