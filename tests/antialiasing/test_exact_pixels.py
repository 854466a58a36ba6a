"""Compositing and shadow coverage say what single rays say where no edge crosses the pixel."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.contexts import context_of
from helpers.scenes import SCENES

import spheretrace_jax as st
from spheretrace_jax.antialiasing.compositing import composite_layers
from spheretrace_jax.antialiasing.edge_mask import edge_mask
from spheretrace_jax.antialiasing.polygon import clip_pixel, whole_pixel
from spheretrace_jax.antialiasing.shadow_edges import lit_coverage
from spheretrace_jax.antialiasing.silhouette import silhouette_distance
from spheretrace_jax.rendering.samples import sample_positions
from spheretrace_jax.scene.light import each_light
from spheretrace_jax.tracing.cone import pixel_cones
from spheretrace_jax.tracing.differential import pixel_differentials
from spheretrace_jax.tracing.queries import closest_hit, light_visible
from spheretrace_jax.tracing.surface import surface_at

SIZE = 40, 36


@jax.jit
def seen(scene: st.Scene) -> tuple:
    """Returns ids and shadows, by areas and by single rays, and which pixels have no edge."""
    context = context_of(scene.with_antialias(1), size=SIZE)
    (left,), (top,) = sample_positions(scene, context.settings)
    columns, rows = (jnp.arange(n, dtype=scene.dtype) for n in SIZE)
    column, row = (x.reshape(-1) for x in jnp.meshgrid(left + columns, top + rows))
    ray = pixel_differentials(scene.camera, column, row, SIZE, 1.0)
    hit = closest_hit(context, ray.value)
    pixel_side = scene.camera.window / SIZE[1]
    edge = edge_mask(context, ray.value, pixel_cones(scene.camera, ray.value, pixel_side), hit)
    _, layers = composite_layers(context, ray, jnp.full(column.shape, True))
    largest = jnp.argmax(layers.area, axis=0)[None]
    id_, area = (jnp.take_along_axis(x, largest, axis=0)[0] for x in (layers.hit.id, layers.area))
    covering = jnp.where(area > 0.5, id_, -1)
    distance = silhouette_distance(context, ray, hit)
    light = next(each_light(scene.lights, falloff=False))
    everything = clip_pixel(whole_pixel(column))
    by_area = lit_coverage(context, ray, distance.extent, everything, hit, light)
    by_ray = light_visible(context, surface_at(context, ray.value, hit).point, hit, light)
    return (covering, hit.id), (by_area, by_ray), ~edge, hit.id >= 0


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("planes", "inside")]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["shadows", *SLOW])
def test_areas_agree_with_rays_away_from_edges(name):
    ids, lit, smooth, hits = jax.tree.map(np.asarray, seen(SCENES[name]))
    np.testing.assert_array_equal(ids[0][smooth], ids[1][smooth])
    some = smooth & hits
    np.testing.assert_allclose(lit[0][some], lit[1][some], atol=1e-12)
    assert 0.3 < smooth.mean() < 1 and lit[1][some].any()
