"""The structure of residuals: noise has none, shapes and outliers have, and words say where."""

import jax.numpy as jnp
import numpy as np
import pytest

from spheretrace_jax.fit.diagnosis.residual_structure import (
    Structure,
    place_in_words,
    structure,
)
from spheretrace_jax.fit.model.target import make_target

ONES = jnp.ones(3)


def of(residual: np.ndarray, picture: np.ndarray) -> Structure:
    target = make_target(picture - residual, np.dtype(np.float64), brightest=np.inf)
    return structure(target, jnp.asarray(picture), ONES)


def test_noise_has_none():
    rng = np.random.default_rng(0)
    for _ in range(20):
        found = of(0.1 * rng.standard_normal((30, 30, 3)), np.full((30, 30, 3), 0.5))
        assert found.unexplained == 0 and found.explains and not found.shared


def test_noise_of_a_part_has_none():
    """Noise of an eighth of the picture, beside black that fits exactly."""
    rng = np.random.default_rng(1)
    part = np.zeros((32, 32, 1))
    part[8:20, 10:20] = 1
    for _ in range(20):
        found = of(0.01 * rng.standard_normal((32, 32, 3)) * part, 0.5 * part + np.zeros(3))
        assert found.unexplained == 0 and not found.shared


def test_a_shape_has():
    x = np.linspace(0, 3, 30)
    shape = 0.05 * np.sin(x)[:, None, None] * np.ones((30, 30, 3))
    noise = 0.01 * np.random.default_rng(0).standard_normal(shape.shape)
    found = of(shape + noise, np.full(shape.shape, 0.5))
    rms = np.sqrt(np.mean(shape**2)) / np.sqrt(np.mean((0.5 - shape - noise) ** 2))
    np.testing.assert_allclose(found.unexplained, rms, rtol=0.1)
    assert found.shared and not found.explains and 13 <= found.row <= 16


def test_an_outlier_is():
    residual = 1e-6 * np.random.default_rng(0).standard_normal((30, 30, 3))
    residual[4, 7] = 0.3
    found = of(residual, np.full((30, 30, 3), 0.5))
    np.testing.assert_allclose(found.unexplained, 0.3 / 0.5 / 30, rtol=0.01)
    assert abs(found.row - 4) <= 1 and abs(found.column - 7) <= 1


def test_of_black_nothing_is_explained_in_part():
    shape = 0.05 * np.ones((30, 30, 3))
    assert of(shape, shape).unexplained == 1  # the target is black, the picture is not
    assert of(1e-9 * shape, 1e-9 * shape).explains


@pytest.mark.parametrize(
    ("row", "column", "words"),
    [
        (10, 10, "sphere 1, middle"),
        (3, 10, "sphere 1, upper at its outline"),
        (14, 7, "sphere 1, lower left"),
        (10, 16, "sphere 1, right"),
        (29, 29, "plane 1, lower right at its outline"),
        (1, 28, "the background"),
    ],
)
def test_words(row, column, words):
    y, x = np.mgrid[:30, :30]
    objects = np.where(np.hypot(y - 10, x - 10) <= 7.2, 0, -1)
    objects[20:] = 1
    power = np.zeros((30, 30))
    power[row, column] = 1.0
    found = Structure(0.1, 1e-3, True, row, column, power)
    assert place_in_words(found, objects, 1) == words
    more = found._replace(power=power + np.where(objects == objects[row, column], 0, 1e-2))
    assert place_in_words(more, objects, 1).startswith(f"{words}, ")
