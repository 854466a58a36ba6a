"""The edge mask: no pixel that an edge crosses is drawn as a single ray."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.antialiasing import SIZE
from helpers.scenes import SCENES, nine_spheres, three_spheres

import spheretrace_jax as st
from spheretrace_jax.rendering import wavefront
from spheretrace_jax.rendering.render import draw
from spheretrace_jax.scene.settings import render_settings


def all_edges(monkeypatch, scene: st.Scene, **settings) -> np.ndarray:
    """Draws the picture with every pixel marked as an edge pixel."""
    every_pixel = lambda context, ray, *_: jnp.full(ray.direction.x.shape, True)
    monkeypatch.setattr(wavefront, "edge_mask", every_pixel)
    jax.clear_caches()
    picture = eqx.filter_jit(draw.__wrapped__)(scene, render_settings(scene, **settings))
    return np.asarray(picture)


def without_smooth_means(scene: st.Scene) -> st.Scene:
    """Removes highlights and checkers, whose means differ in edge pixels without any edge."""
    scene = eqx.tree_at(lambda s: s.spheres.ks, scene, 0 * scene.spheres.ks)
    scene = eqx.tree_at(lambda s: s.planes.ks, scene, 0 * scene.planes.ks)
    scene = eqx.tree_at(lambda s: s.planes.checker_size, scene, 0 * scene.planes.checker_size)
    return scene.with_antialias(1)


def largest_miss(monkeypatch, scene: st.Scene, **settings) -> float:
    masked = np.asarray(st.render(scene, **settings))
    return float(np.abs(all_edges(monkeypatch, scene, **settings) - masked).max())


@pytest.mark.slow
def test_no_edge_is_missed(monkeypatch):
    assert largest_miss(monkeypatch, without_smooth_means(three_spheres()), **SIZE) < 6e-3


@pytest.mark.slow
@pytest.mark.parametrize("bounces", [1, 2])
@pytest.mark.parametrize("name", ["mirrors", "bubbles", "planes", "glass", "inside"])
def test_no_edge_is_missed_in_mirrors(monkeypatch, name, bounces):
    scene = without_smooth_means(SCENES[name])
    assert largest_miss(monkeypatch, scene, width=32, height=32, bounces=bounces) < 1.5e-2


@pytest.mark.slow
def test_no_edge_of_nine_spheres_is_missed(monkeypatch):
    assert largest_miss(monkeypatch, without_smooth_means(nine_spheres()), **SIZE) < 2e-2
