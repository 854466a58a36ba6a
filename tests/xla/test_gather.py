"""Gathers: rows of tables by their index."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spheretrace_jax.xla.gather import gather_rows, smallest_int
from spheretrace_jax.xla.loops import UNROLL


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2, 3, 9, UNROLL, UNROLL + 1, 200])
def test_rows_and_derivatives(count):
    rng = np.random.default_rng(count)
    table = (jnp.asarray(rng.standard_normal(count)), jnp.asarray(rng.standard_normal(count)))
    ids = jnp.asarray(rng.integers(0, count, (5, 40)), smallest_int(count))
    weights = jnp.asarray(rng.standard_normal((5, 40)))
    mix = lambda a, b: jnp.sum(weights * a**2 * b)
    ours = lambda t: mix(*gather_rows(t, ids))
    plain = lambda t: mix(t[0][ids], t[1][ids])
    np.testing.assert_allclose(ours(table), plain(table), rtol=1e-14)
    for a, b in zip(jax.grad(ours)(table), jax.grad(plain)(table), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)
    tangent = (jnp.ones(count), -jnp.ones(count))
    pushed = [jax.jvp(f, (table,), (tangent,))[1] for f in (ours, plain)]
    np.testing.assert_allclose(*pushed, rtol=1e-11)


def test_rows_out_of_range_are_finite():
    ids = jnp.array([-1, 5, 100], jnp.int8)
    for count in (0, 1, 3, 40):
        (column,) = gather_rows((jnp.arange(float(count)),), ids)
        assert np.isfinite(column).all()


@pytest.mark.parametrize(
    ("count", "dtype"), [(127, "int8"), (128, "int16"), (32767, "int16"), (32768, "int32")]
)
def test_smallest_int(count, dtype):
    assert smallest_int(count) == dtype
    assert jnp.asarray(count, smallest_int(count)) == count
