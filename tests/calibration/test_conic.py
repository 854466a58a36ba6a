"""The outline of a ball: against tangents of rays, and there and back."""

import numpy as np
import pytest

import spheretrace_jax as st
from spheretrace_jax.calibration.camera import Intrinsics, flip_frame, intrinsics_of
from spheretrace_jax.calibration.conic import (
    BallOutline,
    Ellipse,
    make_outline,
    outline_distance,
    outline_of_ball,
    outline_of_ellipse,
    outline_points,
)

#: On the axis; near and far off the axis (63 degrees); distant; large (reaches 80 degrees).
BALLS = [(0.0, 0, 5), (0.3, -0.2, 4), (4, -2.0, 2), (100, 50, 4000), (2.6, 0.3, 1.5)]
CAMERA = Intrinsics(800.0, 310.0, 250.0)
ANGLES = np.linspace(0, 2 * np.pi, 41)[:-1]


def rays(points):
    return np.column_stack([(points - [CAMERA.cx, CAMERA.cy]) / CAMERA.focal, np.ones(len(points))])


@pytest.mark.parametrize("center", BALLS)
def test_rays_through_the_outline_touch_the_ball(center):
    outline = outline_of_ball(center, 1.0, CAMERA)
    points = outline_points(outline, ANGLES)
    d = rays(points)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    nearest = np.linalg.norm(np.cross(d, center), axis=1)
    np.testing.assert_allclose(nearest, 1, rtol=0, atol=1e-11 * np.linalg.norm(center))
    assert ((d @ center) > 0).all()
    relative = points - outline.center
    np.testing.assert_allclose(np.cos(np.arctan2(relative[:, 1], relative[:, 0]) - ANGLES), 1)
    np.testing.assert_allclose(outline.center, 800 * np.array(center)[:2] / center[2] + (310, 250))


@pytest.mark.parametrize("center", BALLS)
def test_the_ellipse_is_the_outline(center):
    outline = outline_of_ball(center, 1.0, CAMERA)
    points, ellipse = outline_points(outline, ANGLES), outline.ellipse
    away = points - ellipse.center
    values = (away @ np.linalg.inv(ellipse.shape) * away).sum(1)
    np.testing.assert_allclose(values, 1, atol=1e-9)
    homogeneous = np.column_stack([points, np.ones(40)])
    values = (homogeneous @ ellipse.conic * homogeneous).sum(1)
    np.testing.assert_allclose(values, 0, atol=1e-7)
    # along the line to the principal point: tan(axis +- angular radius), half their difference
    ball = outline.ball()
    off = np.arccos(ball.direction[2])
    ends = 800 * np.tan(off + ball.angular_radius * np.array([-1, 1]))
    assert ellipse.axes[0] == pytest.approx(np.diff(ends)[0] / 2, rel=1e-9)
    if off > 0:
        along = np.array([np.cos(ellipse.angle), np.sin(ellipse.angle)])
        assert abs(along @ center[:2]) == pytest.approx(np.linalg.norm(center[:2]), rel=1e-6)


@pytest.mark.parametrize("center", BALLS)
def test_the_ball_of_the_outline(center):
    outline = outline_of_ball(np.array(center) * 3, 3.0, CAMERA)
    for found in (outline, outline_of_ellipse(outline.ellipse, CAMERA)):
        ball = found.ball()
        np.testing.assert_allclose(ball.center, center, rtol=1e-9)
        assert ball.distance == pytest.approx(np.linalg.norm(center))
        assert np.sin(ball.angular_radius) == pytest.approx(1 / np.linalg.norm(center))


def test_an_orthographic_outline_is_a_circle():
    outline = outline_of_ball((-30.0, 40, 7), 25.0, intrinsics_of((100, 200)))
    assert outline.center.tolist() == [70, 90] and outline.radius == 25
    np.testing.assert_allclose(outline.ellipse.shape, 625 * np.eye(2))
    found = outline_of_ellipse(outline.ellipse, outline.intrinsics)
    np.testing.assert_allclose(found.numbers, [70, 90, 25])
    ball = found.ball()
    np.testing.assert_allclose(ball.center, [-1.2, 1.6, 0])
    assert ball.orthographic and ball.angular_radius == 0 and ball.distance == np.inf
    # a long lens is nearly orthographic
    long = outline_of_ball((-30.0, 40, 1e8), 25.0, intrinsics_of((100, 200), 1e8))
    np.testing.assert_allclose(long.ellipse.center, [70, 90], atol=1e-9)
    np.testing.assert_allclose(outline_of_ellipse(long.ellipse, long.intrinsics).radius, 25)


