"""Balls from masks: against discs and perspective outlines whose place is known."""

import numpy as np
import pytest

import spheretrace_jax as st
from spheretrace_jax.calibration.camera import Intrinsics, intrinsics_of
from spheretrace_jax.calibration.conic import make_outline, outline_distance, outline_of_ball


def depths(size, outline, fine=1):
    """Returns depths inside of an outline, at the centres of pixels or of parts of pixels."""
    y, x = (np.mgrid[: size[0] * fine, : size[1] * fine] + 0.5) / fine
    points = np.column_stack([x.ravel(), y.ravel()])
    return outline_distance(points, outline.numbers, outline.intrinsics)[0].reshape(x.shape)


def covered(size, outline, fine=6):
    inside = depths(size, outline, fine) >= 0
    return inside.reshape(size[0], fine, size[1], fine).mean((1, 3))


def random_circle(random, radius):
    size = (int(2 * radius + 14), int(2 * radius + 20))
    u, v = np.array(size[::-1]) / 2 + random.uniform(-3, 3, 2)
    return size, make_outline(u, v, radius + random.uniform(-0.5, 0.5), Intrinsics())


def errors_of(make, radius, trials):
    """Returns errors and deviations of masks of circles at random places."""
    random, errors, stds = np.random.default_rng(3), [], []
    for _ in range(trials):
        size, outline = random_circle(random, radius)
        found = st.ball_from_mask(make(size, outline, random))
        errors.append(found.numbers - outline.numbers)
        stds.append(found.std)
    return np.array(errors), np.array(stds)


def binary(size, outline, random):
    return depths(size, outline) >= 0


def grey(size, outline, random):
    noise = 0.03 * random.normal(size=size)
    return np.clip(covered(size, outline) + noise, 0, 1)


def wobbly(size, outline, random):
    """Makes a mask whose boundary strays smoothly by 0.3 pixels, as drawn by hand."""
    y, x = np.mgrid[: size[0], : size[1]] + 0.5
    turn = np.arctan2(y - outline.center[1], x - outline.center[0])[..., None] * np.arange(20)
    a, b = random.normal(size=(2, 20)) * 0.3 / np.sqrt(20)
    return depths(size, outline) + (a * np.cos(turn) + b * np.sin(turn)).sum(-1) >= 0


@pytest.mark.parametrize(
    ("make", "radius", "trials", "most"),
    [(binary, 30, 20, 0.01), (binary, 100, 8, 0.004), (grey, 30, 12, 0.006), (wobbly, 30, 12, 0.1)],
)
def test_accuracy_and_intervals(make, radius, trials, most):
    errors, stds = errors_of(make, radius, trials)
    assert np.sqrt((errors**2).mean()) < most
    assert np.abs(errors.mean(0)).max() < 3 * most / np.sqrt(trials)
    assert 0.85 <= (np.abs(errors) < 1.96 * stds).mean() <= 1
    assert stds.mean() < 2 * np.sqrt((errors**2).mean())


@pytest.mark.slow
@pytest.mark.parametrize("radius", [30, 100, 300])
def test_intervals_of_many_masks(radius):
    errors, stds = errors_of(binary, radius, 60)
    assert np.abs(errors).max() < 1.5 / radius
    assert 0.85 <= (np.abs(errors) < 1.96 * stds).mean() <= 0.99


@pytest.mark.parametrize("center", [(0.2, 0.1, 6.0), (2.5, -1.2, 3), (3.0, 2.2, 2.5)])
@pytest.mark.parametrize("make", [binary, grey])
def test_perspective_also_far_off_the_axis(center, make):
    size = (165, 200)
    camera = intrinsics_of(size, 50.0, (65.0, 70.0))
    outline = outline_of_ball(center, 1.0, camera)
    mask = make(size, outline, np.random.default_rng(0))
    found = st.ball_from_mask(mask, 50.0, (65.0, 70.0))
    assert np.abs(found.numbers - outline.numbers).max() < 0.15
    assert (np.abs(found.numbers - outline.numbers) < 4 * found.std).all()
    ball = found.ball()
    np.testing.assert_allclose(
        ball.center, center, atol=5 * np.sqrt(np.diag(ball.covariance)).max()
    )


def test_cut_by_the_border_with_holes_specks_and_bites():
    outline = make_outline(40.3, 31.8, 27.4, Intrinsics())
    mask = binary((50, 90), outline, None)  # cut at the bottom
    mask[30:33, 35:40] = False  # a hole
    mask[5:9, 80:85] = True  # a speck
    mask[10:18, 55:62] = False  # a bite
    found = st.ball_from_mask(mask)
    assert np.abs(found.numbers - outline.numbers).max() < 0.05
    half = st.ball_from_mask(binary((31, 90), outline, None))
    assert np.abs(half.numbers - outline.numbers).max() < 0.2
    assert half.std.max() > 2 * found.std.max()


def test_kinds_of_numbers_are_the_same_mask():
    outline = make_outline(21.2, 19.6, 13.3, Intrinsics())
    mask = binary((40, 42), outline, None)
    expected = st.ball_from_mask(mask).numbers
    for same in (255 * mask.astype(np.uint8), mask.astype(np.float32), np.stack([mask] * 3, -1)):
        np.testing.assert_array_equal(st.ball_from_mask(same).numbers, expected)
    share = covered((40, 42), outline)
    bits8, bits16 = ((share * top).round().astype(int) for top in (255, 65535))
    np.testing.assert_allclose(
        st.ball_from_mask(bits8).numbers, st.ball_from_mask(bits16).numbers, atol=1e-3
    )


@pytest.mark.parametrize(
    ("mask", "message"),
    [
        (np.zeros((20, 20), bool), "area of a ball with a boundary, found 0 pixels"),
        (np.ones((20, 20), bool), "area of a ball with a boundary, found 400 pixels"),
        (np.zeros((20, 20, 3)), "area of a ball"),
        (np.zeros(20), r"expected an array \(height, width\)"),
        (np.full((20, 20), -1.0), "numbers from 0 to 1"),
        (np.full((20, 20), np.nan), "numbers from 0 to 1"),
        (np.full((20, 20), 70000), "numbers from 0 to 1, 255 or 65535, got 70000"),
    ],
)
def test_what_is_no_mask(mask, message):
    with pytest.raises(st.InputError, match=message):
        st.ball_from_mask(mask)


def test_a_line_has_no_outline_of_a_ball():
    mask = np.zeros((60, 60), bool)
    mask[20:24] = True
    with pytest.raises(st.InputError, match="no outline of a ball"):
        st.ball_from_mask(mask)
