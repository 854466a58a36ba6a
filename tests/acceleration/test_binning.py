"""Binning: every sphere is found in every bin that its bounds touch."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spheretrace_jax.acceleration import binning
from spheretrace_jax.acceleration.binning import BinBounds, build_bins
from spheretrace_jax.base.vec import SplitVec

SIZE = (13.0, 7, 4)


def boxes(n, largest, seed=0):
    rng = np.random.default_rng(seed)
    low = rng.uniform(-3, np.array(SIZE) + 2, (n, 3))
    return low, low + rng.uniform(0, largest, (n, 3))


def binned_boxes(low, high):
    center, radius = SplitVec(*jnp.asarray(low.T)), jnp.ones(len(low))
    bounds = BinBounds(
        tuple(jnp.asarray(low.T)), tuple(jnp.asarray(high.T)), jnp.array(SIZE), jnp.array(2.0)
    )
    both = jax.tree.map(lambda x: jnp.stack([x, x]), bounds)
    bins = jax.jit(lambda: build_bins(center, radius, both, 400))()
    return jax.tree.map(lambda x: x[1], bins)


def members(bins, *position):
    """Returns the spheres of the bin at a position, those of bin 0 first."""
    first, count = (int(x) for x in bins.slots(bins.cell_at(*(jnp.asarray(x) for x in position))))
    return [*bins.ids[: bins.start[1]].tolist(), *bins.ids[first : first + count].tolist()]


@pytest.mark.parametrize("room", [(3, 1 << 14), (2, 0), (1, 0)], ids=["ample", "tight", "least"])
@pytest.mark.parametrize("largest", [0.1, 2, 30])
def test_box_is_in_all_bins_it_touches(largest, room, monkeypatch):
    monkeypatch.setattr(binning, "PAIRS_PER_SPHERE", room[0])
    monkeypatch.setattr(binning, "EXTRA_PAIRS", room[1])
    low, high = boxes(60, largest)
    bins = binned_boxes(low, high)
    assert bins.start[-1] <= room[0] * 60 + room[1]
    rng = np.random.default_rng(1)
    for position in rng.uniform(-4, np.array(SIZE) + 4, (50, 3)):
        touching = set(np.flatnonzero(((low <= position) & (position <= high)).all(axis=1)))
        found = members(bins, *position)
        assert touching <= set(found) and len(found) == len(set(found))


def test_bins_are_as_narrow_as_room_allows(monkeypatch):
    low, high = boxes(60, 2)
    assert binned_boxes(low, high).width == 1
    monkeypatch.setattr(binning, "PAIRS_PER_SPHERE", 2)
    monkeypatch.setattr(binning, "EXTRA_PAIRS", 0)
    width, counts = binned_boxes(low, high).width, binned_boxes(low, high).counts
    assert 1 < float(width) < np.inf and 1 < np.prod(np.asarray(counts)) < np.prod(SIZE)


def test_wide_spheres_are_in_bin_0():
    low, high = boxes(60, 0.1)
    low[7], high[7] = -100, 100
    bins = binned_boxes(low, high)
    assert bins.ids[: bins.start[1]].tolist() == [7]


def test_empty_box_is_in_no_bin():
    low, high = boxes(60, 0.1)
    low[7], high[7] = 1, 0
    bins = binned_boxes(low, high)
    used = bins.ids[: int(bins.start[int(np.prod(bins.counts)) + 1])]
    assert 7 not in used and len(set(used.tolist())) == 59


def test_spheres_of_a_bin_are_in_order():
    bins = binned_boxes(*boxes(60, 2))
    for a, b in zip(bins.start[:-1].tolist(), bins.start[1:].tolist(), strict=True):
        numbers = bins.ids[a:b].tolist()
        assert numbers == sorted(numbers)


@pytest.mark.parametrize("digits", [1, 2, 3])
def test_radix_sort_is_stable(digits):
    rng = np.random.default_rng(digits)
    n = 1 << 20
    bin_of = jnp.asarray(rng.integers(0, 1 << 10 * digits, n), jnp.int32)
    order = jax.jit(binning.stable_order)(bin_of, jnp.max(bin_of))
    np.testing.assert_array_equal(order, np.argsort(np.asarray(bin_of), kind="stable"))
