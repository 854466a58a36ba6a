"""Screen tiles: tangents bound circles, and tiles hold all pixels."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as strategy

from spheretrace_jax.acceleration.screen_tiles import TILE, from_tiles, tangent_slopes, to_tiles

length = strategy.floats(-100, 100, width=32)


@settings(max_examples=300, deadline=None)
@given(
    length,
    length,
    strategy.floats(2**-10, 100, width=32),
    strategy.floats(0, 1),
    strategy.floats(0, 6.3),
)
def test_circle_is_within_its_tangents(x, z, radius, fraction, angle):
    low, high = tangent_slopes(jnp.asarray(x), jnp.asarray(z), jnp.asarray(radius))
    at_x, at_z = x + radius * fraction * np.sin(angle), z + radius * fraction * np.cos(angle)
    if at_z > 1e-6:
        slope = at_x / at_z
        assert low <= slope + 1e-9 * (1 + abs(slope)) and slope - 1e-9 * (1 + abs(slope)) <= high


@pytest.mark.parametrize(
    ("x", "z", "expected"),
    [
        (0.0, 2.0**0.5, (-1, 1)),
        (0.0, 0.5, (-np.inf, np.inf)),
        (0.0, -2.0, (np.inf, -np.inf)),
        (3.0, -2.0, (np.inf, -np.inf)),
        (2.0**0.5, 0.0, (1, np.inf)),
        (-(2.0**0.5), 0.0, (-np.inf, -1)),
        (1.0, 2.0, (0, 4 / 3)),
        (1.0, 1.0, (0, np.inf)),
    ],
)
def test_tangents_of_the_unit_circle(x, z, expected):
    found = tangent_slopes(jnp.asarray(x), jnp.asarray(z), jnp.asarray(1.0))
    np.testing.assert_allclose(found, expected, atol=1e-14)


@pytest.mark.parametrize("shape", [(TILE, TILE), (3 * TILE, 2 * TILE), (13, 50), (1, 1)])
def test_tiles_hold_every_pixel_once(shape):
    plane = jnp.arange(float(np.prod(shape))).reshape(shape)
    assert to_tiles(plane).shape == (-(-shape[0] // TILE) * -(-shape[1] // TILE), TILE**2)
    np.testing.assert_array_equal(from_tiles(to_tiles(plane), shape), plane)
