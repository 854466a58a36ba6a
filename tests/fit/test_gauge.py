"""Gauges: of the scenes that look the same, the one that a rule picks."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import nine_spheres

import spheretrace_jax as st
from spheretrace_jax.fit.fit import DEFAULT_FREE
from spheretrace_jax.fit.problem.make_problem import make_problem
from spheretrace_jax.fit.solver.gauge import fix_gauge
from spheretrace_jax.study.benchmarks.wrong_start import wrong_start

PLAIN = dict(bounces=0, samples=1)
SIZE = dict(width=64, height=64)
COLORS = jnp.asarray(np.random.default_rng(0).uniform(0.2, 0.9, (9, 3)))
TRUTH = eqx.tree_at(lambda s: s.spheres.color, nine_spheres((100.0, 500, 800)), COLORS)
START = wrong_start(TRUTH)


@pytest.mark.slow
def test_gauges_look_the_same():
    picture = st.render(TRUTH, **SIZE, **PLAIN)
    found = {g: st.fit(START, picture, gauge=g, **PLAIN) for g in ("ka", "color", "none")}
    pictures = [st.render(f.scene, **SIZE, **PLAIN) for f in found.values()]
    for other in pictures[1:]:
        np.testing.assert_allclose(other, pictures[0], atol=1e-12)
    np.testing.assert_allclose(pictures[0], picture, atol=1e-9)
    color = np.asarray(found["color"].scene.spheres.color)
    np.testing.assert_allclose(color.max(1), 1, rtol=1e-15)
    s = found["ka"].scene.spheres
    kept = np.isclose(s.ka, START.spheres.ka, rtol=1e-12)
    full = np.isclose(s.kd, 1, rtol=1e-12) | np.isclose(s.color.max(1), 1, rtol=1e-12)
    assert (kept | full).all() and kept.sum() >= 5
    assert not np.isclose(found["none"].scene.spheres.ka, s.ka, rtol=1e-3).all()


def settled(gauge: str, wanted, color, ka, kd) -> tuple[np.ndarray, ...]:
    """Returns color, ka and kd after `fix_gauge`, from a start with ka `wanted`."""
    start = eqx.tree_at(lambda s: s.spheres.ka, START, jnp.asarray(wanted))
    problem = make_problem(start, np.full((4, 4, 3), 0.5), DEFAULT_FREE, bounces=0)
    values = problem.start() | dict(
        color=jnp.asarray(color), ka=jnp.asarray(ka), kd=jnp.asarray(kd)
    )
    values = fix_gauge(problem, values, gauge)
    return tuple(np.asarray(values[n]) for n in ("color", "ka", "kd"))


@pytest.mark.parametrize("gauge", ["ka", "color", "none"])
def test_gauge_rules(gauge):
    rng = np.random.default_rng(7)
    for _ in range(5):
        color, ka, kd, wanted = (rng.uniform(0, 1, shape) for shape in ((9, 3), 9, 9, 9))
        # on the bounds, too: black, no ka, none wanted, neither ka nor kd
        color[0], ka[1], wanted[2], kd[3], ka[4] = 0, 0, 0, 1, 1
        color[5, 1], ka[6], kd[6], wanted[7] = 1, 0, 0, 1
        new = settled(gauge, wanted, color, ka, kd)
        for x in new:
            assert (x >= 0).all() and (x <= 1).all()
        np.testing.assert_allclose(new[1][:, None] * new[0], ka[:, None] * color, rtol=1e-14)
        np.testing.assert_allclose(new[2][:, None] * new[0], kd[:, None] * color, rtol=1e-14)
        if gauge == "none":
            assert all((a == b).all() for a, b in zip(new, (color, ka, kd), strict=True))
        if gauge == "color":
            np.testing.assert_allclose(new[0].max(1), np.where(color.max(1) > 0, 1, 0), rtol=1e-15)
        if gauge == "ka":
            # of all scales that keep within 0..1 none brings ka nearer
            for c in np.geomspace(1e-2, 1e2, 2001):
                inside = (c * color.max(1) <= 1) & (np.maximum(ka, kd) <= c)
                nearer = np.abs(ka / c - wanted) < np.abs(new[1] - wanted) - 1e-14
                assert not (inside & nearer).any()
