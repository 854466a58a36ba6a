"""Edges of shadows: several lights, and shadows smaller than a pixel."""

import dataclasses

import equinox as eqx
import numpy as np
import pytest
from helpers.antialiasing import SIZE, TINY, ambient_spheres, supersampled, with_window
from helpers.derivatives import off
from helpers.scenes import FLAT, three_spheres

import spheretrace_jax as st


@pytest.mark.slow
def test_error_of_several_shadows():
    lights = st.Lights([[200.0, 300, 500], [0, 0, 1e5], [-300, 200, 300]], np.full((3, 3), 0.5))
    scene = eqx.tree_at(lambda s: s.lights, three_spheres(), lights)
    truth, point = (supersampled(scene, samples, **SIZE) for samples in (64, 1))
    one = st.render(scene.with_antialias(1), **SIZE)
    assert off(one, truth) < 0.01
    assert off(one, truth) < off(point, truth) / 10


@pytest.mark.slow
def test_shadow_smaller_than_a_pixel():
    # the sphere is outside the picture, halfway to the light; its shadow is seen from above
    radius, needs = 0.02, dataclasses.replace(FLAT, shadows=True, planes=True)
    floor = st.Planes([[0.0, 0, 0]], [[0.0, 0, 1]], (1.0, 1, 1), 0.0, 1.0)

    def light(x: float, radius: float) -> float:
        scene = ambient_spheres([[100 + x / 2, 0.1 * x, 200], [0, 0, 900]], [radius, 1.0])
        lights = st.Lights([[200.0, 0, 400]])
        scene = st.Scene(scene.spheres, lights, scene.camera, floor, antialias=1)
        return float(st.render(with_window(scene, 9.0), needs=needs, **TINY)[..., 0].sum())

    dark = np.array([light(x, 1e-6) - light(x, radius) for x in np.linspace(-1.3, 1.3, 41)])
    # the cone of light in the sphere's shadow is cut at an angle, which cancels Lambert's cosine
    way = 2 * np.hypot(100, 200) / np.hypot(100, 200)
    exact = np.pi * (radius * way * 800 / 500) ** 2
    np.testing.assert_allclose(dark, exact, rtol=0.02)
    np.testing.assert_allclose(dark, dark.mean(), rtol=0.02)
