"""Light positions in projective coordinates, and fits that are blind to the unit of length."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import nine_spheres

import spheretrace_jax as st
from spheretrace_jax.fit.model.light_position import (
    LightPosition,
    light_position_at,
    no_bound,
)
from spheretrace_jax.study.benchmarks.wrong_start import wrong_start

MIDDLE, SIZE = np.array([3.0, -5, 7]), 40.0
ALONG = np.array([1.0, -2, 2]) / 3
FAR = (0.0, 1e-200, 1e-9, 0.01, 1.0, 30.0, 1e6)  # distances in sizes
DTYPES = (np.float64, np.float32)
INFINITY = 1e7


def coordinates(far: float, dtype=np.float64, unit: float = 1.0) -> tuple[LightPosition, jax.Array]:
    """Returns the coordinates around a light at a distance in sizes, and the light."""
    light, middle, size = (
        jnp.asarray(unit * x, dtype) for x in (MIDDLE + far * SIZE * ALONG, MIDDLE, SIZE)
    )
    return light_position_at(light, middle, size), light


def at_least(around: LightPosition) -> jax.Array:
    """Returns the bound on the third coordinate, the other two at the start."""
    return jnp.zeros_like(around.u).at[2].set(around.lower_bound()[2])


def slopes(around: LightPosition, y: jax.Array) -> np.ndarray:
    """Returns the derivatives of the position, in sizes, and in double precision."""
    return np.asarray(jax.jacfwd(around.position)(y), np.float64) / float(around.size)


def scaled_singular_values(slope: np.ndarray) -> np.ndarray:
    return np.linalg.svd(slope / np.linalg.norm(slope, axis=0), compute_uv=False)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("far", FAR)
def test_zero_is_the_start(far, dtype):
    around, light = coordinates(far, dtype)
    found = around.position(jnp.zeros(3, dtype))
    assert found.dtype == dtype
    np.testing.assert_allclose(found, light, rtol=3 * np.finfo(dtype).eps)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("far", [*FAR, 1e7, 1e15, 1e30])
def test_derivatives_have_full_rank(far, dtype):
    around, _ = coordinates(far, dtype)
    rng = np.random.default_rng(0)
    # beyond the bound, too, where solvers without bounds may look
    places = [np.zeros(3), *rng.normal(0, 0.5, (5, 3)), *rng.normal(0, 3, (5, 3))]
    for y in places:
        slope = slopes(around, jnp.asarray(y, dtype))
        assert np.isfinite(slope).all()
        # the rounding of float32 alone turns a column by 1e-7
        assert scaled_singular_values(slope)[-1] > 1e-5


@pytest.mark.parametrize("far", FAR)
def test_coordinates_at_start(far):
    around, _ = coordinates(far)
    slope = slopes(around, jnp.zeros(3))
    w = 1 / np.hypot(1, far)
    np.testing.assert_allclose(np.linalg.norm(slope, axis=0), [1 / w, 1 / w, 1 / w**2], rtol=1e-14)
    np.testing.assert_allclose(scaled_singular_values(slope), 1, rtol=1e-14)
    if far > 1e-100:
        np.testing.assert_allclose(ALONG @ slope, [0, 0, -(w**-2)], atol=1e-15 / w**2)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("far", [0.01, 1.0, 30.0, 1e6, 1e7])
def test_derivatives_by_differences(far, dtype):
    around, _ = coordinates(far)
    rng = np.random.default_rng(1)
    w = 1 / np.hypot(1, far)
    for _ in range(4):
        y = rng.normal(0, 0.1, 3) * [1, 1, w]
        h = 1e-6 * np.array([1, 1, w])
        if far >= INFINITY:
            y[2], h[2] = abs(y[2]) + h[2], h[2] / 2
        apart = [
            (around.position(jnp.asarray(y + d)) - around.position(jnp.asarray(y - d))) / SIZE
            for d in np.diag(h)
        ]
        slope = slopes(coordinates(far, dtype)[0], jnp.asarray(y, dtype))
        expected = np.stack(apart, axis=1) / (2 * h)
        largest = np.abs(expected).max(0)
        tolerance = 1e-8 if dtype == np.float64 else 1e-5
        np.testing.assert_allclose(slope / largest, expected / largest, atol=tolerance)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("far", [0.01, 1.0, 30.0, 1e3, 1e6])
def test_light_at_bound(far, dtype):
    around, _ = coordinates(far, dtype)
    y = at_least(around)
    away = (np.asarray(around.position(y), np.float64) - MIDDLE) / SIZE
    assert np.isfinite(away).all() and np.linalg.norm(away) > 0.5 * INFINITY
    np.testing.assert_allclose(away / np.linalg.norm(away), ALONG, atol=1e-6)
    slope = slopes(around, y)
    # two turn it as 1/w, the third moves it as 1/w^2: no less, or no step would bring it back
    lengths = np.linalg.norm(slope, axis=0)
    w = np.hypot(1, far) / far / np.linalg.norm(away)
    np.testing.assert_allclose(lengths * [w, w, w**2], 1, rtol=0.01)
    assert (ALONG @ slope)[2] < 0
    np.testing.assert_allclose(scaled_singular_values(slope), 1, atol=1e-5)


@pytest.mark.parametrize("dtype", DTYPES)
def test_light_beyond_infinity(dtype):
    for far in (1e8, 1e15, 1e30, *([1e160] if dtype == np.float64 else [])):
        around, _ = coordinates(far, dtype)
        assert around.lower_bound()[2] == 0
        away = (np.asarray(around.position(jnp.zeros(3, dtype)), np.float64) - MIDDLE) / SIZE
        np.testing.assert_allclose(away / INFINITY, ALONG, rtol=1e-6)


def test_light_at_middle_is_unbounded():
    around, _ = coordinates(0.0)
    assert (around.lower_bound() == -no_bound(around.w)).all()
    assert (around.position(jnp.zeros(3)) == MIDDLE).all()
    # derivatives by the coordinates themselves, as `solution` takes them, have no 0/0 either
    tangent = jax.tree.map(jnp.ones_like, around)
    _, slope = jax.jvp(lambda c: c.position(jnp.ones(3)), (around,), (tangent,))
    assert np.isfinite(slope).all()
    moved = around.position(jnp.asarray([0.1, -0.2, 0.3])) - MIDDLE
    np.testing.assert_allclose(jnp.linalg.norm(moved), SIZE * np.sqrt(0.14), rtol=1e-14)


@pytest.mark.parametrize("unit", [1e3, 1e-3])
@pytest.mark.parametrize("far", [0.0, 0.01, 1.0, 30.0, 1e6])
def test_coordinates_are_unit_free(far, unit):
    (one, _), (other, _) = coordinates(far), coordinates(far, unit=unit)
    y = jnp.asarray([0.3, -0.2, 0.1])
    numbers = slopes(one, y)
    largest = np.abs(numbers).max()
    np.testing.assert_allclose(slopes(other, y) / largest, numbers / largest, atol=1e-12)
    np.testing.assert_allclose(other.lower_bound()[2], one.lower_bound()[2], rtol=1e-12)


def scaled(scene: st.Scene, unit: float) -> st.Scene:
    """Returns the scene with lengths `unit` times as large."""
    lengths = lambda s: (
        s.spheres.center, s.spheres.radius, s.lights.position,
        s.camera.mu, s.camera.distance, s.camera.window,
    )  # fmt: skip
    return eqx.tree_at(lengths, scene, [unit * x for x in lengths(scene)])


TRUTH = nine_spheres((100.0, 500, 800))
PLAIN = dict(bounces=0, samples=1)
SMALL = dict(width=32, height=32)


def test_fit_steps_are_unit_free():
    target = np.array(st.render(TRUTH, **SMALL, **PLAIN))
    # with noise and a coarse tolerance all costs and steps are far above rounding errors
    target += 0.01 * np.random.default_rng(0).standard_normal(target.shape)
    one, *others = (
        st.fit(scaled(wrong_start(TRUTH), unit), target, rtol=1e-6, atol=1e-6, **PLAIN)
        for unit in (1.0, 1e3, 1e-3)
    )
    assert one.converged and one.costs[0] > 10 * one.cost > 1
    for unit, other in zip((1e3, 1e-3), others, strict=True):
        assert other.converged and other.steps == one.steps
        np.testing.assert_allclose(other.costs, one.costs, rtol=1e-9)
        position = other.scene.lights.position / unit
        np.testing.assert_allclose(position, one.scene.lights.position, rtol=1e-9)


def test_fit_from_infinity():
    far = eqx.tree_at(lambda s: s.lights.position, TRUTH, 1e12 * TRUTH.lights.position)
    found = st.fit(far, st.render(TRUTH, **SMALL, **PLAIN), **PLAIN)
    assert found.converged
    np.testing.assert_allclose(found.scene.lights.position, TRUTH.lights.position, rtol=1e-8)


def test_fit_to_infinity():
    far = eqx.tree_at(lambda s: s.lights.position, TRUTH, 1e9 * TRUTH.lights.position)
    target = st.render(far, **SMALL, **PLAIN)
    found = st.fit(wrong_start(TRUTH), target, **PLAIN)
    picture = st.render(found.scene, **SMALL, **PLAIN)
    np.testing.assert_allclose(picture, target, atol=1e-6)
    unit = lambda x: x[0] / np.linalg.norm(x)
    direction = unit(np.asarray(found.scene.lights.position))
    np.testing.assert_allclose(direction, unit(np.asarray(far.lights.position)), atol=1e-6)
