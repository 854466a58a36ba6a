"""Antialiased edges against the truth: many rays per pixel, closed forms, and what must not break.

Needs and sizes are few and shared, as nearly all the time here is compiling.
"""

import dataclasses
import sys
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bench.edges import PARAMETERS, blurred, derivative, difference, off
from helpers.scenes import FLAT, SCENES, WHITE, nine_spheres, three_spheres
from jaxtyping import Array, Float

import spheretrace_jax as st
from spheretrace_jax.base.vec import Vec, dot
from spheretrace_jax.tracing.tables import mean_chord

# ambient light alone: what is seen are silhouettes
CUT = dataclasses.replace(FLAT, crossings=True)
SIZE = dict(width=48, height=48, bounces=0)
TINY = dict(width=9, height=9, bounces=0)
SMALL = dict(width=32, height=32, bounces=1)


def balls(center, radius, color=(1.0, 1, 1), ka=1.0, kd=0.0, **rest) -> st.Scene:
    """Spheres, by default under ambient light alone, in front of an eye that looks along -z."""
    camera = st.Camera(-np.pi / 2, 0.0, 500.0, 800.0)
    spheres = st.Spheres(np.asarray(center, float), radius, color, ka, kd, **rest)
    return st.Scene(spheres, st.Lights([[300.0, 350, 400]]), camera, antialias=1)


def rays(scene: st.Scene, samples: int, **settings) -> np.ndarray:
    """The truth: samples x samples rays per pixel."""
    return np.asarray(st.render(scene.with_antialias(0), samples=samples, **settings))


def framed(scene: st.Scene, window: float) -> st.Scene:
    """The scene seen through a window of another height."""
    return eqx.tree_at(lambda s: s.camera.window, scene, jnp.asarray(window))


# --- pictures and derivatives of three spheres ---


def test_pictures_come_near_the_truth():
    scene = three_spheres()
    truth = np.asarray(st.render(scene, samples=64, **SIZE))
    point = off(st.render(scene, **SIZE), truth)
    one = off(st.render(scene.with_antialias(1), **SIZE), truth)
    assert one < 0.01
    assert one < point / 10


def test_shadows_of_several_lights_come_near_the_truth():
    lights = st.Lights([[200.0, 300, 500], [0, 0, 1e5], [-300, 200, 300]], np.full((3, 3), 0.5))
    scene = eqx.tree_at(lambda s: s.lights, three_spheres(), lights)
    truth, point = (rays(scene, samples, **SIZE) for samples in (64, 1))
    one = st.render(scene.with_antialias(1), **SIZE)
    assert off(one, truth) < 0.01
    assert off(one, truth) < off(point, truth) / 10


@pytest.mark.slow
def test_more_samples_come_nearer_to_the_truth():
    scene = three_spheres()
    truth = np.asarray(st.render(scene, samples=64, **SIZE))
    one, two = (off(st.render(scene.with_antialias(1), samples=k, **SIZE), truth) for k in (1, 2))
    assert two < one / 3


@cache
def derivatives():
    scene = three_spheres()
    return derivative(scene.with_antialias(1), **SIZE), derivative(scene, **SIZE)


@pytest.mark.parametrize("name", PARAMETERS)
def test_derivatives_come_near_the_truth(name):
    smooth, hard = (by(name) for by in derivatives())
    truth = difference(three_spheres(), name, 5 * PARAMETERS[name][2], samples=48, **SIZE)
    weight = blurred(truth, 2.0)
    total = lambda picture: np.vdot(weight, picture) / np.vdot(weight, truth)
    assert abs(total(smooth) - 1) < 0.03
    assert off(smooth, truth) < 0.2
    # a ray's derivative does not know of edges
    assert abs(total(hard) - 1) > 0.3
    assert off(hard, truth) > 0.9


