"""Variable projection: its linear shading is the renderer's."""

import jax.numpy as jnp
import numpy as np
from helpers.scenes import SCENES

import spheretrace_jax as st
from spheretrace_jax.fit.model.parameters import Parameters
from spheretrace_jax.fit.model.target import make_target
from spheretrace_jax.fit.solver.variable_projection import (
    linear_shading,
    sample_pixels,
    terms_at,
)
from spheretrace_jax.scene.settings import render_settings


def test_linear_shading_is_the_picture():
    scene = SCENES["two_coloured_lights"]
    picture = st.render(scene, width=32, height=24)
    target = make_target(np.asarray(picture), scene.dtype)
    sample = sample_pixels(Parameters(scene, ()), target, render_settings(scene, 32, 24))
    sums = sample.sums(terms_at(sample, scene.lights))
    color = linear_shading(sample.materials(sums)[sample.sphere], sums)
    counts = np.asarray(sample.weight) > 0
    np.testing.assert_allclose(color[counts], sample.image[counts], rtol=1e-13)
    assert counts.any(axis=1).sum() > 100 and float(jnp.abs(sums).max()) > 0.1
