"""Stopped derivatives: first ones are stopped, second ones are those of the first."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spheretrace_jax.base.derivatives import stop_first_gradient

X = jnp.asarray(0.7)


def held(x: jax.Array) -> jax.Array:
    """Returns x m^2 with m = sin x, which the first derivative, m^2, takes as constant."""
    return x * jnp.sin(stop_first_gradient({"x": x, "number": 3})["x"]) ** 2


@pytest.mark.parametrize("wrap", [lambda f: f, jax.jit, jax.checkpoint])
@pytest.mark.parametrize("inner", [jax.jacfwd, jax.jacrev])
@pytest.mark.parametrize("outer", [jax.jacfwd, jax.jacrev])
def test_the_second_derivative_is_that_of_the_first(wrap, inner, outer):
    first = inner(wrap(held))
    np.testing.assert_allclose(first(X), jnp.sin(X) ** 2, rtol=1e-15)
    np.testing.assert_allclose(outer(first)(X), jnp.sin(2 * X), rtol=1e-15)
    np.testing.assert_allclose(jax.jit(outer(jax.jit(first)))(X), jnp.sin(2 * X), rtol=1e-15)


def test_many_at_once_and_in_loops():
    xs = jnp.linspace(0, 1, 5)
    second = jax.vmap(jax.hessian(held))(xs)
    np.testing.assert_allclose(second, jnp.sin(2 * xs), rtol=1e-15)
    looped = lambda x: jax.lax.scan(lambda sum_, _: (sum_ + held(x), None), 0.0, None, length=3)[0]
    np.testing.assert_allclose(jax.hessian(looped)(X), 3 * jnp.sin(2 * X), rtol=1e-14)
