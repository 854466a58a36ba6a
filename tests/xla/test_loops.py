"""Loops: unrolled, long, and of several threads."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spheretrace_jax.xla.loops import UNROLL, keep_loop_parallel, loop


@pytest.mark.parametrize("count", [0, 3, UNROLL + 5])
def test_unrolled_and_long_loops(count):
    assert loop(count, lambda i, total: total + i, jnp.array(0)) == sum(range(count))


def test_parallel_loop():
    def squares(mark):
        times = lambda x, k: x * mark(k).astype(x.dtype) ** 2
        return jax.jit(lambda x: jax.lax.map(lambda k: times(x, k), jnp.arange(5)))

    same = lambda k: k
    np.testing.assert_array_equal(
        squares(keep_loop_parallel)(jnp.array(2.0)), squares(same)(jnp.array(2.0))
    )
    slope = jax.jacrev(squares(keep_loop_parallel))(jnp.array(2.0))
    np.testing.assert_array_equal(slope, np.arange(5.0) ** 2)
    calls = lambda mark: "custom-call" in squares(mark).lower(jnp.array(2.0)).compile().as_text()
    assert not calls(same)
    assert calls(keep_loop_parallel) == (jax.default_backend() == "cpu")
