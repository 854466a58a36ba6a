"""The plane: where rays meet it, and an eye in it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spheretrace_jax as st
from spheretrace_jax.base.vec import vec
from spheretrace_jax.tracing.shapes.plane import ray_plane


@pytest.mark.parametrize(("height", "t"), [(3.0, 3.0), (-3.0, -3.0)])
def test_plane_before_and_behind(height, t):
    origin, direction = vec(jnp.array([1.0, 2, height])), vec(jnp.array([0.0, 0, -1]))
    assert ray_plane(origin, direction, vec(jnp.zeros(3)), vec(jnp.array([0.0, 0, 1]))) == t


def test_ray_along_a_plane_misses_it():
    origin, direction = vec(jnp.array([0.0, 0, 1])), vec(jnp.array([1.0, 0, 0]))
    assert ray_plane(origin, direction, vec(jnp.zeros(3)), vec(jnp.array([0.0, 0, 1]))) == 0


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    ("samples", "antialias"), [(1, 0), (3, 0), pytest.param(1, 1, marks=pytest.mark.slow)]
)
def test_derivatives_of_a_floor_that_the_eye_lies_in(dtype, samples, antialias):
    # at odd heights rays run along the floor, with D.N and the distance to it of 1e-17 and 1e-14
    floor = st.Planes([[0.0, 0, 0]], [[0.0, 0, 1]])
    eye = st.Camera(theta=0.3, phi=np.pi / 2)
    lit = st.Lights([[200.0, -300, 500], [200, 300, -500]])
    none = st.Spheres(np.zeros((0, 3)), np.zeros(0))
    scene = st.Scene(none, lit, eye, floor, antialias=antialias).astype(dtype)

    def picture(normal):
        moved = eqx.tree_at(lambda s: s.planes.normal, scene, normal[None])
        return st.render(moved, width=3, height=7, bounces=0, samples=samples)

    slopes = jax.jacfwd(picture)(scene.planes.normal[0])
    assert 0.1 < float(jnp.abs(slopes).max()) < 10
