"""The block jackknife: blocks of pixels, and its covariance against leaving out one by one."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.wrong_models import START, TRUTH, drawn

import spheretrace_jax as st
from spheretrace_jax.fit.diagnosis.block_jackknife import (
    BlockJackknife,
    block_numbers,
    bright_halves,
)
from spheretrace_jax.fit.diagnosis.evidence import objects_at
from spheretrace_jax.fit.diagnosis.uncertainty import square_of_free


def test_blocks_hold_a_part_of_each_object():
    row, column = np.mgrid[:40, :60]
    objects = np.where(np.hypot(row - 12, column - 15) < 11, 0, -1)
    objects[np.hypot(row - 30, column - 50) < 5] = 1
    counts = objects >= 0
    counts[:, :10] = False
    numbers = block_numbers(counts, objects)
    assert (numbers[~counts] == -1).all()
    for k in (0, 1):
        here = counts & (objects == k)
        sizes = np.bincount(numbers[here], minlength=16)
        assert sizes.max() - sizes.min() <= 4
        # each block is a patch: it spreads over much less than the object does
        for b in range(16):
            rows, columns = np.nonzero(here & (numbers == b))
            assert np.ptp(rows) * np.ptp(columns) < 0.2 * np.ptp(row[here]) * np.ptp(column[here])
    # the first bit halves along the longer side, the second along the other one
    first = here & (numbers >> 0 & 1 == 0)
    assert abs(np.count_nonzero(first) / np.count_nonzero(here) - 0.5) < 0.05


def test_small_objects():
    objects = np.full((3, 4), -1)
    objects[0, 0] = 5
    numbers = block_numbers(objects == 5, objects)
    assert numbers[0, 0] in range(16) and (numbers.ravel()[1:] == -1).all()
    assert block_numbers(np.zeros((3, 4), bool), objects).max() == -1


def test_bright_halves():
    rng = np.random.default_rng(0)
    picture, objects = rng.uniform(size=(20, 20)), np.repeat([[0], [1]], 10, axis=0)
    objects = np.broadcast_to(objects, (20, 20))
    picture = picture + 10 * objects
    counts = rng.uniform(size=(20, 20)) < 0.9
    bright = bright_halves(picture, counts, objects)
    assert not bright[~counts].any()
    for k in (0, 1):
        here = counts & (objects == k)
        assert abs(np.count_nonzero(bright & here) - np.count_nonzero(here) / 2) <= 1
        assert picture[bright & here].min() > picture[here & ~bright].max()


@pytest.fixture(scope="module")
def found():
    picture = drawn(TRUTH)
    return st.fit(START, picture + 0.01 * np.random.default_rng(0).standard_normal(picture.shape),
                  bounces=0)  # fmt: skip


def jackknife(found, square=None) -> BlockJackknife:
    spectrum = found.uncertainty.spectrum
    held = np.asarray(found.problem.at_bounds(found.values))
    square = square_of_free(spectrum, held) * np.outer(spectrum.scale, spectrum.scale)
    return BlockJackknife(
        found.problem,
        found.values,
        square,
        objects_at(found.problem, found.values),
        found.uncertainty.step,
    )


@pytest.mark.slow
def test_is_that_of_fits_without_each_block(found):
    """Leaves out one block after the other and fits again."""
    blocks = jackknife(found)
    numbers = block_numbers(
        np.asarray(found.problem.targets[0].counts), objects_at(found.problem, found.values)[0]
    )
    image = np.asarray(found.problem.targets[0].image)
    light = lambda f: np.asarray(f.scene.lights.position[0])
    moved = []
    for b in range(16):
        again = st.fit(found.scene, image, mask=numbers != b, bounces=0)
        assert again.converged
        moved.append(light(again) - light(found))
    expected = 15 / 16 * np.stack(moved).T @ np.stack(moved)
    jacobian = found.uncertainty.jacobians[0][found.problem.index(0).places["light_position"][0]]
    half = jacobian @ blocks.scatter
    np.testing.assert_allclose(half @ half.T, expected, rtol=0.15, atol=0.05 * expected.max())


def test_white_noise_pulls_no_more_than_by_chance(found):
    blocks, noise = jackknife(found), found.uncertainty.noise
    assert abs(blocks.excess(noise)) < 5 and not blocks.is_structured(noise)
    assert blocks.excess(noise / 2) > 20 and blocks.is_structured(noise / 2)
    # the scatter of blocks is that of white noise, give or take its own scatter with 15 blocks
    ratio = np.linalg.norm(blocks.scatter, axis=1) / found.uncertainty.white.of_unknowns
    ratio = ratio[np.isfinite(found.uncertainty.of_unknowns)]
    assert (ratio > 0.4).all() and (ratio < 1.9).all()


def test_halves_and_weights_of_white_noise(found):
    blocks, picture = jackknife(found), np.asarray(found.normal.pictures[0]).mean(axis=-1)
    counts = np.asarray(found.problem.targets[0].counts)
    bright = bright_halves(picture, counts, objects_at(found.problem, found.values)[0])
    known = np.isfinite(found.uncertainty.of_unknowns)
    deviations = found.uncertainty.white.of_unknowns[known]
    halves = np.linalg.norm(blocks.halves([bright]), axis=1)[known] / deviations
    assert halves.max() < 6
    # other weights move nothing if they are the same
    even = blocks.reweighted([np.ones(counts.shape)])[:, 0][known] / deviations
    assert np.abs(even).max() < 1e-3
    # twice the weight of one half is between the whole and that half
    twice = blocks.reweighted([np.where(bright, np.sqrt(2), 1)])[:, 0][known] / deviations
    assert 1e-3 < np.abs(twice).max() < 3


def test_a_region_that_pulls_is_seen(found):
    target = np.array(found.problem.targets[0].image)
    target[:, :12] += 0.03
    problem = eqx.tree_at(lambda p: p.targets[0].image, found.problem, jnp.asarray(target))
    pulled = eqx.tree_at(lambda f: f.problem, found, problem)
    assert jackknife(pulled).is_structured(found.uncertainty.noise)