@pytest.mark.parametrize("center", BALLS)
def test_distance_and_its_derivatives(center):
    outline = outline_of_ball(center, 1.0, CAMERA)
    edge = outline_points(outline, ANGLES)
    _, _, outward = outline_distance(edge, outline.numbers, CAMERA)
    tangents = np.roll(outline_points(outline, ANGLES + 1e-5), 0, 0) - edge
    assert abs((tangents * outward).sum(1)).max() < 1e-4 * np.linalg.norm(tangents, axis=1).max()
    for shift in (-0.1, 0.0, 0.1):
        distance, _, _ = outline_distance(edge - shift * outward, outline.numbers, CAMERA)
        np.testing.assert_allclose(distance, shift, atol=0.02 / outline.radius)
    _, derivatives, _ = outline_distance(edge, outline.numbers, CAMERA)
    for i, step in enumerate(1e-4 * np.eye(3)):
        more = outline_distance(edge, outline.numbers + step, CAMERA)[0]
        less = outline_distance(edge, outline.numbers - step, CAMERA)[0]
        np.testing.assert_allclose(derivatives[:, i], (more - less) / 2e-4, atol=1e-4)


@pytest.mark.parametrize("focal", [500.0, np.inf])
def test_deviations_are_those_of_samples(focal):
    camera = Intrinsics(focal, 320.0, 240.0)
    numbers = np.array([450.0, 120, 90])
    spread = np.array([[4.0, 1, 0.5], [1, 3, -0.4], [0.5, -0.4, 2]]) * 1e-4
    outline = BallOutline(numbers[:2], 90.0, spread, camera)
    samples = np.random.default_rng(0).multivariate_normal(numbers, spread, 2000)
    balls = [make_outline(*sample, camera).ball() for sample in samples]

    def check(covariance, values):
        expected = np.cov(np.transpose(values))
        np.testing.assert_allclose(covariance, expected, atol=0.1 * abs(expected).max())

    ball = outline.ball()
    check(ball.covariance, [b.center for b in balls])
    check(ball.direction_covariance, [b.direction for b in balls])
    assert ball.angular_radius_std == pytest.approx(
        np.std([b.angular_radius for b in balls]), rel=0.08
    )
    ellipses = [make_outline(*sample, camera).ellipse for sample in samples]
    shapes = [e.shape[[0, 0, 1], [0, 1, 1]] for e in ellipses]
    check(outline.ellipse.covariance[:2, :2], [e.center for e in ellipses])
    check(outline.ellipse.covariance[2:, 2:], shapes)
    back = outline_of_ellipse(outline.ellipse, camera)
    np.testing.assert_allclose(back.covariance, spread, atol=1e-9)


def test_another_camera_sees_the_same_outline():
    outline = outline_of_ball((4.0, -2, 6), 1.0, CAMERA)
    ball = outline.ball(focal=1600.0)
    again = outline_of_ball(ball.center, 1.0, Intrinsics(1600.0, 310.0, 250.0))
    # the outline is that of a ball before the first camera only, so the ellipse is nearly the same
    np.testing.assert_allclose(again.ellipse.center, outline.ellipse.center, atol=2)
    assert np.linalg.det(again.ellipse.shape) == pytest.approx(
        np.linalg.det(outline.ellipse.shape), rel=0.02
    )
    assert outline.ball(focal=np.inf).orthographic


def test_circles_by_hand():
    outline = outline_of_ellipse(Ellipse.circle(330.0, 200.0, 40.0, std=0.5), Intrinsics())
    np.testing.assert_allclose(outline.numbers, [330, 200, 40])
    np.testing.assert_allclose(outline.covariance, 0.25 * np.eye(3), atol=1e-8)


def test_frames():
    vectors = np.array([[1.0, 2, 3], [0, -1, -1]])
    assert flip_frame(vectors).tolist() == [[1, -2, -3], [0, 1, 1]]
    assert (flip_frame(flip_frame(vectors)) == vectors).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Intrinsics(-5.0), "focal: expected a positive length"),
        (lambda: Intrinsics(np.nan), "focal: expected a positive length"),
        (lambda: Intrinsics(5.0, np.inf), "principal_point: expected two finite"),
        (lambda: outline_of_ball((0, 0, 0.5), 1.0, CAMERA), "a ball before the camera"),
        (lambda: make_outline(0, 0, 900.0, CAMERA), "radius: expected 0 < radius < focal"),
        (lambda: Ellipse.circle(1.0, 2.0, 0.0), "radius: expected a positive"),
        (
            lambda: outline_of_ellipse(Ellipse.circle(5e3, 0.0, 4900.0), CAMERA),
            "no ball before a camera",
        ),
    ],
)
def test_what_is_no_ball(make, message):
    with pytest.raises(st.InputError, match=message):
        make()
