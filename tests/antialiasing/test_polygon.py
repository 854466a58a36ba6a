"""Polygon clipping: common areas of half-planes in a pixel: counting, limits, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as strategy

from spheretrace_jax.antialiasing import coverage, polygon
from spheretrace_jax.antialiasing.polygon import HalfPlane
from spheretrace_jax.tracing.differential import differential

clipped_area = jax.jit(polygon.clipped_area)
FLOATS = pytest.mark.parametrize("dtype", [np.float32, np.float64])

# 400 x 400 points in the pixel
X, Y = np.meshgrid(*[(np.arange(400) + 0.5) / 400 - 0.5] * 2)


def at_angles(angle, offset, dtype=np.float64) -> HalfPlane:
    angle, offset = np.asarray(angle), np.asarray(offset)
    return HalfPlane(*(jnp.asarray(v, dtype) for v in (np.cos(angle), np.sin(angle), offset)))


def random_half_planes(count: int, n: int = 100, dtype=np.float64) -> list[HalfPlane]:
    rng = np.random.default_rng(count)
    draw = lambda: at_angles(rng.uniform(0, 2 * np.pi, n), rng.uniform(-0.6, 0.6, n), dtype)
    return [draw() for _ in range(count)]


def inside(half_planes: list[HalfPlane]) -> np.ndarray:
    """Returns, for each pixel, which of the 400 x 400 points are in all half-planes."""
    wide = lambda v: np.asarray(v, float)[:, None, None]
    each = [wide(h.right) * X + wide(h.down) * Y + wide(h.offset) > 0 for h in half_planes]
    return np.all(each, axis=0)


@FLOATS
@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_counted_areas(count, dtype):
    half_planes = random_half_planes(count, dtype=dtype)
    area = clipped_area(*half_planes)
    assert area.dtype == dtype
    np.testing.assert_allclose(area, inside(half_planes).mean((1, 2)), atol=1e-3)


def test_centroid():
    half_planes = random_half_planes(3)
    within = inside(half_planes)
    area = within.mean((1, 2))
    found = polygon.clip_pixel(*half_planes)
    large = area > 0.02
    assert large.sum() > 20
    for middle, coordinate in ((found.x, X), (found.y, Y)):
        mean = (within * coordinate).mean((1, 2))[large] / area[large]
        np.testing.assert_allclose(middle[large], mean, atol=3e-3)
    np.testing.assert_array_equal(found.x[area == 0], 0)


@FLOATS
@pytest.mark.parametrize("turn", [0, 1e-16, 1e-12, 1e-9, 1e-7, 1e-5, 1e-3])
def test_nearly_equal_and_opposite_lines(turn, dtype):
    rng = np.random.default_rng(0)
    angle, offset = rng.uniform(0, 2 * np.pi, 200), rng.uniform(-0.6, 0.6, 200)
    one, other = (at_angles(angle + t, offset, dtype) for t in (0, turn))
    atol = 0.3 * turn + 8 * np.finfo(dtype).eps
    np.testing.assert_allclose(clipped_area(one, other), clipped_area(one, one), atol=atol)
    np.testing.assert_allclose(clipped_area(one, one), clipped_area(one), atol=atol)
    np.testing.assert_allclose(clipped_area(one, ~other), 0, atol=atol)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_derivatives_are_differences(count):
    half_planes = random_half_planes(count, 300)
    angles = np.stack([np.arctan2(h.down, h.right) for h in half_planes])
    offsets = np.stack([np.asarray(h.offset) for h in half_planes])
    draw = lambda a, o: polygon.clipped_area(
        *(HalfPlane(jnp.cos(a[k]), jnp.sin(a[k]), jnp.asarray(o[k])) for k in range(count))
    )
    by_angle, by_offset = np.random.default_rng(5).normal(size=(2, *angles.shape))
    area = lambda h: draw(angles + h * by_angle, offsets + h * by_offset)
    first = lambda h: jax.jvp(area, (h,), (1.0,))[1]
    for function, derivative in ((area, first), (first, jax.jacfwd(first))):
        difference = (function(1e-6) - function(-1e-6)) / 2e-6
        # a few lines pass a corner within the step
        assert np.sort(np.abs(derivative(0.0) - difference))[-3] < 1e-7


def test_derivatives_of_nearly_equal_lines():
    turns = np.array([0, 1e-15, 1e-8, 1e-4])
    one = at_angles(np.full(4, 0.3), np.full(4, 0.1))
    move = lambda h: (
        clipped_area(one, at_angles(0.3 + turns, np.full(4, 0.1)), ~one)
        + clipped_area(
            HalfPlane(one.right, one.down, one.offset + h), at_angles(0.3 + turns, np.full(4, 0.1))
        )
    )
    _, slope = jax.jvp(move, (0.0,), (1.0,))
    assert np.isfinite(slope).all() and (0 <= slope).all() and (slope < 1.5).all()


@FLOATS
@settings(max_examples=50, deadline=None)
@given(strategy.floats(0, 1), strategy.floats(0, 6.3), strategy.floats(1e-6, 1e6))
def test_half_plane_with_area(dtype, area, angle, length):
    area, x, y = (dtype(v) for v in (area, length * np.cos(angle), length * np.sin(angle)))
    made = polygon.half_plane_with_area(*(jnp.asarray([v]) for v in (area, x, y)))
    np.testing.assert_allclose(clipped_area(made), area, atol=8 * np.finfo(dtype).eps)


def test_nearly_level_edges_keep_their_digits():
    rng = np.random.default_rng(4)
    angle = 10 ** rng.uniform(-7, -1, 1000) + np.pi / 2 * rng.integers(0, 4, 1000)
    part = 10 ** rng.uniform(-6, 0, 1000)
    single = [jnp.asarray(v, jnp.float32) for v in (part, np.cos(angle), np.sin(angle))]
    np.testing.assert_allclose(clipped_area(polygon.half_plane_with_area(*single)), part, atol=5e-7)


def test_derivatives_of_half_plane_with_area():
    rng = np.random.default_rng(2)
    part, angle = rng.uniform(0.001, 0.999, 100), rng.uniform(0, 2 * np.pi, 100)
    back = lambda part, x, y: polygon.clipped_area(polygon.half_plane_with_area(part, x, y)).sum()
    by_part, by_x, by_y = jax.grad(back, (0, 1, 2))(part, np.cos(angle), np.sin(angle))
    np.testing.assert_allclose(by_part, 1, atol=1e-12)
    np.testing.assert_allclose(by_x, 0, atol=1e-12)
    np.testing.assert_allclose(by_y, 0, atol=1e-12)


def test_half_plane_of_a_function():
    rng = np.random.default_rng(3)
    f, fx, fy = jnp.asarray(rng.normal(size=(3, 100)))
    area = clipped_area(polygon.half_plane_of(differential(f, fx, fy)))
    np.testing.assert_allclose(area, coverage.half_plane_area(f, fx, fy), atol=1e-14)


@pytest.mark.parametrize(("f", "area"), [(2.0, 1), (-2.0, 0)])
def test_constant_function_has_no_edge(f, area):
    f, zero = jnp.full(1, f), jnp.zeros(1)
    half_plane = polygon.half_plane_of(differential(f, zero, zero))
    assert clipped_area(half_plane) == area
    assert bool(polygon.contain_pixel((half_plane,))[0]) == (area == 1)