@pytest.mark.slow
def test_forward_reverse_and_differences_agree():
    scene = balls([[-8.0, 0, 0], [9, 4, 3]], [10.0, 9.0], ka=[0.4, 0.8])
    table = st.check_gradients(framed(scene, 60.0), needs=FLAT, width=12, height=12, bounces=0)
    for row in table.rows:
        assert row.forward < 2e-2, row  # what bends less does not count as a kink there
        assert row.reverse < 1e-13, row
        # a layer begins to count where it touches the pixel: few pixels, and not with a jump
        assert row.left_out <= 4, row
    moving = {row.parameter for row in table.rows if row.largest > 0}
    assert {"spheres.center", "spheres.radius", "camera.phi", "camera.distance"} <= moving


def test_a_gradient_is_traced():
    # compiled it takes half a minute; to trace it finds what jax cannot transpose
    scene = three_spheres(antialias=1)
    needs = st.needs(scene, free=("center", "radius", "light_position"))
    gradient = jax.grad(lambda s: st.render(s, needs=needs, **SIZE).sum())
    assert jax.tree.structure(jax.eval_shape(gradient, scene)) == jax.tree.structure(scene)


# --- which pixels are composed ---


def everywhere(monkeypatch, scene: st.Scene, **settings) -> np.ndarray:
    """The picture with every pixel composed of layers."""
    radiance, render = (sys.modules[f"spheretrace_jax.{name}"] for name in ("radiance", "render"))
    all_ = lambda world, lights, ray, *_: jnp.full(ray.direction.x.shape, True)
    monkeypatch.setattr(radiance, "near_edge", all_)
    jax.clear_caches()
    draw = eqx.filter_jit(render.draw.__wrapped__)
    return np.asarray(draw(scene, render.render_settings(scene, **settings)))


def dull(scene: st.Scene) -> st.Scene:
    """Without highlights and checkers: both differ where they are averaged, which is no edge."""
    scene = eqx.tree_at(lambda s: s.spheres.ks, scene, 0 * scene.spheres.ks)
    scene = eqx.tree_at(lambda s: s.planes.ks, scene, 0 * scene.planes.ks)
    scene = eqx.tree_at(lambda s: s.planes.checker_size, scene, 0 * scene.planes.checker_size)
    return scene.with_antialias(1)


def overlooked(monkeypatch, scene: st.Scene, **settings) -> float:
    listed = np.asarray(st.render(scene, **settings))
    return float(np.abs(everywhere(monkeypatch, scene, **settings) - listed).max())


def test_no_edge_is_overlooked(monkeypatch):
    assert overlooked(monkeypatch, dull(three_spheres()), **SIZE) < 6e-3


@pytest.mark.slow
@pytest.mark.parametrize("bounces", [1, 2])
@pytest.mark.parametrize("name", ["mirrors", "bubbles", "planes", "glass", "inside"])
def test_no_edge_is_overlooked_in_mirrors_and_bubbles(monkeypatch, name, bounces):
    scene = dull(SCENES[name])
    assert overlooked(monkeypatch, scene, width=32, height=32, bounces=bounces) < 1.5e-2


@pytest.mark.slow
def test_no_edge_of_nine_spheres_is_overlooked(monkeypatch):
    assert overlooked(monkeypatch, dull(nine_spheres()), **SIZE) < 2e-2


# --- areas of silhouettes ---


def silhouette(center, radius) -> Float[Array, ""]:
    """The area, in pixels, of a sphere's silhouette, which is an ellipse."""
    center = jnp.asarray(center) * np.array([1.0, 1, -1]) + np.array([0.0, 0, 500])
    ahead = center[2] ** 2 - radius**2
    return np.pi * (radius * 800) ** 2 * jnp.sqrt(center @ center - radius**2) / ahead**1.5


def ambient(scene: st.Scene) -> Float[Array, "9 9"]:
    """The picture of a scene of `balls`, of pixels as wide as those of 512 x 512 are by default."""
    return st.render(framed(scene, 9.0), needs=FLAT, **TINY)[..., 0]


