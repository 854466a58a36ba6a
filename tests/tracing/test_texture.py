"""Textures of spheres and checkers of planes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spheretrace_jax as st
from spheretrace_jax.base.vec import SplitVec, vec
from spheretrace_jax.tracing.tables import build_tables
from spheretrace_jax.tracing.texture import lookup, second_square, sphere_uv

IMAGE = jnp.asarray(np.random.default_rng(0).uniform(size=(4, 8, 3)))


def color_at(u, v):
    c = lookup(IMAGE, jnp.array(float(u)), jnp.array(float(v)))
    return np.array([c.x, c.y, c.z])


@pytest.mark.parametrize(
    ("direction", "uv"),
    [([1, 0, 0], (0, 0.5)), ([0, 1, 0], (0.25, 0.5)), ([-1, 0, 0], (0.5, 0.5)),
     ([0, -1, 0], (0.75, 0.5)), ([0, 0, 1], (0, 0)), ([0, 0, -1], (0, 1)),
     ([0, 1, 1], (0.25, 0.25))],
)  # fmt: skip
def test_u_is_azimuth_and_v_polar_angle(direction, uv):
    np.testing.assert_allclose(sphere_uv(vec(jnp.array(direction, float))), uv, atol=1e-15)


def test_poles_have_finite_derivatives():
    derivative = jax.grad(lambda d: sum(sphere_uv(d)))(SplitVec(*jnp.array([0.0, 0, 1])))
    assert np.isfinite([derivative.x, derivative.y, derivative.z]).all()


def test_lookup_is_bilinear():
    np.testing.assert_allclose(color_at(2.5 / 8, 1.5 / 4), IMAGE[1, 2], rtol=1e-14)
    middle = (IMAGE[1, 2] + IMAGE[1, 3] + IMAGE[2, 2] + IMAGE[2, 3]) / 4
    np.testing.assert_allclose(color_at(3 / 8, 2 / 4), middle, rtol=1e-14)


def test_lookup_wraps_in_u_and_clamps_in_v():
    np.testing.assert_allclose(color_at(0, 1.5 / 4), (IMAGE[1, 0] + IMAGE[1, 7]) / 2, rtol=1e-14)
    np.testing.assert_allclose(color_at(1, 1.5 / 4), color_at(0, 1.5 / 4), rtol=1e-14)
    np.testing.assert_allclose(color_at(2.5 / 8, 0), IMAGE[0, 2], rtol=1e-14)
    np.testing.assert_allclose(color_at(2.5 / 8, 1), IMAGE[3, 2], rtol=1e-14)


@pytest.mark.parametrize("normal", [[0, 0, 2], [0, 3, 0], [1, 0, 0]])
def test_checker_squares_alternate(normal):
    planes = st.Planes([[10.0, 20, 30]], [normal], checker_color=(1.0, 0, 0), checker_size=4.0)
    lights = st.Lights([[0.0, 0, 0]])
    tables = build_tables(st.Scene(st.Spheres(np.zeros((0, 3)), []), lights, planes=planes))
    inside_plane = [k for k in range(3) if normal[k] == 0]
    squares = {}
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            point = np.array([10.0, 20, 30])
            point[inside_plane] += [4 * i + 2, 4 * j + 2]
            other, color = second_square(tables, jnp.array(0), vec(jnp.asarray(point)))
            squares[i, j] = bool(other)
            assert float(color.x) == 1
    assert all(squares[i, j] != squares[i + 1, j] for i in (-1, 0) for j in (-1, 0, 1))
    assert all(squares[i, j] != squares[i, j + 1] for i in (-1, 0, 1) for j in (-1, 0))


def test_texture_multiplies_color():
    texture = st.Texture(np.full((2, 2, 3), [0.5, 0.25, 1.0]))
    spheres = lambda pic: st.Spheres([[0.0, 0, 0]], [100.0], (0.8, 0.6, 0.4), pic=pic)
    plain, textured = (
        st.render(
            st.Scene(spheres(pic), st.Lights([[9.0, 9, 900]]), textures=[texture]),
            width=8,
            height=8,
        )
        for pic in (0, 1)
    )
    np.testing.assert_allclose(textured, plain * jnp.broadcast_to(texture.image[0, 0], plain.shape))
    assert textured.max() > 0.1
    assert not st.needs(st.Scene(spheres(0), st.Lights([[9.0, 9, 900]]))).textures
