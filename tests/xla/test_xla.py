import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spheretrace_jax.xla.barriers import compute_once, compute_pair_once
from spheretrace_jax.xla.compaction import nth_set, prefix_sum, replace_where, while_active
from spheretrace_jax.xla.gather import gather_rows, smallest_int
from spheretrace_jax.xla.jit import compiled, compiler_options
from spheretrace_jax.xla.loops import UNROLL, keep_loop_parallel, loop


@pytest.mark.parametrize("count", [1, 2, 3, 9, UNROLL, UNROLL + 1, 200])
def test_fetching_rows_and_its_derivatives_are_those_of_indexing(count):
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


def test_rows_that_do_not_exist_give_finite_numbers():
    ids = jnp.array([-1, 5, 100], jnp.int8)
    for count in (0, 1, 3, 40):
        (column,) = gather_rows((jnp.arange(float(count)),), ids)
        assert np.isfinite(column).all()


@pytest.mark.parametrize("count", [0, 3, UNROLL + 5])
def test_short_and_long_loops_run_as_often(count):
    assert loop(count, lambda i, total: total + i, jnp.array(0)) == sum(range(count))


def test_a_large_loop_is_the_same_loop_with_a_call_in_it():
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


def test_a_materialised_phase_has_its_value_and_derivative():
    witness = jnp.array(512.0)
    double = jax.jit(lambda x: compute_once(lambda: 2 * x, witness))
    assert double(jnp.array(3.0)) == 6 and jax.grad(double)(jnp.array(3.0)) == 2
    pair = lambda x: compute_pair_once(lambda: (x**2, 3 * x), witness)
    assert pair(jnp.array(2.0)) == (4, 6)
    assert jax.grad(lambda x: sum(pair(x)))(jnp.array(2.0)) == 7


@pytest.mark.parametrize(
    ("count", "dtype"), [(127, "int8"), (128, "int16"), (32767, "int16"), (32768, "int32")]
)
def test_numbers_of_objects_fit_their_type(count, dtype):
    assert smallest_int(count) == dtype
    assert jnp.asarray(count, smallest_int(count)) == count


@pytest.mark.parametrize(("n", "density"), [(1, 1.0), (31, 0.5), (32, 0.5), (10007, 0.03), (70, 0)])
def test_the_places_of_the_marked_are_those_that_numpy_finds(n, density):
    marked = np.random.default_rng(n).uniform(size=n) < density
    total, place = nth_set(jnp.asarray(marked))
    assert int(total) == marked.sum()
    found = place(jnp.arange(marked.sum(), dtype=jnp.int32))
    np.testing.assert_array_equal(found, np.nonzero(marked)[0])


@pytest.mark.parametrize("density", [0, 0.02, 0.4, 1])
@pytest.mark.parametrize(("n", "size"), [(1000, 16), (1000, 250), (7, 7)])
def test_filling_replaces_the_marked_and_only_works_for_them(n, size, density):
    rng = np.random.default_rng(n)
    marked = jnp.asarray(rng.uniform(size=n) < density)
    x, y, z = jnp.asarray(rng.standard_normal((3, n)))
    worked = []

    def work(places, counts):
        jax.debug.callback(lambda c: worked.append(int(c.sum())), counts)
        return jnp.sin(x[places]) * z[places]

    filled = replace_where(y, marked, work, size)
    jax.effects_barrier()
    np.testing.assert_allclose(filled, jnp.where(marked, jnp.sin(x) * z, y), rtol=1e-15)
    assert sum(worked) == marked.sum()
    assert len(worked) == -(-int(marked.sum()) // size)


def test_filling_has_the_derivatives_of_a_selection():
    n = 50
    marked = jnp.arange(n) % 3 == 0
    x, weights = jnp.linspace(0.0, 2, n), jnp.cos(jnp.linspace(0.0, 50, n))
    ours = lambda x: weights @ replace_where(x**3, marked, lambda places, _: jnp.sin(x[places]), 8)
    plain = lambda x: weights @ jnp.where(marked, jnp.sin(x), x**3)
    np.testing.assert_allclose(jax.grad(ours)(x), jax.grad(plain)(x), rtol=1e-14)
    along = jnp.ones(n)
    np.testing.assert_allclose(jax.jvp(ours, (x,), (along,))[1], jax.grad(plain)(x).sum())


@pytest.mark.parametrize("n", [1, 2, 7, 1000])
def test_running_sums_are_those_of_numpy(n):
    numbers = np.random.default_rng(n).integers(-5, 90, n)
    sums = prefix_sum(jnp.asarray(numbers, jnp.int32))
    np.testing.assert_array_equal(sums, np.cumsum(numbers))


@pytest.mark.parametrize("n", [3, 1 << 13])
def test_rays_go_on_until_they_are_done_and_no_further(n):
    goal = jnp.asarray(np.random.default_rng(n).geometric(0.05, n), jnp.int32)
    alive = lambda goal, now: now[0] < goal

    def step(goal, now):
        more = now[0] < goal
        return now[0] + jnp.where(more, 1, 0), now[1] + jnp.where(more, 2.0, 0)

    start = jnp.zeros(n, jnp.int32), jnp.zeros((n,))
    steps, double = while_active(step, alive, goal, start)
    np.testing.assert_array_equal(steps, goal)
    np.testing.assert_array_equal(double, 2 * goal.astype(float))


def test_a_compiled_function_works_alone_and_inside_others():
    traces = []

    @compiled
    def double(x, *, times=2):
        traces.append(times)
        return times * x

    x = jnp.array([1.0, 2.0])
    constant = lambda y: y + double(x)  # its arguments are known, though it is traced
    assert double(x).tolist() == jax.vmap(double)(x).tolist() == [2, 4]
    assert jax.jit(double)(x).tolist() == [2, 4]
    assert jax.jit(constant)(x).tolist() == [3, 6]
    assert jax.grad(lambda x: double(x).sum())(x).tolist() == [2, 2]
    assert jax.jit(jax.grad(lambda x: double(x).sum()))(x).tolist() == [2, 2]
    before = len(traces)
    double(2 * x), double(3 * x)
    assert len(traces) == before


def test_what_the_compiler_is_told_is_known_to_it():
    options = compiler_options()
    assert (jax.default_backend() != "cpu") or options
    assert jax.jit(jnp.sin, compiler_options=options)(0.0) == 0
