"""Blurred profiles: against sums over Gaussians, and derivatives against differences."""

import numpy as np
import pytest

from spheretrace_jax.calibration.edge_model import power_profiles, shadow_profiles, step

DEPTH = np.linspace(-3, 6, 37)
NODES = np.linspace(-8, 8, 40001)
SHARES = np.exp(-0.5 * NODES**2) / np.exp(-0.5 * NODES**2).sum()


def blurred(profile, width):
    return profile(DEPTH[:, None] + width * NODES) @ SHARES


@pytest.mark.parametrize("width", [0.3, 1.5])
def test_powers(width):
    values, by_depth, by_width = power_profiles(DEPTH, width)
    for row, power in zip(values, (0, 0.5, 1), strict=True):
        expected = blurred(lambda d: np.where(d > 0, np.maximum(d, 0) ** power, 0), width)
        np.testing.assert_allclose(row, expected, atol=2e-4)
    h = 1e-5
    more, less = power_profiles(DEPTH + h, width)[0], power_profiles(DEPTH - h, width)[0]
    np.testing.assert_allclose(by_depth, (more - less) / (2 * h), atol=2e-3 / width)
    more, less = power_profiles(DEPTH, width + h)[0], power_profiles(DEPTH, width - h)[0]
    np.testing.assert_allclose(by_width, (more - less) / (2 * h), atol=5e-3 / width)
    np.testing.assert_allclose(step(DEPTH, width)[0], values[0])
    np.testing.assert_allclose(step(DEPTH, width)[1], by_depth[0])


def test_shadows():
    values, by_depth, by_width = shadow_profiles(DEPTH, 0.6, 1.4)
    expected = blurred(lambda d: np.maximum(np.sqrt(np.maximum(d, 0)) - np.sqrt(1.4), 0), 0.6)
    np.testing.assert_allclose(values[0], expected, atol=1e-3)
    np.testing.assert_allclose(values[1], blurred(lambda d: d > 1.4, 0.6), atol=1e-3)
    h = 0.02
    more, less = shadow_profiles(DEPTH + h, 0.6, 1.4)[0], shadow_profiles(DEPTH - h, 0.6, 1.4)[0]
    np.testing.assert_allclose(by_depth, (more - less) / (2 * h), atol=0.02)
    more, less = shadow_profiles(DEPTH, 0.6 + h, 1.4)[0], shadow_profiles(DEPTH, 0.6 - h, 1.4)[0]
    np.testing.assert_allclose(by_width, (more - less) / (2 * h), atol=0.03)
