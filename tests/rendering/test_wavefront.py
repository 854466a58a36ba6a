"""The wavefront of secondary rays: compacted in chunks, it equals all rays at once."""

import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import SCENES

import spheretrace_jax as st

SETTINGS = {"width": 40, "height": 26, "bounces": 3}


def differentiated(scene: st.Scene) -> tuple:
    """Returns a picture, its derivative along all parameters at once, and its gradient."""
    needs = st.needs(scene, free=("kgr", "kt"))
    moving, rest = eqx.partition(scene, eqx.is_inexact_array)
    render = sys.modules["spheretrace_jax.rendering.render"]
    draw = eqx.filter_jit(render.draw.__wrapped__)
    options = render.render_settings(scene, **SETTINGS, needs=needs)
    picture = lambda moving: draw(eqx.combine(moving, rest), options)
    weights = np.random.default_rng(0).uniform(size=(26, 40, 3))
    slopes = jax.grad(lambda moving: jnp.sum(weights * picture(moving)))(moving)
    return (*jax.jvp(picture, (moving,), (jax.tree.map(jnp.ones_like, moving),)), slopes)


@pytest.mark.parametrize("name", ["mirrors", "glass", "planes"])
def test_chunks_equal_all_at_once(name, monkeypatch):
    # the camera moves the first rays, kgr and kt scale the secondary rays
    at_once = differentiated(SCENES[name])
    monkeypatch.setattr(sys.modules["spheretrace_jax.radiance"], "CHUNK", 64)
    jax.clear_caches()
    in_chunks = differentiated(SCENES[name])
    for ours, theirs in zip(jax.tree.leaves(in_chunks), jax.tree.leaves(at_once), strict=True):
        np.testing.assert_allclose(
            ours, theirs, rtol=1e-11, atol=1e-12 * np.abs(theirs).max(initial=0)
        )


def test_only_surviving_paths_are_traced(monkeypatch):
    radiance = sys.modules["spheretrace_jax.radiance"]
    traced, nearest = [], radiance.nearest

    def counting(world, ray, needs, leaving=None):
        if leaving is not None:
            jax.debug.callback(lambda x: traced.append(x.size), ray.direction.x)
        return nearest(world, ray, needs, leaving)

    monkeypatch.setattr(radiance, "CHUNK", 64)
    monkeypatch.setattr(radiance, "nearest", counting)
    scene = SCENES["mirrors"]
    render = sys.modules["spheretrace_jax.rendering.render"]
    draw = eqx.filter_jit(render.draw.__wrapped__)
    jax.clear_caches()
    np.asarray(draw(scene, render.render_settings(scene, **SETTINGS)))
    jax.effects_barrier()
    assert 0 < sum(traced) < 40 * 26
