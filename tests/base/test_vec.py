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
