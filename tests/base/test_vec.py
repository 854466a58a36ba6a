"""Vectors: products, reflection and the zero vector."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spheretrace_jax.base.vec import SplitVec, Vec, cross, dot, norm, reflect, unit, vec

A, B = vec(jnp.array([1.0, -2.0, 3.0])), vec(jnp.array([0.5, 4.0, -1.0]))


def rows(v: Vec) -> np.ndarray:
    return np.array([v.x, v.y, v.z])


def test_dot_and_cross():
    assert dot(A, B) == np.dot(rows(A), rows(B))
    np.testing.assert_array_equal(rows(cross(A, B)), np.cross(rows(A), rows(B)))


def test_product_is_per_component():
    np.testing.assert_array_equal(rows(A * B), rows(A) * rows(B))


def test_reflection():
    normal = unit(B)
    mirrored = reflect(A, normal)
    np.testing.assert_allclose(norm(mirrored), norm(A), rtol=1e-15)
    np.testing.assert_allclose(dot(mirrored, normal), -dot(A, normal), rtol=1e-14)


@pytest.mark.parametrize("function", [norm, lambda v: unit(v).x])
def test_zero_vector_is_finite(function):
    zero = SplitVec(*jnp.zeros(3))
    value, derivative = jax.value_and_grad(function)(zero)
    assert value == 0
    assert np.isfinite(rows(derivative)).all()


def moving_unit(t: jax.Array, size: float) -> jax.Array:
    """Returns the unit vector along size (a + t b), and its derivative by t."""
    a, b = (jax.tree.map(lambda x: x.astype(t.dtype) * size, v) for v in (A, B))
    at = lambda t: unit(a + b * t)
    u, slope = jax.jvp(at, (t,), (jnp.ones_like(t),))
    return jnp.stack([u.x, u.y, u.z, slope.x, slope.y, slope.z])


@pytest.mark.parametrize("size", [1.0, 1e10])  # of lights so far away |a|^4 overflows in float32
def test_second_derivatives_of_unit_vectors(size):
    h = 1e-4
    difference = (moving_unit(jnp.asarray(h), size) - moving_unit(jnp.asarray(-h), size)) / (2 * h)
    single = jax.jacfwd(moving_unit)(jnp.zeros((), np.float32), size)
    assert single.dtype == np.float32
    np.testing.assert_allclose(jax.jacfwd(moving_unit)(jnp.zeros(()), size), difference, rtol=1e-6)
    np.testing.assert_allclose(single, difference, rtol=1e-5)
