"""Layers: depth, normal, object and coverage, against closed forms and the picture's colours."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import SCENES

import spheretrace_jax as st
from spheretrace_jax.scene.camera import pixel_rays

MU, RADIUS, DISTANCE = 500.0, 120.0, 800.0
BALL = st.Scene(
    st.Spheres([[0.0, 0, 0]], RADIUS), st.Lights([[0.0, 0, 900]]), st.Camera(0.3, 0.7, MU, DISTANCE)
)
SIZE = dict(width=33, height=21)


def test_closed_forms():
    layers = st.render_layers(BALL, **SIZE)
    middle = (10, 16)
    np.testing.assert_allclose(layers.depth[middle], MU - RADIUS, rtol=1e-14)
    eye = [np.sin(0.7) * np.cos(0.3), np.sin(0.7) * np.sin(0.3), np.cos(0.7)]
    np.testing.assert_allclose(layers.normal[middle], eye, atol=1e-14)
    assert layers.object.dtype == jnp.int32 and layers.depth.shape == (21, 33)
    assert set(np.unique(layers.object)) == {-1, 0}
    missed = layers.object < 0
    assert (layers.depth[missed] == jnp.inf).all() and not layers.normal[missed].any()
    np.testing.assert_array_equal(layers.coverage, layers.object == 0)


@pytest.mark.parametrize("name", ["planes", "inside"])
def test_points_and_objects_are_those_of_the_picture(name):
    scene = SCENES[name].with_antialias(0)
    layers = st.render_layers(scene, **SIZE)
    width, height = SIZE["width"], SIZE["height"]
    columns, rows = jnp.arange(0.5, width), jnp.arange(0.5, height)
    ray = pixel_rays(scene.camera, columns[None, :], rows[:, None], (width, height))
    axes = lambda v: jnp.stack(jnp.broadcast_arrays(v.x, v.y, v.z), -1)
    points = axes(ray.origin)[None, None] + layers.depth[..., None] * axes(ray.direction)
    spheres, planes = scene.spheres, scene.planes
    for k in range(len(spheres)):
        here = np.asarray(layers.object == k)
        outwards = np.subtract(points[here], spheres.center[k]) / spheres.radius[k]
        np.testing.assert_allclose(np.linalg.norm(outwards, axis=-1), 1, rtol=1e-11)
        np.testing.assert_allclose(np.abs(np.sum(outwards * layers.normal[here], -1)), 1)
    for k in range(len(planes)):
        here = np.asarray(layers.object == len(spheres) + k)
        away = np.subtract(points[here], planes.point[k]) @ np.asarray(planes.normal[k])
        assert here.any() and np.abs(away).max() < 1e-9
    hit = np.asarray(layers.object >= 0)
    assert (np.sum(layers.normal * axes(ray.direction), -1)[hit] < 0).all()
    # the colours of the picture, in ambient light alone
    flat = dict(ka=1.0, kd=0.0)
    numbered = [np.asarray(layers.object) == k for k in range(scene.objects)]
    colors = np.random.default_rng(0).uniform(size=(scene.objects, 3))
    n, back = len(spheres), scene.back_plane
    ambient = st.Scene(
        st.Spheres(spheres.center, spheres.radius, colors[:n], **flat),
        st.Lights([[0.0, 0, 0]]),
        scene.camera,
        st.Planes(planes.point, planes.normal, colors[n : n + len(planes)], **flat),
        back_plane=None if back is None else st.BackPlane(colors[-1], **flat),
    )
    np.testing.assert_allclose(st.render(ambient, **SIZE), np.tensordot(numbered, colors, (0, 0)))


@pytest.mark.slow
def test_derivatives_and_exact_coverage():
    """The silhouette of a sphere around the axis is a disc of radius d R / sqrt(mu^2 - R^2)."""
    needs = st.needs(BALL, free=("radius",))
    size = dict(width=24, height=24, needs=needs)

    def layers(radius):
        return st.render_layers(_with_radius(BALL.with_antialias(1), radius), **size)

    values, slopes = jax.jvp(layers, (jnp.asarray(RADIUS),), (jnp.ones(()),))
    pitch = 512 / 24
    root = np.sqrt(MU**2 - RADIUS**2)
    disc = DISTANCE * RADIUS / root / pitch
    slope = DISTANCE / pitch * MU**2 / root**3
    area, growth = np.sum(values.coverage), np.sum(slopes.coverage)
    np.testing.assert_allclose([area, growth], [np.pi * disc**2, 2 * np.pi * disc * slope], 1e-3)
    assert ((values.coverage > 0) & (values.coverage < 1)).sum() > 20
    # where the ray through the middle hits: d/dR (b - sqrt(R^2 - q^2))
    on, step = np.asarray(values.object == 0), 1e-3
    ahead, behind = (layers(jnp.asarray(RADIUS + h)) for h in (step, -step))
    for name in ("depth", "normal"):
        difference = (getattr(ahead, name)[on] - getattr(behind, name)[on]) / (2 * step)
        np.testing.assert_allclose(getattr(slopes, name)[on], difference, 1e-5, 1e-8)
    assert np.isfinite(slopes.depth).all()


def _with_radius(scene: st.Scene, radius) -> st.Scene:
    return eqx.tree_at(lambda s: s.spheres.radius, scene, radius[None])


def test_jit_vmap_and_samples():
    draw = lambda radius: st.render_layers(_with_radius(BALL, radius), **SIZE, samples=3)
    radii = jnp.array([RADIUS, 80.0])
    batch = jax.jit(jax.vmap(draw))(radii)
    for k, radius in enumerate(radii):
        one = draw(radius)
        for field in dataclasses.fields(st.Layers):
            part = getattr(batch, field.name)[k]
            np.testing.assert_allclose(part, getattr(one, field.name), atol=1e-12)
    numbers = np.unique(np.round(np.asarray(batch.coverage) * 9, 9))
    assert len(numbers) > 4 and set(numbers) <= set(range(10))


@pytest.mark.slow
def test_many_spheres():
    random = np.random.default_rng(0)
    centers = random.uniform(-200, 200, (300, 3))
    scene = st.Scene(st.Spheres(centers, 20.0), st.Lights(np.zeros((0, 3))), st.Camera(0.3, 0.7))
    layers = st.render_layers(scene, width=40, height=40)
    alone = st.render_layers(scene.astype(jnp.float32), width=40, height=40)
    assert alone.depth.dtype == jnp.float32 and alone.coverage.dtype == jnp.float32
    assert (layers.object == alone.object).mean() > 0.999
    both = layers.object == alone.object
    np.testing.assert_allclose(alone.depth[both], layers.depth[both], rtol=1e-4)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (dict(width=0), "width must be at least 1, got 0"),
        (dict(samples=0), "samples must be in 1..256, got 0"),
    ],
)
def test_arguments_out_of_range(wrong, message):
    with pytest.raises(st.InputError, match=message):
        st.render_layers(BALL, **(SIZE | wrong))
