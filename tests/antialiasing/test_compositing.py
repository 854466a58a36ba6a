"""Shading inside pixels: highlights, the terminator, and surfaces that cross."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.antialiasing import CROSSINGS, SIZE, ambient_spheres, supersampled, with_window
from helpers.derivatives import off

import spheretrace_jax as st


def test_mean_highlight_of_pixels():
    scene = ambient_spheres([[0, 0, 0]], 60.0, ka=0.2, ks=0.9, exponent=30.0)
    scene = eqx.tree_at(lambda s: s.lights.position, scene, jnp.array([[100.0, 150, 400]]))
    settings = dict(width=24, height=24, bounces=0)
    inside = np.s_[8:16, 8:16]  # far from the silhouette
    scene = with_window(scene, 160.0)
    truth = supersampled(scene, 48, **settings)[inside]
    point, smooth = (st.render(scene.with_antialias(a), **settings)[inside] for a in (0, 1))
    assert np.ptp(truth) > 0.5
    assert off(smooth, truth) < off(point, truth) / 10


def test_terminator_along_a_silhouette():
    # lit from behind: a crescent a pixel wide, outside of which the mean normal lies
    scene = ambient_spheres([[0, 0, 0]], 60.0, ka=0.0, kd=1.0)
    scene = eqx.tree_at(lambda s: s.lights.position, scene, jnp.array([[1e5, 0, -2e5]]))
    scene, settings = with_window(scene, 140.0), dict(width=24, height=24, bounces=0)
    truth = supersampled(scene, 48, **settings)
    assert off(st.render(scene, **settings), truth) < 0.05


@pytest.mark.slow
def test_crossing_of_spheres_is_an_edge():
    scene = ambient_spheres([[-30.0, 3, 0], [36, -5, 9]], 60.0, ka=[0.3, 1.0])
    scene = with_window(scene, 256.0)
    move = jnp.zeros((2, 3)).at[0, 2].set(1.0)
    at = lambda h: eqx.tree_at(lambda s: s.spheres.center, scene, scene.spheres.center + h * move)
    draw = lambda h: st.render(at(h), needs=CROSSINGS, **SIZE)
    picture, smooth = jax.jvp(draw, (0.0,), (1.0,))
    truth = supersampled(scene, 64, needs=CROSSINGS, **SIZE)
    error = np.abs(picture - truth)
    point = np.abs(supersampled(scene, 1, needs=CROSSINGS, **SIZE) - truth)
    along = np.s_[16:32, 20:30]  # only the crossing is an edge in these pixels
    assert point[along].max() > 0.1
    assert error[along].max() < error.max() + 1e-3
    assert np.linalg.norm(error[along]) < np.linalg.norm(point[along]) / 10
    smooth = np.asarray(smooth)[along]
    change = (
        supersampled(at(0.5), 64, needs=CROSSINGS, **SIZE)
        - supersampled(at(-0.5), 64, needs=CROSSINGS, **SIZE)
    )[along]
    assert abs(smooth.sum() / change.sum() - 1) < 0.05
    assert off(smooth, change) < 0.15
