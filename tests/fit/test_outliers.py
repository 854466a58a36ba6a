"""Outliers: numbers that do not fit though the others do, and what rests on them."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import spheretrace_jax as st
from spheretrace_jax.fit.diagnosis.outliers import find_outliers, resting_on_outliers
from spheretrace_jax.fit.diagnosis.residual_structure import has_8_bits
from spheretrace_jax.fit.problem.make_problem import make_problem

PLAIN = dict(bounces=0)
# of the second sphere only a few pixels tell ks
TRUTH = st.Scene(
    st.Spheres(
        [[-100.0, 0, 0], [120, 60, 40]], [100.0, 60], [[0.8, 0.3, 0.2], [0.2, 0.6, 0.9]],
        0.2, 0.5, 0.3, exponent=[10.0, 60],
    ),
    st.Lights([[200.0, 300, 800]]),
    st.Camera(mu=1200.0, distance=1200.0),
)  # fmt: skip
PICTURE = np.asarray(st.render(TRUTH, width=64, height=64, **PLAIN))


def highlight() -> np.ndarray:
    """Returns the pixels that show the second sphere's highlight."""
    matte = eqx.tree_at(lambda s: s.spheres.ks, TRUTH, jnp.asarray([0.3, 0]))
    less = PICTURE - np.asarray(st.render(matte, width=64, height=64, **PLAIN))
    return np.argwhere(less[..., 0] > 1e-3)


def start() -> st.Scene:
    return eqx.tree_at(lambda s: s.spheres.ks, TRUTH, jnp.full(2, 0.2))


@pytest.fixture(scope="module")
def whole():
    return st.fit(start(), PICTURE, **PLAIN)


@pytest.mark.slow
def test_unknowns_resting_on_outliers():
    target = PICTURE.copy()
    places = highlight()
    assert 2 <= len(places) <= 12
    target[tuple(places[::2].T)] += 0.002
    found = st.fit(start(), target, **PLAIN)
    assert found.converged and not found.trust.ok
    verdict = str(found.trust)
    assert "but what tells of" in verdict and "does NOT fit" in verdict
    assert "sphere 2's ks" in verdict and "sphere 1's" not in verdict
    off = find_outliers(found.problem, found.values, found.cost)[0].any(axis=-1)
    assert off[tuple(places[::2].T)].all() and not off[:, :30].any()


def test_harmless_outliers():
    target = PICTURE.copy()
    target[30:33, 20] += 0.002  # of the first sphere, which has enough others
    found = st.fit(start(), target, **PLAIN)
    assert find_outliers(found.problem, found.values, found.cost)[0].sum() == 9
    assert found.converged and found.trust.ok


def test_no_outliers(whole):
    off = find_outliers(whole.problem, whole.values, whole.cost)
    assert not off[0].any() and resting_on_outliers(off, whole.problem, whole.values) == []
    assert whole.trust.ok
    noisy = PICTURE + 0.003 * np.random.default_rng(0).uniform(-1, 1, PICTURE.shape)
    found = st.fit(start(), noisy, **PLAIN)
    assert not find_outliers(found.problem, found.values, found.cost)[0].any() and found.trust.ok


@pytest.mark.slow
def test_no_outliers_antialiased():
    target = PICTURE + np.random.default_rng(0).standard_cauchy(PICTURE.shape)
    scene = TRUTH.with_antialias(1)
    problem = make_problem(scene, target, ("ks",), bounces=0)
    assert not find_outliers(problem, problem.start(), 1.0)[0].any()


def test_levels_of_8_bits():
    levels = (np.arange(256) / 255) ** 2.2
    rng = np.random.default_rng(0)
    image = rng.choice(levels, (40, 40, 3)) * (1 + 1e-6 * rng.uniform(-1, 1, (40, 40, 3)))
    assert has_8_bits(image.astype(np.float32))
    assert not has_8_bits(rng.uniform(0, 1, (40, 40, 3)))
    assert not has_8_bits(rng.uniform(0, 1e-3, (40, 40, 3)))
