"""Fresnel's equations against Snell's law in NumPy, and against differences where they are bad."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import SCENES

import spheretrace_jax as st
from spheretrace_jax.tracing.fresnel import coat_transmission, fresnel

COSINES = np.array([0.0, 1e-3, 0.02, 0.1, 0.3, 0.7, 0.99, 1.0])
INDICES = np.array([1.0001, 1.1, 1.333, 1.5, 2.5, 10.0])
SIZE = dict(width=24, height=20, bounces=0)


def by_snell(cosine: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Returns F from the angles of incidence and refraction."""
    incident = np.arccos(cosine)
    refracted = np.arcsin(np.sin(incident) / n)
    r_s = (cosine - n * np.cos(refracted)) / (cosine + n * np.cos(refracted))
    r_p = (n * cosine - np.cos(refracted)) / (n * cosine + np.cos(refracted))
    return (r_s**2 + r_p**2) / 2


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_reflectance(dtype):
    c, n = (x.astype(dtype) for x in np.meshgrid(COSINES, INDICES))
    found = fresnel(jnp.asarray(c), jnp.asarray(n))
    assert found.dtype == dtype
    np.testing.assert_allclose(found, by_snell(c.astype(float), n.astype(float)), atol=4e-6)
    normal = ((INDICES - 1) / (INDICES + 1)) ** 2
    np.testing.assert_allclose(fresnel(jnp.asarray(1.0), jnp.asarray(INDICES)), normal, rtol=1e-12)


def test_brewsters_angle_reflects_only_one_polarisation():
    n = 1.5
    cosine = np.cos(np.arctan(n))
    half = ((n * n - 1) / (n * n + 1)) ** 2 / 2
    np.testing.assert_allclose(fresnel(jnp.asarray(cosine), jnp.asarray(n)), half, rtol=1e-12)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_no_coat_is_exactly_nothing(dtype):
    cosine = jnp.asarray([0.0, 1e-30, 1e-12, 1e-7, 1e-3, 0.5, 1, 1.0000001, -0.3], dtype)
    one = jnp.ones_like(cosine)
    assert not np.asarray(fresnel(cosine, one)).any()
    assert (np.asarray(coat_transmission(cosine, cosine, one)) == 1).all()
    slopes = jax.vmap(jax.grad(fresnel, (0, 1)))(cosine, one)
    assert not np.asarray(slopes).any()


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_derivatives_are_finite_everywhere(dtype):
    cosine = jnp.asarray([0.0, 1e-30, 1e-12, 1e-7, 1e-3, 0.5, 1, -0.3], dtype)
    for n in (1.0, 1 + 1e-6, 1.5, 2.5):
        index = jnp.full_like(cosine, n)
        for derivative in (jax.grad(fresnel, (0, 1)), jax.hessian(fresnel, (0, 1))):
            found = jax.tree.leaves(jax.vmap(derivative)(cosine, index))
            assert np.isfinite(found).all(), n


@pytest.mark.parametrize("n", [1.1, 1.5, 2.5])
@pytest.mark.parametrize("c", [0.0, 0.3, 1.0])
def test_first_and_second_derivatives(c, n):
    both = jnp.asarray(c), jnp.asarray(n)
    # at the ends differences are of one side, of second order
    h = 1e-4
    at = np.array([0, 1, 2, 3]) * h * (-1 if c == 1 else 1)
    by_c, by_n = (float(x) for x in jax.grad(fresnel, (0, 1))(*both))
    (by_cc, by_cn), (_, by_nn) = (map(float, row) for row in jax.hessian(fresnel, (0, 1))(*both))
    f = by_snell(np.clip(c + at, 0, 1), n)
    step = at[1]
    np.testing.assert_allclose(
        by_c, (-3 * f[0] + 4 * f[1] - f[2]) / (2 * step), rtol=1e-5, atol=1e-5
    )
    second = (2 * f[0] - 5 * f[1] + 4 * f[2] - f[3]) / step**2
    np.testing.assert_allclose(by_cc, second, rtol=1e-3, atol=1e-4)
    f = by_snell(c, n + h * np.array([-1, 0, 1]))
    np.testing.assert_allclose(by_n, (f[2] - f[0]) / (2 * h), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(by_nn, (f[2] - 2 * f[1] + f[0]) / h**2, rtol=1e-4, atol=1e-4)
    slope = lambda n: float(jax.grad(fresnel)(both[0], jnp.asarray(n)))
    np.testing.assert_allclose(by_cn, (slope(n + h) - slope(n - h)) / (2 * h), rtol=1e-5, atol=1e-6)


def test_second_derivative_at_no_coat():
    # (n - 1)^2 / 2 at normal incidence
    np.testing.assert_allclose(
        jax.hessian(fresnel, 1)(jnp.array(1.0), jnp.array(1.0)), 0.5, rtol=1e-12
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["two_coloured_lights", "planes"])
def test_a_coat_of_index_1_changes_no_picture(name):
    scene = SCENES[name]
    needs = st.needs(scene)
    coated = st.needs(scene, free=("ior",))
    assert not needs.coated and coated.coated
    pictures = [st.render(scene, needs=n, **SIZE) for n in (needs, coated)]
    np.testing.assert_allclose(*pictures, rtol=4e-15, atol=1e-15)


def test_derivatives_of_a_picture_by_indices():
    scene = SCENES["coated"]
    at = lambda s: [s.spheres.ior, s.planes.ior]
    values = [jnp.array([1.5, 1.1, 2.0]), jnp.array([1.3])]
    picture = jax.jit(lambda v: st.render(eqx.tree_at(at, scene, v), **SIZE))
    slopes = jax.jacfwd(picture)(values)
    for k, value in enumerate(values):
        for i in range(len(value)):
            h = 1e-5
            step = lambda sign, k=k, i=i: [
                v.at[i].add(sign * h) if j == k else v for j, v in enumerate(values)
            ]
            difference = (picture(step(1)) - picture(step(-1))) / (2 * h)
            found = slopes[k][..., i]
            assert float(jnp.abs(found).max()) > 0.02
            np.testing.assert_allclose(found, difference, atol=1e-8)
