"""The plane: where rays meet it."""

import jax.numpy as jnp
import pytest

from spheretrace_jax.base.vec import vec
from spheretrace_jax.tracing.shapes.plane import ray_plane


@pytest.mark.parametrize(("height", "t"), [(3.0, 3.0), (-3.0, -3.0)])
def test_plane_before_and_behind(height, t):
    origin, direction = vec(jnp.array([1.0, 2, height])), vec(jnp.array([0.0, 0, -1]))
    assert ray_plane(origin, direction, vec(jnp.zeros(3)), vec(jnp.array([0.0, 0, 2]))) == t


def test_ray_along_a_plane_misses_it():
    origin, direction = vec(jnp.array([0.0, 0, 1])), vec(jnp.array([1.0, 0, 0]))
    assert ray_plane(origin, direction, vec(jnp.zeros(3)), vec(jnp.array([0.0, 0, 1]))) == 0