@pytest.mark.parametrize("center", [[0.0, 0, 0], [0.3, -0.4, 100], [-0.8, 0.7, -60]])
def test_a_picture_adds_up_to_the_silhouettes_area(center):
    exact, change = jax.value_and_grad(silhouette, 1)(center, 1.2)
    scene = balls([center, [0, 0, 900]], [1.2, 1.0])  # one is behind the eye
    total, slope = jax.value_and_grad(lambda s: ambient(s).sum())(scene)
    np.testing.assert_allclose(total, exact, rtol=1e-3)
    np.testing.assert_allclose(slope.spheres.radius[0], change, rtol=1e-3)


def test_a_sphere_smaller_than_a_pixel_shines_as_brightly_everywhere():
    radius = 0.05 * 500 / 800
    along = np.linspace(-1.3, 1.3, 201)  # four pixels
    pictures = [ambient(balls([[x, 0.31 * x, 0], [0, 0, 900]], [radius, 1.0])) for x in along]
    exact = [silhouette([x, 0.31 * x, 0.0], radius) for x in along]
    np.testing.assert_allclose(np.sum(pictures, axis=(1, 2)), exact, rtol=1e-3)
    # a step is 1/5 of its width
    steps = np.abs(np.diff(pictures, axis=0)).max()
    assert 0 < steps < 0.4 * max(exact)


def test_a_sliver_is_as_wide_as_it_shows():
    back, front = np.array([0.05, 0, 0]), np.array([0.0, 0, 10])
    for x in np.linspace(-0.6, 0.6, 7):
        move = np.array([x, x / 3, 0])
        scene = balls([back + move, front + move], [1.2, 1.2], ka=[1.0, 0.0])
        truth = rays(framed(scene, 9.0), 250, needs=FLAT, **TINY)[..., 0].sum()
        assert 0.04 < truth < 0.2
        np.testing.assert_allclose(ambient(scene).sum(), truth, rtol=0.01)


@pytest.mark.slow
def test_the_shadow_of_a_sphere_smaller_than_a_pixel_is_as_dark_everywhere():
    # the sphere is outside the picture, halfway to the light; its shadow is seen from above
    radius, needs = 0.02, dataclasses.replace(FLAT, shadows=True, planes=True)
    floor = st.Planes([[0.0, 0, 0]], [[0.0, 0, 1]], (1.0, 1, 1), 0.0, 1.0)

    def light(x: float, radius: float) -> float:
        scene = balls([[100 + x / 2, 0.1 * x, 200], [0, 0, 900]], [radius, 1.0])
        lights = st.Lights([[200.0, 0, 400]])
        scene = st.Scene(scene.spheres, lights, scene.camera, floor, antialias=1)
        return float(st.render(framed(scene, 9.0), needs=needs, **TINY)[..., 0].sum())

    dark = np.array([light(x, 1e-6) - light(x, radius) for x in np.linspace(-1.3, 1.3, 41)])
    # the cone of light in the sphere's shadow is cut at an angle, which cancels Lambert's cosine
    way = 2 * np.hypot(100, 200) / np.hypot(100, 200)
    exact = np.pi * (radius * way * 800 / 500) ** 2
    np.testing.assert_allclose(dark, exact, rtol=0.02)
    np.testing.assert_allclose(dark, dark.mean(), rtol=0.02)


# --- shading inside pixels ---


def test_highlights_are_averaged_over_pixels():
    scene = balls([[0, 0, 0]], 60.0, ka=0.2, ks=0.9, exponent=30.0)
    scene = eqx.tree_at(lambda s: s.lights.position, scene, jnp.array([[100.0, 150, 400]]))
    settings = dict(width=24, height=24, bounces=0)
    inside = np.s_[8:16, 8:16]  # far from the silhouette
    scene = framed(scene, 160.0)
    truth = rays(scene, 48, **settings)[inside]
    point, smooth = (st.render(scene.with_antialias(a), **settings)[inside] for a in (0, 1))
    assert np.ptp(truth) > 0.5
    assert off(smooth, truth) < off(point, truth) / 10


