"""The wavefront of secondary rays: compacted in chunks, it equals all rays at once."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.contexts import context_of
from helpers.scenes import SCENES

import spheretrace_jax as st
from spheretrace_jax.base.vec import components
from spheretrace_jax.rendering import wavefront
from spheretrace_jax.rendering.render import draw
from spheretrace_jax.rendering.samples import sample_positions, sample_rays
from spheretrace_jax.rendering.wavefront import ray_radiance
from spheretrace_jax.scene.settings import render_settings
from spheretrace_jax.tracing.path import first_path, next_path, shade_path, trace_path
from spheretrace_jax.tracing.queries import closest_hit

SETTINGS = {"width": 40, "height": 26, "bounces": 3}


def slow(*names: str) -> list:
    return [pytest.param(name, marks=pytest.mark.slow) for name in names]


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


@pytest.mark.slow
@pytest.mark.parametrize("name", ["glass", *slow("mirrors", "planes")])
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


@pytest.mark.slow
@pytest.mark.parametrize("name", ["glass", *slow("mirrors", "inside")])
def test_paths_at_once_equal_the_wavefront(name):
    # pixels with edges follow their few paths bounce by bounce: `path.trace_path`
    context = context_of(SCENES[name], size=(40, 26), bounces=3)
    (left,), (top,) = sample_positions(context.scene, context.settings)
    pixels = jnp.arange(40 * 26, dtype=jnp.int32)
    ray = sample_rays(context.scene, context.settings, pixels, left, top)
    expected = ray_radiance(context, ray)[0]
    first = first_path(ray, closest_hit(context, ray), jnp.full(pixels.shape, True))

    def add_way(color, choice):
        later = context.with_settings(bounces=2)
        return color + trace_path(later, next_path(context, first, choice))

    ways = (0, 1) if context.needs.branching else (0,)
    found = functools.reduce(add_way, map(jnp.int32, ways), shade_path(context, first))
    for a, b in zip(components(found), components(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-13)
    assert (
        float(jnp.abs(components(found)[0] - components(shade_path(context, first))[0]).max())
        > 1e-2
    )
