"""Silhouettes: areas of spheres and slivers, also smaller than a pixel."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.antialiasing import TINY, ambient_spheres, supersampled, with_window
from helpers.scenes import FLAT
from jaxtyping import Array, Float

import spheretrace_jax as st


def silhouette_area(center, radius) -> Float[Array, ""]:
    """Returns the area, in pixels, of a sphere's silhouette, which is an ellipse."""
    center = jnp.asarray(center) * np.array([1.0, 1, -1]) + np.array([0.0, 0, 500])
    ahead = center[2] ** 2 - radius**2
    return np.pi * (radius * 800) ** 2 * jnp.sqrt(center @ center - radius**2) / ahead**1.5


def ambient(scene: st.Scene) -> Float[Array, "9 9"]:
    """Draws `ambient_spheres` with pixels as wide as those of a 512 x 512 picture by default."""
    return st.render(with_window(scene, 9.0), needs=FLAT, **TINY)[..., 0]


@pytest.mark.slow
@pytest.mark.parametrize("center", [[0.0, 0, 0], [0.3, -0.4, 100], [-0.8, 0.7, -60]])
def test_picture_sums_to_silhouette_area(center):
    exact, change = jax.value_and_grad(silhouette_area, 1)(center, 1.2)
    scene = ambient_spheres([center, [0, 0, 900]], [1.2, 1.0])  # the second is behind the eye
    total, slope = jax.value_and_grad(lambda s: ambient(s).sum())(scene)
    np.testing.assert_allclose(total, exact, rtol=1e-3)
    np.testing.assert_allclose(slope.spheres.radius[0], change, rtol=1e-3)


def test_sphere_smaller_than_a_pixel():
    radius = 0.05 * 500 / 800
    along = np.linspace(-1.3, 1.3, 201)  # four pixels
    pictures = [
        ambient(ambient_spheres([[x, 0.31 * x, 0], [0, 0, 900]], [radius, 1.0])) for x in along
    ]
    exact = [silhouette_area([x, 0.31 * x, 0.0], radius) for x in along]
    np.testing.assert_allclose(np.sum(pictures, axis=(1, 2)), exact, rtol=1e-3)
    # a step is 1/5 of its width
    steps = np.abs(np.diff(pictures, axis=0)).max()
    assert 0 < steps < 0.4 * max(exact)


def test_sliver_of_a_sphere():
    back, front = np.array([0.05, 0, 0]), np.array([0.0, 0, 10])
    for x in np.linspace(-0.6, 0.6, 7):
        move = np.array([x, x / 3, 0])
        scene = ambient_spheres([back + move, front + move], [1.2, 1.2], ka=[1.0, 0.0])
        truth = supersampled(with_window(scene, 9.0), 250, needs=FLAT, **TINY)[..., 0].sum()
        assert 0.04 < truth < 0.2
        np.testing.assert_allclose(ambient(scene).sum(), truth, rtol=0.01)