def test_the_mean_of_normals_is_no_longer_than_one():
    # from the middle to outside of the sphere, pixels from narrow to wider than the sphere
    q, reach = np.meshgrid(np.linspace(0, 3, 200), np.geomspace(1e-4, 10, 200))
    zero = jnp.zeros(q.shape)
    half_chord, mean = mean_chord(Vec(jnp.asarray(q), zero, zero), 1 + zero, jnp.asarray(reach))
    assert np.sqrt(half_chord**2 + dot(mean, mean)).max() <= 1 + 1e-15


@pytest.mark.slow
def test_highlights_in_mirrors_are_no_brighter_than_they_can_be():
    # each of nine spheres mirrors the others, whose highlights are smaller than a pixel there
    scene, settings = nine_spheres((100.0, 500, 800)), dict(width=64, height=64, bounces=1)
    truth = rays(scene, 32, **settings)
    smooth = st.render(scene.with_antialias(1), **settings)
    assert off(smooth, truth) < off(st.render(scene, **settings), truth) / 4
    assert np.abs(smooth - truth).max() < 0.15


def test_the_end_of_the_light_along_a_rim_is_averaged():
    # lit from behind: a crescent a pixel wide, which the mean normal is not in
    scene = balls([[0, 0, 0]], 60.0, ka=0.0, kd=1.0)
    scene = eqx.tree_at(lambda s: s.lights.position, scene, jnp.array([[1e5, 0, -2e5]]))
    scene, settings = framed(scene, 140.0), dict(width=24, height=24, bounces=0)
    truth = rays(scene, 48, **settings)
    assert off(st.render(scene, **settings), truth) < 0.05


# --- surfaces that cut one another ---


def test_the_line_where_spheres_meet_is_an_edge():
    scene = balls([[-30.0, 3, 0], [36, -5, 9]], 60.0, ka=[0.3, 1.0])
    scene = framed(scene, 256.0)
    move = jnp.zeros((2, 3)).at[0, 2].set(1.0)
    at = lambda h: eqx.tree_at(lambda s: s.spheres.center, scene, scene.spheres.center + h * move)
    draw = lambda h: st.render(at(h), needs=CUT, **SIZE)
    picture, smooth = jax.jvp(draw, (0.0,), (1.0,))
    truth = rays(scene, 64, needs=CUT, **SIZE)
    error = np.abs(picture - truth)
    point = np.abs(rays(scene, 1, needs=CUT, **SIZE) - truth)
    along = np.s_[16:32, 20:30]  # of the line: nothing else in this part of the picture is an edge
    assert point[along].max() > 0.1
    assert error[along].max() < error.max() + 1e-3
    assert np.linalg.norm(error[along]) < np.linalg.norm(point[along]) / 10
    smooth = np.asarray(smooth)[along]
    change = (rays(at(0.5), 64, needs=CUT, **SIZE) - rays(at(-0.5), 64, needs=CUT, **SIZE))[along]
    assert abs(smooth.sum() / change.sum() - 1) < 0.05
    assert off(smooth, change) < 0.15


# --- planes, shadows on them, and both in mirrors ---

NEEDS = st.Needs(textures=False, checkers=False, transmission=False, branching=False, inside=False)


def on_the_floor(center, radius, kgr=0.0) -> st.Scene:
    """Three spheres over a floor under a blue sky, seen from not far above."""
    spheres = st.Spheres(np.asarray(center, float), radius, (0.9, 0.5, 0.2), ks=0.2, kgr=kgr)
    floor = st.Planes([[0.0, 0, -60]], [[0.0, 0, 1]], (0.8, 0.8, 0.7))
    camera = st.Camera(0.2, 1.45, 400.0, 500.0)
    return st.Scene(
        spheres, st.Lights(WHITE), camera, floor, background=(0.2, 0.3, 0.6), antialias=1
    )


