"""Covered edges, and their derivatives, as cameras of all kinds see them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.antialiasing import ambient_spheres, supersampled
from helpers.derivatives import off
from helpers.scenes import SCENES, VIEWS, with_camera

import spheretrace_jax as st
from spheretrace_jax.scene.camera import DEFAULTS

SIZE = dict(width=40, height=32, bounces=0)


def seen(view: str, name: str) -> st.Scene:
    """Returns a scene without checkers, which are point-sampled."""
    scene = with_camera(SCENES[name].with_antialias(1), **VIEWS[view])
    return eqx.tree_at(lambda s: s.planes.checker_size, scene, jnp.zeros(len(scene.planes)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("view", "name", "bounces"),
    [
        ("all", "shadows", 0),
        ("orthographic, all", "shadows", 0),
        pytest.param("wide pixels", "shadows", 0, marks=pytest.mark.slow),
        pytest.param("orthographic", "planes", 1, marks=pytest.mark.slow),
        pytest.param("orthographic, all", "mirrors", 1, marks=pytest.mark.slow),
        pytest.param("orthographic, all", "bubbles", 1, marks=pytest.mark.slow),
        pytest.param("all", "planes", 1, marks=pytest.mark.slow),
        pytest.param("all", "mirrors", 1, marks=pytest.mark.slow),
    ],
)
def test_covered_edges_are_those_of_many_rays(view, name, bounces):
    scene, size = seen(view, name), SIZE | {"bounces": bounces}
    if view == "wide pixels":  # 1.6 times as wide; the error falls by 5 where pixels are halved
        size |= {"width": 2 * SIZE["width"], "height": 2 * SIZE["height"]}
    many = supersampled(scene, 16, **size)
    covered, sharp = st.render(scene, **size), st.render(scene.with_antialias(0), **size)
    assert off(covered, many) < (0.016 if bounces == 0 else 0.03)
    assert off(covered, many) < off(sharp, many) / (6 if bounces == 0 else 2)


def test_edges_of_a_parallel_view_are_exact():
    # a disc: of radius 9 pixels, its middle anywhere; ambient light alone
    spheres = st.Spheres([[3.3, -1.7, 50.0]], [9.0], ka=1.0, kd=0.0)
    camera = st.Camera(-np.pi / 2, 0.0, 500.0, 1.0, 32.0, orthographic=True)
    scene = st.Scene(spheres, st.Lights([[0.0, 0, 900]]), camera, antialias=1)
    picture = np.asarray(st.render(scene, width=40, height=32, bounces=0))[..., 0]
    np.testing.assert_allclose(picture.sum() / float(scene.spheres.color[0, 0]), 81 * np.pi, 1e-4)
    depth = np.asarray(st.render_layers(scene, width=40, height=32).depth)
    np.testing.assert_allclose(depth.min(), 500 - 50 - 9, atol=0.02)
    # a distance that no perspective could have changes nothing
    far = with_camera(scene, distance=jnp.array(1e-30), mu=jnp.array(60.0))
    again = st.render(far, width=40, height=32, bounces=0)[..., 0]
    np.testing.assert_allclose(again, picture, atol=1e-12)


FREE = {
    "theta": 1e-5,
    "mu": 1e-2,
    "window": 1e-2,
    "roll": 1e-5,
    "look_at": 1e-3,
    "principal_point": 1e-5,
    "pixel_aspect": 1e-5,
}


@pytest.mark.slow
@pytest.mark.parametrize("orthographic", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_derivatives_are_those_of_finite_differences(orthographic):
    scene = ambient_spheres([[-50.0, 40, 0], [60, -30, 60]], [50.0, 45], ka=0.3, kd=0.7)
    scene = with_camera(scene, **DEFAULTS, orthographic=orthographic)
    scene = with_camera(scene, roll=jnp.array(0.2), window=jnp.array(300.0))
    needs, weights = st.needs(scene), np.random.default_rng(0).uniform(size=(24, 32, 3))
    assert not needs.shadows
    at = lambda scene: [getattr(scene.camera, name) for name in FREE]

    @jax.jit
    def total(values):
        picture = st.render(
            eqx.tree_at(at, scene, values), width=32, height=24, bounces=0, needs=needs
        )
        return jnp.sum(weights * picture)

    slopes = jax.jit(jax.grad(total))(at(scene))
    for k, (name, step) in enumerate(FREE.items()):
        value = at(scene)[k]
        for i in np.ndindex(value.shape):
            moved = [
                total([v.at[i].add(s) if j == k else v for j, v in enumerate(at(scene))])
                for s in (step, -step)
            ]
            expected = (moved[0] - moved[1]) / (2 * step)
            scale = max(abs(expected), 1e-3 * abs(slopes[0]))
            assert abs(slopes[k][i] - expected) < 0.02 * scale, (name, i, slopes[k][i], expected)
    if orthographic:
        assert abs(slopes[1]) < 1e-9


def many_spheres(dtype, **view) -> st.Scene:
    rng = np.random.default_rng(1)
    spheres = st.Spheres(
        rng.uniform(-150, 150, (150, 3)), rng.uniform(3, 25, 150), rng.uniform(0.2, 0.9, (150, 3)),
        kgr=0.3,
    )  # fmt: skip
    camera = st.Camera(0.3, 0.6, 500.0, 800.0, **view)
    scene = st.Scene(spheres, st.Lights([[100.0, 500, 800]]), camera, antialias=1)
    return scene.astype(dtype)


@pytest.mark.parametrize(
    ("view", "dtype"),
    [
        pytest.param(view, dtype, marks=pytest.mark.slow)
        for dtype in ("float32", "float64")
        for view in ("all", "orthographic, all", "orthographic")
    ],
)
def test_many_spheres_are_found(view, dtype, monkeypatch):
    from spheretrace_jax.acceleration import accelerator

    scene = many_spheres(dtype, **VIEWS[view])
    # the second one has the eye, or the eye's plane, among the spheres
    scenes = [scene, with_camera(scene, mu=jnp.asarray(40.0, dtype))]
    draw = lambda: [np.asarray(st.render(s, width=50, height=37, bounces=0)) for s in scenes]
    fast = draw()
    monkeypatch.setattr(accelerator, "MAX_BRUTE_FORCE", 1000)
    jax.clear_caches()
    for a, b in zip(fast, draw(), strict=True):
        tolerance = 1e-12 if dtype == "float64" else 2e-5
        assert (np.abs(a - b).max(-1) > tolerance).mean() < (0.002 if dtype == "float32" else 1e-9)
    jax.clear_caches()
