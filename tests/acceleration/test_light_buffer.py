"""Light buffer: the bounds of a sphere hold every ray from the light that meets it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spheretrace_jax.acceleration.binning import cluster
from spheretrace_jax.acceleration.light_buffer import light_projection
from spheretrace_jax.base.vec import SplitVec
from spheretrace_jax.scene.light import make_light


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize(
    "light", [(0, 0, 0), (1, 2, 3), (0, 0, 30), (1e3, -5e3, 2e3), (-1e6, 0, 1)]
)
@pytest.mark.parametrize("directional", [False, True])
def test_bounds_hold_every_ray(light, dtype, directional):
    if directional and not any(light):
        light = (0, 0, 1)
    rng = np.random.default_rng(0)
    n = 4000
    center, radius = rng.uniform(-10, 10, (n, 3)), 10.0 ** rng.uniform(-3, 0.5, n)
    outward = rng.standard_normal((n, 3))
    outward *= (rng.uniform(0, 1, n) ** 0.2 * radius / np.linalg.norm(outward, axis=1))[:, None]
    inside = center + outward
    away = -np.array(light) + np.zeros((n, 3)) if directional else inside - light
    point = inside + away * rng.uniform(0, 1, (n, 1)) / np.linalg.norm(away, axis=1, keepdims=True)
    center, point = (SplitVec(*jnp.asarray(x.T, dtype)) for x in (center, point))
    radius, light = (
        jnp.asarray(radius, dtype),
        make_light(jnp.asarray(light, dtype), None, directional),
    )

    def positions():
        projection = light_projection(light, n, cluster(center, radius))
        bounds = projection.bounds(center, radius)
        return bounds, projection.cell_position(point), projection.cells

    bounds, position, cells = jax.jit(positions)()
    for low, x, high in zip(bounds.low[:2], position, bounds.high[:2], strict=True):
        assert np.all((low <= x) & (x <= high)) and np.all((0 <= low) & (high <= cells))