FLOORS = {
    "horizon": on_the_floor([[0, 0, -200], [0, 10, -200], [9, 0, -200]], 20.0),
    "shadow": on_the_floor([[150, 170, 190], [0, 10, -200], [9, 0, -200]], 50.0),
    "mirror": on_the_floor(
        [[0, 0, 0], [40, 110, -20], [60, -90, -10]], [55.0, 30, 40], [0.9, 0, 0]
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "better"), [("horizon", 20), ("shadow", 20), ("mirror", 4)])
def test_edges_of_floors_and_in_mirrors_come_near_the_truth(name, better):
    scene = FLOORS[name]
    truth = rays(scene, 48, needs=NEEDS, **SMALL)
    point = off(rays(scene, 1, needs=NEEDS, **SMALL), truth)
    assert off(st.render(scene, needs=NEEDS, **SMALL), truth) < point / better


# --- nothing breaks ---


def odd(center, radius, light=(300.0, 350, 400)) -> st.Scene:
    scene = balls(center, radius, ka=0.2, kd=0.6, ks=0.3, exponent=9.0, kgr=0.2)
    return eqx.tree_at(lambda s: s.lights.position, scene, jnp.array([light], float))


# the middle pixel of a picture of 9 x 9 looks along the z axis from (0, 0, 500)
ODD = {
    "the middle of a sphere": odd([[0, 0, 0], [90, 0, 0]], 50.0),
    "a tangent ray": odd([[50, 0, 0], [0, 50, -50]], 50.0),
    "coincident spheres": odd([[10, 5, 0], [10, 5, 0]], 50.0),
    "concentric spheres": odd([[10, 5, 0], [10, 5, 0]], [50.0, 40]),
    "a light inside a sphere": odd([[0, 0, 0], [90, 0, 0]], 50.0, (10, 0, 20)),
    "a light at a sphere's centre": odd([[0, 0, 0], [90, 0, 0]], 50.0, (0, 0, 0)),
    "a light on a sphere": odd([[0, 0, 0], [90, 0, 0]], 50.0, (0, 0, 50)),
    "a light at the eye": odd([[0, 0, 0], [90, 0, 0]], 50.0, (0, 0, 500)),
    "a light in the plane of contact": odd([[50, 0, 0], [-50, 0, 0]], 50.0, (0, 300, 0)),
    "the eye inside a sphere": odd([[0, 0, 0], [90, 0, 0]], [600.0, 50]),
    "the eye on a sphere": odd([[0, 0, 0], [90, 0, 0]], [500.0, 50]),
    "the eye at a sphere's centre": odd([[0, 0, 500], [90, 0, 0]], 50.0),
    "huge and tiny spheres": odd([[0, 0, -1e6 - 50], [0, 0, 0]], [1e6, 1e-3]),
}

LEAN = dataclasses.replace(NEEDS, inside=True, planes=False, reflection=False, background=False)


@cache
def value_and_gradient(dtype, bounces: int):
    needs = dataclasses.replace(LEAN, reflection=bounces > 0)
    draw = lambda s: jnp.mean(st.render(s, **(TINY | dict(bounces=bounces)), needs=needs))
    return jax.jit(jax.value_and_grad(draw))


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("bounces", [0, 1])
@pytest.mark.parametrize("name", ODD)
def test_odd_scenes_have_finite_pictures_and_derivatives(name, dtype, bounces):
    value, gradient = value_and_gradient(dtype, bounces)(ODD[name].astype(dtype))
    assert np.isfinite(value) and value > 0
    bad = [
        jax.tree_util.keystr(path)
        for path, leaf in jax.tree_util.tree_leaves_with_path(gradient)
        if not np.isfinite(leaf).all()
    ]
    assert not bad
