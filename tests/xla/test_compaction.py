"""Stream compaction: work only where a mask is set."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spheretrace_jax.xla.compaction import nth_set, prefix_sum, replace_where, while_active


@pytest.mark.parametrize(("n", "density"), [(1, 1.0), (31, 0.5), (32, 0.5), (10007, 0.03), (70, 0)])
def test_nth_set(n, density):
    mask = np.random.default_rng(n).uniform(size=n) < density
    total, index = nth_set(jnp.asarray(mask))
    assert int(total) == mask.sum()
    found = index(jnp.arange(mask.sum(), dtype=jnp.int32))
    np.testing.assert_array_equal(found, np.nonzero(mask)[0])


@pytest.mark.parametrize("density", [0, 0.02, 0.4, 1])
@pytest.mark.parametrize(("n", "size"), [(1000, 16), (1000, 250), (7, 7)])
def test_replace_where(n, size, density):
    rng = np.random.default_rng(n)
    mask = jnp.asarray(rng.uniform(size=n) < density)
    x, y, z = jnp.asarray(rng.standard_normal((3, n)))
    worked = []

    def work(indices, counts):
        jax.debug.callback(lambda c: worked.append(int(c.sum())), counts)
        return jnp.sin(x[indices]) * z[indices]

    filled = replace_where(y, mask, work, size)
    jax.effects_barrier()
    np.testing.assert_allclose(filled, jnp.where(mask, jnp.sin(x) * z, y), rtol=1e-15)
    assert sum(worked) == mask.sum()
    assert len(worked) == -(-int(mask.sum()) // size)


def test_derivatives_of_replace_where():
    n = 50
    mask = jnp.arange(n) % 3 == 0
    x, weights = jnp.linspace(0.0, 2, n), jnp.cos(jnp.linspace(0.0, 50, n))
    ours = lambda x: weights @ replace_where(x**3, mask, lambda indices, _: jnp.sin(x[indices]), 8)
    plain = lambda x: weights @ jnp.where(mask, jnp.sin(x), x**3)
    np.testing.assert_allclose(jax.grad(ours)(x), jax.grad(plain)(x), rtol=1e-14)
    along = jnp.ones(n)
    np.testing.assert_allclose(jax.jvp(ours, (x,), (along,))[1], jax.grad(plain)(x).sum())


@pytest.mark.parametrize("n", [1, 2, 7, 1000])
def test_prefix_sum(n):
    numbers = np.random.default_rng(n).integers(-5, 90, n)
    sums = prefix_sum(jnp.asarray(numbers, jnp.int32))
    np.testing.assert_array_equal(sums, np.cumsum(numbers))


@pytest.mark.parametrize("n", [3, 1 << 13])
def test_while_active(n):
    goal = jnp.asarray(np.random.default_rng(n).geometric(0.05, n), jnp.int32)
    alive = lambda goal, now: now[0] < goal

    def step(goal, now):
        go_on = now[0] < goal
        return now[0] + jnp.where(go_on, 1, 0), now[1] + jnp.where(go_on, 2.0, 0)

    start = jnp.zeros(n, jnp.int32), jnp.zeros((n,))
    steps, double = while_active(step, alive, goal, start)
    np.testing.assert_array_equal(steps, goal)
    np.testing.assert_array_equal(double, 2 * goal.astype(float))
