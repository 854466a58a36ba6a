"""The pixel filter: as a filter of pictures and as weights of neighbours."""

import jax
import jax.numpy as jnp
import numpy as np
from helpers.scenes import three_spheres

from spheretrace_jax.base.vec import SplitVec, components
from spheretrace_jax.rendering.pixel_filter import NEIGHBOURS, filter_pixels, filter_weights
from spheretrace_jax.scene.settings import render_settings

WIDTH, HEIGHT = 9, 7


def test_weights_are_the_filter():
    rng = np.random.default_rng(0)
    settings = render_settings(three_spheres(antialias=1), WIDTH, HEIGHT, samples=2)
    edge = jnp.asarray(rng.uniform(size=(HEIGHT, WIDTH)) < 0.1)
    color = SplitVec(*jnp.asarray(rng.uniform(size=(3, HEIGHT, WIDTH))))
    filtered = filter_pixels(jax.tree.map(settings.rows.with_neighbours, color), edge, settings)
    weights = filter_weights(edge, settings, color.x.dtype).reshape(5, HEIGHT, WIDTH)
    across = np.arange(WIDTH) + np.reshape(NEIGHBOURS[0], (5, 1, 1))
    down = np.arange(HEIGHT)[:, None] + np.reshape(NEIGHBOURS[1], (5, 1, 1))
    at = np.clip(down, 0, HEIGHT - 1), np.clip(across, 0, WIDTH - 1)
    for channel, expected in zip(components(color), np.moveaxis(filtered, -1, 0), strict=True):
        found = np.sum(np.asarray(weights) * np.asarray(channel)[at], axis=0)
        np.testing.assert_allclose(found, expected, rtol=1e-13)
    np.testing.assert_allclose(np.sum(weights, axis=0), 1, rtol=1e-14)
    assert 0 < np.mean(np.asarray(weights[0]) != 1) < 1


def test_a_parabola_is_averaged_exactly():
    settings = render_settings(three_spheres(antialias=1), WIDTH, HEIGHT)
    x = jnp.broadcast_to(jnp.arange(WIDTH, dtype=float) ** 2, (HEIGHT, WIDTH))
    color = jax.tree.map(settings.rows.with_neighbours, SplitVec(x, 2 * x, 0 * x))
    filtered = filter_pixels(color, jnp.full(x.shape, False), settings)
    inner = np.s_[1:-1, 1:-1]  # the mean of x^2 over a pixel is x^2 + 1/12
    np.testing.assert_allclose(filtered[..., 0][inner], x[inner] + 1 / 12, rtol=1e-14)
