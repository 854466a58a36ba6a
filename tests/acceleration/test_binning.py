import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spheretrace_jax.acceleration import binning
from spheretrace_jax.acceleration.binning import BinBounds, build_bins
from spheretrace_jax.base.vec import Vec

SIZE = (13.0, 7, 4)


def boxes(n, largest, seed=0):
    rng = np.random.default_rng(seed)
    low = rng.uniform(-3, np.array(SIZE) + 2, (n, 3))
    return low, low + rng.uniform(0, largest, (n, 3))


def sorted_boxes(low, high):
    center, radius = Vec(*jnp.asarray(low.T)), jnp.ones(len(low))
    bounds = BinBounds(
        tuple(jnp.asarray(low.T)), tuple(jnp.asarray(high.T)), jnp.array(SIZE), jnp.array(2.0)
    )
    both = jax.tree.map(lambda x: jnp.stack([x, x]), bounds)
    cells = jax.jit(lambda: build_bins(center, radius, both, 400))()
    return jax.tree.map(lambda x: x[1], cells)


def listed(cells, *place):
    """Who is in the lists for a place."""
    first, count = (int(x) for x in cells.slots(cells.cell_at(*(jnp.asarray(x) for x in place))))
    return [*cells.ids[: cells.start[1]].tolist(), *cells.ids[first : first + count].tolist()]


@pytest.mark.parametrize("room", [(3, 1 << 14), (2, 0), (1, 0)], ids=["ample", "tight", "least"])
@pytest.mark.parametrize("largest", [0.1, 2, 30])
def test_every_box_is_listed_wherever_it_reaches(largest, room, monkeypatch):
    monkeypatch.setattr(binning, "PAIRS_PER_SPHERE", room[0])
    monkeypatch.setattr(binning, "EXTRA_PAIRS", room[1])
    low, high = boxes(60, largest)
    cells = sorted_boxes(low, high)
    assert cells.start[-1] <= room[0] * 60 + room[1]
    rng = np.random.default_rng(1)
    for place in rng.uniform(-4, np.array(SIZE) + 4, (50, 3)):
        there = set(np.flatnonzero(((low <= place) & (place <= high)).all(axis=1)))
        found = listed(cells, *place)
        assert there <= set(found) and len(found) == len(set(found))


def test_cells_are_as_narrow_as_there_is_room_for(monkeypatch):
    low, high = boxes(60, 2)
    assert sorted_boxes(low, high).width == 1
    monkeypatch.setattr(binning, "PAIRS_PER_SPHERE", 2)
    monkeypatch.setattr(binning, "EXTRA_PAIRS", 0)
    width, counts = sorted_boxes(low, high).width, sorted_boxes(low, high).counts
    assert 1 < float(width) < np.inf and 1 < np.prod(np.asarray(counts)) < np.prod(SIZE)


def test_what_is_in_many_cells_is_looked_at_everywhere():
    low, high = boxes(60, 0.1)
    low[7], high[7] = -100, 100
    cells = sorted_boxes(low, high)
    assert cells.ids[: cells.start[1]].tolist() == [7]


def test_what_is_nowhere_is_in_no_list():
    low, high = boxes(60, 0.1)
    low[7], high[7] = 1, 0
    cells = sorted_boxes(low, high)
    used = cells.ids[: int(cells.start[int(np.prod(cells.counts)) + 1])]
    assert 7 not in used and len(set(used.tolist())) == 59


def test_the_spheres_of_a_cell_are_in_order():
    cells = sorted_boxes(*boxes(60, 2))
    for a, b in zip(cells.start[:-1].tolist(), cells.start[1:].tolist(), strict=True):
        numbers = cells.ids[a:b].tolist()
        assert numbers == sorted(numbers)


@pytest.mark.parametrize("digits", [1, 2, 3])
def test_sorting_by_several_digits_keeps_the_order_of_equals(digits):
    rng = np.random.default_rng(digits)
    n = 1 << 20
    cell = jnp.asarray(rng.integers(0, 1 << 10 * digits, n), jnp.int32)
    order = jax.jit(binning._stable_order)(cell, jnp.max(cell))
    np.testing.assert_array_equal(order, np.argsort(np.asarray(cell), kind="stable"))
