"""The terms that a ball sends to the camera, against formulas in NumPy, and their derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spheretrace_jax.calibration.ball_radiance import (
    HIGHEST,
    LOBES,
    LOWEST,
    WEIGHTINGS,
    BallSamples,
    light_direction,
    light_model,
    radiance_terms,
    residual_weights,
)

DIRECTION = np.array([0.4, -0.3, -0.8]) / np.linalg.norm([0.4, -0.3, -0.8])


def ball(count=400):
    """Returns points of the ball that a camera along z sees."""
    numbers = np.random.default_rng(0)
    normals = numbers.normal(size=(3, count))
    normals[2] = -np.abs(normals[2])
    normals /= np.linalg.norm(normals, axis=0)
    views = np.tile([[0.0], [0.0], [-1.0]], (1, count))
    values = np.abs(numbers.normal(size=(3, count)))
    return BallSamples(*(jnp.asarray(x, float) for x in (normals, views, values, values > 0.1)))


def terms(unknowns, lobe, falloff=True, samples=None):
    samples = ball() if samples is None else samples
    model = jax.tree.map(jnp.asarray, light_model(DIRECTION, lobe, falloff))
    return np.asarray(radiance_terms(jnp.asarray(unknowns, float), samples, model), np.float64)


def geometry(distance):
    samples = ball()
    N, V = (np.asarray(x, np.float64) for x in (samples.normals, samples.views))
    to_light = DIRECTION[:, None] * distance - N
    r = np.linalg.norm(to_light, axis=0)
    L = to_light / r
    H = (L + V) / np.linalg.norm(L + V, axis=0)
    dot = lambda a, b: (a * b).sum(0)
    return dot(N, L), dot(N, V), dot(N, H), 2 * dot(N, L) * dot(N, V) - dot(L, V), dot(V, H), r


def test_lambert_with_fall_off():
    cosine, _, _, _, _, r = geometry(5.0)
    found = terms([0, 0, 1 / 5, 1, 0, 0], 1)
    np.testing.assert_allclose(found[0], np.maximum(cosine, 0) * (5 / r) ** 2, atol=1e-5)
    found = terms([0, 0, 1 / 5, 1, 0, 0], 1, falloff=False)
    np.testing.assert_allclose(found[0], np.maximum(cosine, 0), atol=1e-5)
    np.testing.assert_array_equal(found[2], 1)


def test_highlights_of_the_lecture():
    cosine, _, half, mirrored, _, r = geometry(5.0)
    lit = np.where(cosine > 0, (5 / r) ** 2, 0)
    phong = terms([0, 0, 1 / 5, np.log10(40), 0, 0], LOBES.index("phong"))[1]
    np.testing.assert_allclose(phong, lit * np.maximum(mirrored, 0) ** 10, atol=1e-5)
    blinn = terms([0, 0, 1 / 5, np.log10(40), 0, 0], LOBES.index("halfway"))[1]
    np.testing.assert_allclose(blinn, lit * np.maximum(half, 0) ** 40, atol=1e-5)


def test_microfacets():
    cosine, view, half, _, turned, r = geometry(5.0)

    def fresnel(c, n=1.5):
        t = np.sqrt(1 - (1 - c**2) / n**2)
        return (((c - n * t) / (c + n * t)) ** 2 + ((t - n * c) / (t + n * c)) ** 2) / 2

    alpha2 = 2 / 40
    tan2 = lambda c: (1 - c**2) / c**2
    smith = lambda c: 2 / (1 + np.sqrt(1 + alpha2 * tan2(c)))
    well = (cosine > 0.1) & (view > 0.1) & (half > 0.2)
    with np.errstate(invalid="ignore"):
        rest = fresnel(turned) * smith(cosine) * smith(view) / view * (5 / r) ** 2
    beckmann = np.exp(-tan2(half) / alpha2) / half**4 * rest
    ggx = alpha2**2 / (half**2 * (alpha2 - 1) + 1) ** 2 * rest
    for name, expected in (("beckmann", beckmann), ("ggx", ggx)):
        found = terms([0, 0, 1 / 5, np.log10(40), 0, 0], LOBES.index(name))[1]
        np.testing.assert_allclose(found[well], expected[well], rtol=1e-3, atol=1e-5)


def test_a_coat_dims_grazing_light():
    bare, coated = (terms([0, 0, 0, 1, coat, 0], 1)[0] for coat in (0, 1))
    cosine, view, *_ = geometry(1e6)
    facing = (cosine > 0.9) & (view > 0.9)
    grazing = (cosine > 0) & (cosine < 0.1)
    lit = cosine > 0
    assert (coated[lit] <= bare[lit]).all()
    np.testing.assert_allclose(coated[facing], bare[facing] * 0.96**2, rtol=2e-3)
    assert (coated[grazing] < 0.75 * bare[grazing]).all()


@pytest.mark.parametrize("lobe", range(len(LOBES)))
@pytest.mark.parametrize("falloff", [True, False])
def test_derivatives_are_those_of_differences(lobe, falloff):
    samples, model = ball(), jax.tree.map(jnp.asarray, light_model(DIRECTION, lobe, falloff))
    at = jnp.asarray([0.1, -0.05, 0.2, 1.4, 0.6, 0.3], float)
    f = lambda y: radiance_terms(y, samples, model)
    step = 2e-3
    _, by = jax.linearize(f, at)
    for axis in np.eye(6):
        axis = jnp.asarray(axis, float)
        differences = (f(at + step * axis) - f(at - step * axis)) / (2 * step)
        error = np.abs(np.asarray(by(axis) - differences))
        # where light ends along the ball the terms have a kink
        assert np.quantile(error, 0.99) < 2e-2


@pytest.mark.parametrize("lobe", range(len(LOBES)))
def test_extremes_are_finite(lobe):
    samples, model = ball(), jax.tree.map(jnp.asarray, light_model(DIRECTION, lobe))
    lowest, highest = (np.clip(x, -3, 3) for x in (LOWEST, np.minimum(HIGHEST, 10)))
    for corner in np.ndindex(2, 2, 2, 2, 2, 2):
        at = jnp.asarray(np.where(corner, [*highest[:3], 4.3, 1, 2], lowest), float)
        value, by = jax.jvp(lambda y: radiance_terms(y, samples, model), (at,), (at,))
        assert np.isfinite(value).all() and np.isfinite(by).all(), corner


def test_turned_directions_have_unit_length():
    model = jax.tree.map(jnp.asarray, light_model(DIRECTION, 0))
    np.testing.assert_allclose(light_direction(jnp.zeros(6), model), DIRECTION, atol=1e-6)
    turned = light_direction(jnp.asarray([0.3, 0.4, 0, 0, 0, 0], float), model)
    assert np.linalg.norm(turned) == pytest.approx(1, abs=1e-6)
    assert np.arccos(turned @ DIRECTION) == pytest.approx(np.arctan(0.5), abs=1e-3)


@pytest.mark.parametrize("weighting", range(len(WEIGHTINGS)))
def test_numbers_that_do_not_count_have_no_weight(weighting):
    samples = ball()
    model = jax.tree.map(jnp.asarray, light_model(DIRECTION, 0, weighting=weighting))
    weights = np.asarray(residual_weights(samples, model))
    np.testing.assert_array_equal(weights > 0, np.asarray(samples.counts) > 0)
