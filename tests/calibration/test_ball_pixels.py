"""Pixels of a ball: against rays and spheres one by one."""

import numpy as np
import pytest

from spheretrace_jax.calibration.ball_pixels import ball_hits, ball_pixels
from spheretrace_jax.calibration.camera import Intrinsics
from spheretrace_jax.calibration.conic import outline_distance, outline_of_ball

SIZE = (40, 60)
CENTERS = [(0.1, -0.2, 4.0), (2.5, 1, 5)]


@pytest.mark.parametrize("center", CENTERS)
def test_perspective(center):
    camera = Intrinsics(50.0, 28.0, 21.0)
    outline = outline_of_ball(center, 1.0, camera)
    found = ball_pixels(outline, SIZE)
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    d = np.stack([(columns + 0.5 - 28) / 50, (rows + 0.5 - 21) / 50, np.ones(SIZE)], -1)
    a, b, c = (d * d).sum(-1), d @ center, np.dot(center, center) - 1
    discriminant = b * b - a * c
    mask = discriminant >= 0
    assert (found.mask == mask).all() and mask.sum() > 100
    points = d[mask] * ((b - np.sqrt(np.where(mask, discriminant, 0))) / a)[mask][:, None]
    np.testing.assert_allclose(found.points, points, rtol=1e-10, atol=1e-7)
    np.testing.assert_allclose(found.normals, points - center, rtol=1e-7, atol=1e-7)
    views = -points / np.linalg.norm(points, axis=1, keepdims=True)
    np.testing.assert_allclose(found.views, views, rtol=1e-10, atol=1e-10)
    assert ((found.views * found.normals).sum(1) >= -1e-7).all()
    centers = np.column_stack([columns[mask], rows[mask]]) + 0.5
    depth = outline_distance(centers, outline.numbers, camera)[0]
    np.testing.assert_allclose(found.depth, depth)


def test_orthographic_and_cut_by_the_border():
    outline = outline_of_ball((-25.0, 15.0, 0), 12.0, Intrinsics(np.inf, 28.0, 21.0))
    found = ball_pixels(outline, SIZE)
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    x, y = (columns + 0.5 - 3) / 12, (rows + 0.5 - 36) / 12
    mask = x * x + y * y <= 1
    assert (found.mask == mask).all() and 150 < mask.sum() < 300
    z = -np.sqrt(1 - x[mask] ** 2 - y[mask] ** 2)  # the visible half is nearer
    np.testing.assert_allclose(found.normals, np.column_stack([x[mask], y[mask], z]), atol=1e-12)
    assert (found.views == [0, 0, -1]).all()


def test_margin_and_balls_outside_of_the_picture():
    outline = outline_of_ball((0.0, 0.0, 0), 12.0, Intrinsics(np.inf, 28.0, 21.0))
    everything, inner = ball_pixels(outline, SIZE), ball_pixels(outline, SIZE, margin=2.0)
    assert inner.depth.min() >= 2 and everything.depth.min() < 1
    assert (inner.depth == everything.depth[everything.depth >= 2]).all()
    outside = outline_of_ball((0.0, 500.0, 0), 12.0, Intrinsics(np.inf, 28.0, 21.0))
    assert not ball_pixels(outside, SIZE).mask.any()


@pytest.mark.parametrize("focal", [50.0, np.inf])
def test_rays_that_miss_get_the_normal_of_the_outline(focal):
    center = (0.4, 0.3, 3.0) if focal < np.inf else (8.0, 5.0, 0.0)
    radius = 1.0 if focal < np.inf else 9.0
    outline = outline_of_ball(center, radius, Intrinsics(focal, 28.0, 21.0))
    normals, views, hit = ball_hits(np.array([[56.0, 30.0], [35.0, 26.0]]), outline)
    assert hit.tolist() == [False, True]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    assert abs((normals * views).sum(1)[0]) < 1e-12
