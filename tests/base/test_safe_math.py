"""Safe mathematics: roots, maxima and minima with finite derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spheretrace_jax.base.safe_math import clamp, larger, safe_sqrt, smaller


@pytest.mark.parametrize("square", [-1.0, 0.0])
def test_root_of_0_has_derivative_0(square):
    assert jax.value_and_grad(safe_sqrt)(jnp.array(square)) == (0, 0)


def test_ties_share_derivatives():
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
def test_no_derivative_compares_for_equality(function):
    slopes = lambda a, b: jax.jvp(function, (a, b), (a, b))
    program = jax.make_jaxpr(slopes)(jnp.ones(3), jnp.zeros(3))
    assert "eq" not in str(program).split()
    assert "eq" in str(jax.make_jaxpr(lambda a: jax.jvp(jnp.maximum, (a, a), (a, a)))(1.0)).split()
