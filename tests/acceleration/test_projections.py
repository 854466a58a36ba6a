import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as some

from spheretrace_jax.acceleration.binning import cluster
from spheretrace_jax.acceleration.light_buffer import light_projection
from spheretrace_jax.acceleration.screen_tiles import TILE, from_tiles, tangent_slopes, to_tiles
from spheretrace_jax.base.vec import Vec, vec

length = some.floats(-100, 100, width=32)


@settings(max_examples=300, deadline=None)
@given(length, length, some.floats(2**-10, 100, width=32), some.floats(0, 1), some.floats(0, 6.3))
def test_whatever_of_a_circle_is_ahead_is_within_its_tangents(x, z, radius, part, angle):
    low, high = tangent_slopes(jnp.asarray(x), jnp.asarray(z), jnp.asarray(radius))
    at_x, at_z = x + radius * part * np.sin(angle), z + radius * part * np.cos(angle)
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


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize(
    "light", [(0, 0, 0), (1, 2, 3), (0, 0, 30), (1e3, -5e3, 2e3), (-1e6, 0, 1)]
)
def test_every_ray_that_meets_a_sphere_is_in_its_box(light, dtype):
    rng = np.random.default_rng(0)
    n = 4000
    center, radius = rng.uniform(-10, 10, (n, 3)), 10.0 ** rng.uniform(-3, 0.5, n)
    outward = rng.standard_normal((n, 3))
    outward *= (rng.uniform(0, 1, n) ** 0.2 * radius / np.linalg.norm(outward, axis=1))[:, None]
    inside = center + outward
    point = inside + (inside - light) * rng.uniform(0, 1, (n, 1)) / np.linalg.norm(
        inside - light, axis=1, keepdims=True
    )
    center, point = (Vec(*jnp.asarray(x.T, dtype)) for x in (center, point))
    radius, light = jnp.asarray(radius, dtype), vec(jnp.asarray(light, dtype))

    def places():
        projection = light_projection(light, n, cluster(center, radius))
        bounds = projection.bounds(center, radius)
        return bounds, projection.cell_position(point), projection.cells

    box, place, cells = jax.jit(places)()
    for low, x, high in zip(box.low[:2], place, box.high[:2], strict=True):
        assert np.all((low <= x) & (x <= high)) and np.all((0 <= low) & (high <= cells))
