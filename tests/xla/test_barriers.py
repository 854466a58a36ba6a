"""Barriers: values that are computed once."""

import jax
import jax.numpy as jnp

from spheretrace_jax.xla.barriers import barrier, compute_once, compute_pair_once


def test_compute_once():
    witness = jnp.array(512.0)
    double = jax.jit(lambda x: compute_once(lambda: 2 * x, witness))
    assert double(jnp.array(3.0)) == 6 and jax.grad(double)(jnp.array(3.0)) == 2
    pair = lambda x: compute_pair_once(lambda: (x**2, 3 * x), witness)
    assert pair(jnp.array(2.0)) == (4, 6)
    assert jax.grad(lambda x: sum(pair(x)))(jnp.array(2.0)) == 7


def test_barrier_commits_nothing_to_a_device():
    # what is computed from arrays that are committed would be compiled again
    assert not jax.jit(lambda x: barrier(x * 2) + 1)(jnp.ones(3)).committed
