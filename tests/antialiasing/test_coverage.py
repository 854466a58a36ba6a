"""Coverage: areas of half-planes and discs in a pixel: known values, counting, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as strategy

from spheretrace_jax.antialiasing import coverage
from spheretrace_jax.base.vec import SplitVec, dot, unit

disc, half_plane = jax.jit(coverage.disc_area), jax.jit(coverage.half_plane_area)

FLOATS = pytest.mark.parametrize("dtype", [np.float32, np.float64])

RNG = np.random.default_rng(0)
TURN = np.linalg.qr(RNG.normal(size=(3, 3)))[0].T  # rows: two axes of a plane and its normal

# 200 x 200 points in the pixel
X, Y = np.meshgrid(*[(np.arange(200) + 0.5) / 200 - 0.5] * 2)


@jax.jit
def flat_disc(q, qx, qy, radius):
    """Returns `disc` in the plane z = 0. **Arguments:** of shape (n, 2), `radius` of shape (n,)."""
    zero = jnp.zeros_like(radius)
    q, qx, qy = (SplitVec(v[:, 0], v[:, 1], zero) for v in (q, qx, qy))
    return disc(q, qx, qy, SplitVec(zero, zero, zero + 1), radius)


@jax.jit
def square_disc(x, y, radius):
    """Returns the fraction of pixels at x, y inside a disc around the origin."""
    one, zero = jnp.ones_like(x), jnp.zeros_like(x)
    axis = SplitVec(zero, zero, one)
    return disc(
        SplitVec(x, y, zero),
        SplitVec(one, zero, zero),
        SplitVec(zero, one, zero),
        axis,
        radius * one,
    )


def random_discs(n: int) -> tuple[np.ndarray, ...]:
    """Draws discs from 1/30 to 30 pixels, whose edges cross the pixel or pass close to it."""
    rng = np.random.default_rng(1)
    radius = 10 ** rng.uniform(-1.5, 1.5, n)
    angle, length = rng.uniform(0, 2 * np.pi, n), radius + rng.uniform(-1, 1, n)
    q = length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return q, rng.normal(size=(n, 2)), rng.normal(size=(n, 2)), radius


def counted(q, qx, qy, radius) -> np.ndarray:
    """Returns the fraction of the 200 x 200 points that are inside."""
    x, y = (q[k] + qx[k] * X + qy[k] * Y for k in (0, 1))
    return np.mean(x * x + y * y < radius * radius)


@FLOATS
def test_known_areas_of_half_planes(dtype):
    f, fx, fy, area = np.array(
        [
            [0, 1, 0, 1 / 2],
            [0, 3, -3, 1 / 2],
            [0.25, 0, -1, 3 / 4],
            [-0.5, 1, 1, 1 / 8],  # a corner
            [0.5, -1, 1, 7 / 8],
            [0.1, 1e-3, 2e-3, 1],  # not in the pixel
            [-0.1, 1e-3, 2e-3, 0],
            [2, 0, 0, 1],
            [-2, 0, 0, 0],
            [0, 1e-30, 0, 1 / 2],
            [1e18, 4e18, 0, 3 / 4],
        ],
        dtype,
    ).T
    np.testing.assert_allclose(half_plane(f, fx, fy), area, atol=4 * np.finfo(dtype).eps)


@FLOATS
def test_counted_areas_of_half_planes(dtype):
    f, fx, fy = np.random.default_rng(2).normal(size=(3, 200)).astype(dtype)
    fx[:5], fy[3:8] = 0, 0
    area = half_plane(f, fx, fy)
    inside = [np.mean(f[i] + fx[i] * X + fy[i] * Y > 0) for i in range(f.size)]
    np.testing.assert_allclose(
        area, inside, atol=3e-3
    )  # half a row of points, where the edge is level


@FLOATS
def test_half_plane_grows_by_its_edge(dtype):
    # by f: the edge's length over the gradient's
    f, fx, fy, length = np.array(
        [[0, 1, 0, 1], [0.2, 0, 4, 1 / 4], [0, 1, 1, 1], [-0.5, 1, 1, 1 / 2], [3, 1, 1, 0]], dtype
    ).T
    slope = jax.grad(lambda f: half_plane(f, fx, fy).sum())(jnp.asarray(f))
    np.testing.assert_allclose(slope, length, atol=1e-6)


def test_level_edge_is_the_limit_of_tilted_edges():
    f = jnp.linspace(-1, 1, 41)
    tilts = [half_plane(f, jnp.ones_like(f), jnp.full_like(f, m)) for m in (0, 1e-9, 1e-6)]
    slopes = [
        jax.grad(lambda f, m=m: half_plane(f, jnp.ones_like(f), jnp.full_like(f, m)).sum())(
            f + 0.01
        )
        for m in (0, 1e-9, 1e-6)
    ]
    for tilted, slope in zip(tilts, slopes, strict=True):
        np.testing.assert_allclose(tilted, jnp.clip(f + 0.5, 0, 1), atol=1e-6)
        np.testing.assert_allclose(slope, np.abs(f + 0.01) < 0.5, atol=1e-6)


@FLOATS
def test_known_areas_of_discs(dtype):
    x, y, radius, area = np.array(
        [
            [0, 0, 0.3, np.pi * 0.09],
            [0.5, 0, 0.3, np.pi * 0.09 / 2],
            [-0.5, 0.5, 0.4, np.pi * 0.16 / 4],
            [0, 0, 0.8, 1],
            [0, 0, 0.5, np.pi / 4],
            [0, 0, 1 / np.sqrt(2), 1],
            [2, 1, 0.4, 0],
            [30, 0, 33, 1],
            [0.1, 0.2, 1e-3, np.pi * 1e-6],
            # chords: the disc cut by all four sides
            [0, 0, 0.6, np.pi * 0.36 - 4 * (0.36 * np.arccos(5 / 6) - 0.5 * np.sqrt(0.11))],
        ],
        dtype,
    ).T
    np.testing.assert_allclose(square_disc(x, y, radius), area, atol=16 * np.finfo(dtype).eps)


@FLOATS
def test_counted_areas_of_discs(dtype):
    q, qx, qy, radius = (v.astype(dtype) for v in random_discs(200))
    area = flat_disc(q, qx, qy, radius)
    inside = [counted(q[i], qx[i], qy[i], radius[i]) for i in range(radius.size)]
    np.testing.assert_allclose(area, inside, atol=3e-3)


def test_disc_is_rotation_invariant():
    q, qx, qy, radius = random_discs(200)
    along = (
        RNG.normal(size=(2, 200, 1)) * TURN[2]
    )  # components of qx and qy along the ray do not count
    planes = lambda rows: SplitVec(*jnp.asarray(rows).T)
    axis = planes(np.tile(TURN[2], (200, 1)))
    qx3, qy3 = (planes(v @ TURN[:2] + a) for v, a in zip((qx, qy), along, strict=True))
    area = disc(planes(q @ TURN[:2]), qx3, qy3, axis, jnp.asarray(radius))
    np.testing.assert_allclose(area, flat_disc(q, qx, qy, radius), atol=1e-12)


def test_derivatives_of_discs_are_differences():
    # rays turn too, so that the axes of the plane across them tilt
    q, qx, qy, radius = random_discs(200)
    planes = lambda rows: SplitVec(*jnp.asarray(rows).T)
    rows = [v @ TURN[:2] for v in (q, qx, qy)] + [np.tile(TURN[2], (200, 1))]
    q, qx, qy, axis = map(planes, rows)
    by = [planes(RNG.normal(size=(200, 3))) for _ in rows]

    def area(h):
        turned = unit(axis + by[3] * h)
        from_center = q + by[0] * h
        across = from_center - turned * dot(from_center, turned)  # as perpendiculars are
        return disc(across, qx + by[1] * h, qy + by[2] * h, turned, radius * (1 + 0.3 * h))

    first = lambda h: jax.jvp(area, (h,), (1.0,))[1]
    for function, derivative in ((area, first), (first, jax.jacfwd(first))):
        h = 1e-7
        difference = (function(h) - function(-h)) / (2 * h)
        error = np.abs(derivative(0.0) - difference) / (1 + np.abs(difference))
        # a few circles pass a corner of the pixel within the step
        assert np.sort(error)[-4] < 1e-5


@FLOATS
def test_large_disc_is_a_half_plane(dtype):
    rng = np.random.default_rng(3)
    angle, beyond = rng.uniform(0, 2 * np.pi, 100), rng.uniform(-0.8, 0.8, 100)
    c, s = np.cos(angle), np.sin(angle)
    straight = half_plane(-beyond, -c, -s)
    for radius in (1e3, 1e6):
        r = dtype(radius)
        length = (r + beyond.astype(dtype)) if radius < 1e4 else (r + beyond).astype(dtype)
        exact = half_plane(radius - length.astype(float), -c, -s)
        x, y = (length * v.astype(dtype) for v in (c, s))
        rounding = 8 * radius * np.finfo(dtype).eps
        np.testing.assert_allclose(square_disc(x, y, r), exact, atol=1 / radius + rounding)
        assert np.abs(exact - straight).max() < 1e-3 + rounding


@FLOATS
@settings(max_examples=100, deadline=None)
@given(
    strategy.floats(-0.5, 0.5),
    strategy.floats(-0.5, 0.5),
    strategy.floats(1e-3, 3.4),
    strategy.floats(0, np.pi),
)
def test_pixels_sum_to_the_disc(dtype, x, y, radius, angle):
    at = np.arange(-4.0, 5)
    px, py = np.meshgrid(at + x, at + y)
    c, s = np.cos(angle), np.sin(angle)
    n = px.size
    q = np.stack([c * px - s * py, s * px + c * py], axis=-1).reshape(n, 2).astype(dtype)
    axes = (np.broadcast_to(np.array(v, dtype), (n, 2)) for v in ((c, s), (-s, c)))
    areas = flat_disc(q, *axes, np.full(n, radius, dtype))
    eps = float(np.finfo(dtype).eps)
    np.testing.assert_allclose(np.sum(areas), np.pi * radius**2, rtol=64 * eps, atol=256 * eps)


@settings(max_examples=100, deadline=None)
@given(*[strategy.floats(-2, 2)] * 3)
def test_half_plane_is_the_mean_of_quarters(f, fx, fy):
    assume(max(abs(fx), abs(fy)) > 1e-6)
    f, fx, fy = (np.array([v]) for v in (f, fx, fy))
    quarters = [
        half_plane(f + fx * a + fy * b, fx / 2, fy / 2)
        for a in (-0.25, 0.25)
        for b in (-0.25, 0.25)
    ]
    total = half_plane(f, fx, fy)
    np.testing.assert_allclose(total, sum(quarters) / 4, atol=1e-7)
    np.testing.assert_allclose(half_plane(-f, -fx, -fy), 1 - total, atol=1e-7)


def test_small_disc_grows_by_its_circumference():
    x, y = np.random.default_rng(4).uniform(-0.4, 0.4, (2, 50))
    radius = np.full(50, 0.05)
    slope = jax.grad(lambda *v: square_disc(*v).sum(), argnums=(0, 1, 2))(x, y, radius)
    np.testing.assert_allclose(slope[2], 2 * np.pi * 0.05, rtol=1e-9)
    np.testing.assert_allclose(slope[:2], 0, atol=1e-12)


@FLOATS
def test_degenerate_discs_are_finite(dtype):
    x, y, xx, xy, yx, yy, radius = np.array(
        [
            [0, 0, 0, 0, 0, 0, 1],  # no pixel
            [1, 0, 0, 0, 0, 0, 1],  # a point on the circle
            [0, 0, 1, 0, 0, 1, 1],  # the middle of the disc
            [1, 0, 1, 0, 2, 0, 1],  # a pixel without area
            [1, 0, 1, 0, 0, 1, 0.5],  # the pixel's side touches the circle
            [0.5, 0.5, 1, 0, 0, 1, 1],  # a corner in the middle of the disc
            [1, 0, 1e-20, 0, 0, 1e-20, 1],
            [0, 0, 1e15, 0, 0, 1e15, 1],
            [1.5, 0, 1, 0, 0, 1, 1],
            [2, 0, 0, 0, 1, 0, 1.5],
            [0, 0, 0, 0, 0, 1, 1],
            [1, 1, 1, 0, 0, 1, 1e-12],
            [0.5, 0, 1, 0, 0, 1, 1e-4],  # a border through the middle
            [0.5, 0, 1, 0, 0, 1, 1e-12],  # a speck on the side
            [1, 1, 1, 0, 0, 1, 1e6],
            [0.5, 0.5, 1, 0, 0, 1, np.sqrt(2)],  # a circle through the corner
        ],
        dtype,
    ).T
    inputs = [jnp.stack(v, axis=1) for v in ((x, y), (xx, xy), (yx, yy))] + [jnp.asarray(radius)]
    area = flat_disc(*inputs)
    assert area.dtype == dtype
    assert ((area >= 0) & (area <= 1)).all()
    slopes = jax.grad(lambda v: flat_disc(*v).sum())(inputs)
    assert all(np.isfinite(slope).all() for slope in slopes)
    f = jnp.asarray([0, 0, 1e-15, 1e15, -1, 0], dtype)
    fx, fy = jnp.asarray([[0, 1, 1e-15, 1e15, 0, 1e-15], [0, 1, 0, 1e15, 0, 1e15]], dtype)
    slopes = jax.grad(lambda v: half_plane(*v).sum())((f, fx, fy))
    assert all(np.isfinite(slope).all() for slope in slopes)
