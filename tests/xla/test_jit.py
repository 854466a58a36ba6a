"""Compilation: compiled functions and the options of the compiler."""

import jax
import jax.numpy as jnp

from spheretrace_jax.xla.jit import compiled, compiler_options


def test_compiled():
    traces = []

    @compiled
    def double(x, *, times=2):
        traces.append(times)
        return times * x

    x = jnp.array([1.0, 2.0])
    constant = lambda y: y + double(x)  # its arguments are concrete, though it is traced
    assert double(x).tolist() == jax.vmap(double)(x).tolist() == [2, 4]
    assert jax.jit(double)(x).tolist() == [2, 4]
    assert jax.jit(constant)(x).tolist() == [3, 6]
    assert jax.grad(lambda x: double(x).sum())(x).tolist() == [2, 2]
    assert jax.jit(jax.grad(lambda x: double(x).sum()))(x).tolist() == [2, 2]
    before = len(traces)
    double(2 * x), double(3 * x)
    assert len(traces) == before


def test_compiler_options():
    options = compiler_options()
    assert (jax.default_backend() != "cpu") or options
    assert jax.jit(jnp.sin, compiler_options=options)(0.0) == 0
