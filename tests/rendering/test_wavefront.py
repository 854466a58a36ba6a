"""The wavefront of secondary rays: compacted in chunks, it equals all rays at once."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import SCENES

import spheretrace_jax as st
from spheretrace_jax.rendering import wavefront
from spheretrace_jax.rendering.render import draw
from spheretrace_jax.scene.settings import render_settings
from spheretrace_jax.tracing.queries import closest_hit

SETTINGS = {"width": 40, "height": 26, "bounces": 3}


def differentiated(scene: st.Scene) -> tuple:
    """Returns a picture, its derivative along all parameters at once, and its gradient."""
    needs = st.needs(scene, free=("kgr", "kt"))
    moving, rest = eqx.partition(scene, eqx.is_inexact_array)
    settings = render_settings(scene, **SETTINGS, needs=needs)
    compiled_anew = eqx.filter_jit(draw.__wrapped__)
    picture = lambda moving: compiled_anew(eqx.combine(moving, rest), settings)
    weights = np.random.default_rng(0).uniform(size=(26, 40, 3))
    slopes = jax.grad(lambda moving: jnp.sum(weights * picture(moving)))(moving)
    return (*jax.jvp(picture, (moving,), (jax.tree.map(jnp.ones_like, moving),)), slopes)


@pytest.mark.parametrize("name", ["mirrors", "glass", "planes"])
def test_chunks_equal_all_at_once(name, monkeypatch):
    # the camera moves the first rays, kgr and kt scale the secondary rays
    at_once = differentiated(SCENES[name])
    monkeypatch.setattr(wavefront, "CHUNK", 64)
    jax.clear_caches()
    in_chunks = differentiated(SCENES[name])
    for ours, theirs in zip(jax.tree.leaves(in_chunks), jax.tree.leaves(at_once), strict=True):
        np.testing.assert_allclose(
            ours, theirs, rtol=1e-11, atol=1e-12 * np.abs(theirs).max(initial=0)
        )


def test_only_surviving_paths_are_traced(monkeypatch):
    traced = []

    def counting(context, ray, source_hit=None):
        if source_hit is not None:
            jax.debug.callback(lambda x: traced.append(x.size), ray.direction.x)
        return closest_hit(context, ray, source_hit)

    monkeypatch.setattr(wavefront, "CHUNK", 64)
    monkeypatch.setattr(wavefront, "closest_hit", counting)
    scene = SCENES["mirrors"]
    jax.clear_caches()
    np.asarray(eqx.filter_jit(draw.__wrapped__)(scene, render_settings(scene, **SETTINGS)))
    jax.effects_barrier()
    assert 0 < sum(traced) < 40 * 26
