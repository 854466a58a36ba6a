import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spheretrace_jax.base.safe_math import clamp, larger, safe_sqrt, smaller
from spheretrace_jax.base.vec import Vec, cross, dot, norm, reflect, unit, vec

A, B = vec(jnp.array([1.0, -2.0, 3.0])), vec(jnp.array([0.5, 4.0, -1.0]))


def rows(v: Vec) -> np.ndarray:
    return np.array([v.x, v.y, v.z])


def test_products_are_numpys():
    assert dot(A, B) == np.dot(rows(A), rows(B))
    np.testing.assert_array_equal(rows(cross(A, B)), np.cross(rows(A), rows(B)))


def test_a_product_of_vectors_is_per_component_as_colours_multiply():
    np.testing.assert_array_equal(rows(A * B), rows(A) * rows(B))


def test_reflection_keeps_the_length_and_turns_the_normal_part():
    normal = unit(B)
    mirrored = reflect(A, normal)
    np.testing.assert_allclose(norm(mirrored), norm(A), rtol=1e-15)
    np.testing.assert_allclose(dot(mirrored, normal), -dot(A, normal), rtol=1e-14)


@pytest.mark.parametrize("function", [norm, lambda v: unit(v).x])
def test_the_zero_vector_has_finite_values_and_derivatives(function):
    zero = Vec(*jnp.zeros(3))
    value, derivative = jax.value_and_grad(function)(zero)
    assert value == 0
    assert np.isfinite(rows(derivative)).all()


@pytest.mark.parametrize("square", [-1.0, 0.0])
def test_the_root_of_nothing_is_0_with_derivative_0(square):
    assert jax.value_and_grad(safe_sqrt)(jnp.array(square)) == (0, 0)


def test_the_larger_and_the_smaller_share_the_derivatives():
    a, b = jnp.array([1.0, 2.0, 3.0, 0.0]), jnp.array([2.0, 2.0, -1.0, -0.0])
    np.testing.assert_array_equal(larger(a, b), np.maximum(a, b))
    np.testing.assert_array_equal(smaller(a, b), np.minimum(a, b))
    np.testing.assert_array_equal(clamp(a, 0.5, 2), np.clip(a, 0.5, 2))
    da, db = jnp.full(4, 3.0), jnp.full(4, 5.0)
    _, most = jax.jvp(larger, (a, b), (da, db))
    _, least = jax.jvp(smaller, (a, b), (da, db))
    np.testing.assert_array_equal(most, [5, 5, 3, 5])
    np.testing.assert_array_equal(least, [3, 3, 5, 3])


@pytest.mark.parametrize("function", [larger, smaller, lambda a, b: clamp(a, b, 1)])
def test_no_derivative_asks_whether_rounded_numbers_are_equal(function):
    slopes = lambda a, b: jax.jvp(function, (a, b), (a, b))
    program = jax.make_jaxpr(slopes)(jnp.ones(3), jnp.zeros(3))
    assert "eq" not in str(program).split()
    assert "eq" in str(jax.make_jaxpr(lambda a: jax.jvp(jnp.maximum, (a, a), (a, a)))(1.0)).split()
