"""The plain path tracer and the fast renderer, two programs for one lecture, see the same."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.random_scenes import random_scene
from helpers.scenes import SCENES, VIEWS, with_camera

import spheretrace_jax as st
from spheretrace_jax.tracing.plain import plain_picture, plain_radiance, plain_rays

WIDTH, HEIGHT = SIZE = 24, 20
HIGHLIGHTS = "phong", "blinn"
# seeds that find mistakes which the shared scenes do not
FAST = 4, 14, 16, 36, 39, 63


def plain_colors(scene, highlight, bounces, pixels, shift=(0.0, 0.0)):
    """Traces some pixels' rays, each of them shifted by parts of a pixel."""
    columns, rows = (pixels % WIDTH + 0.5 + shift[0], pixels // WIDTH + 0.5 + shift[1])
    rays = plain_rays(scene.camera, jnp.asarray(columns), jnp.asarray(rows), SIZE)
    return np.asarray(plain_radiance(scene, *rays, highlight, bounces))


def assert_same_picture(scene: st.Scene, highlight: str, bounces: int) -> None:
    """Compares all pixels but those which an edge touches, and asserts that these are few.

    Where the pictures differ, an edge excuses it only if the plain colour jumps by 1e-6 as the ray
    moves by 1e-9 pixel: then rounding decides what is seen.
    """
    scene = scene.with_antialias(0)
    size = dict(width=WIDTH, height=HEIGHT)
    fast = st.render(scene, **size, highlight=highlight, bounces=bounces)
    fast = np.asarray(fast).reshape(-1, 3)
    plain = plain_colors(scene, highlight, bounces, np.arange(WIDTH * HEIGHT))
    assert plain.dtype == fast.dtype == np.float64 and np.isfinite(plain).all()
    difference = np.abs(fast - plain).max(axis=1)
    apart = np.flatnonzero(~(difference <= 1e-12 * max(1, plain.max())))
    jumps = np.zeros(len(apart))
    shifts = [(1e-9, 1e-9), (-1e-9, 1e-9), (1e-9, -1e-9), (-1e-9, -1e-9)]
    for shift in shifts if len(apart) else ():
        moved = plain_colors(scene, highlight, bounces, apart, shift)
        jumps = np.maximum(jumps, np.abs(moved - plain[apart]).max(axis=1))
    assert (jumps > 1e-6).all(), (apart, difference[apart], jumps)
    assert len(apart) < 0.01 * len(plain)


@pytest.mark.parametrize(
    ("name", "highlight"),
    [
        pytest.param(name, highlight, marks=() if k % 2 == j else pytest.mark.slow)
        for k, name in enumerate(SCENES)
        for j, highlight in enumerate(HIGHLIGHTS)
    ],
)
def test_it_sees_what_the_renderer_sees(name, highlight):
    assert_same_picture(SCENES[name], highlight, bounces=3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed",
    [pytest.param(k, marks=() if k in FAST else pytest.mark.slow) for k in range(64)],
)
def test_it_sees_what_the_renderer_sees_of_random_scenes(seed):
    # two seeds in a row share their bounces, eight have them all with both highlights
    assert_same_picture(random_scene(seed), HIGHLIGHTS[seed % 2], bounces=seed // 2 % 4)


def test_a_light_inside_a_sphere_lights_nothing_outside():
    light = SCENES["two_coloured_lights"].spheres.center[1]
    scene = eqx.tree_at(lambda s: s.lights.position, SCENES["shadows"], light[None])
    assert_same_picture(scene, "phong", bounces=0)


def test_random_scenes_have_every_feature_and_do_not_change():
    scenes = [random_scene(seed).with_antialias(0) for seed in range(64)]
    needs = [st.needs(scene) for scene in scenes]
    rare = "inside", "branching", "textures", "planes", "checkers", "background", "tinted"
    for name in rare:
        assert 8 <= sum(getattr(n, name) for n in needs) <= 56, name
    assert {len(scene.lights) for scene in scenes} == {0, 1, 2, 3}
    assert {len(scene.spheres) for scene in scenes} == set(range(1, 9))
    assert any(s.sky for s in scenes) and any(s.back_plane for s in scenes)
    assert any((np.asarray(s.spheres.exponent) == 0).any() for s in scenes)
    again = random_scene(3).with_antialias(0)
    assert all(map(np.array_equal, jax.tree.leaves(again), jax.tree.leaves(scenes[3])))


@pytest.mark.slow
def test_it_averages_samples_as_the_renderer_does():
    scene = SCENES["shadows"]
    plain = plain_picture(scene, WIDTH, HEIGHT, samples=3)
    fast = st.render(scene, width=WIDTH, height=HEIGHT, samples=3)
    np.testing.assert_allclose(plain, fast, rtol=0, atol=1e-12)


def test_it_ignores_the_antialias_flag():
    scene = SCENES["shadows"]
    pictures = [plain_picture(scene.with_antialias(k), WIDTH, HEIGHT) for k in (0, 1)]
    np.testing.assert_array_equal(*pictures)


@pytest.mark.slow
def test_it_can_be_compiled_and_keeps_the_dtype():
    scene = SCENES["inside"]
    drawn = jax.jit(plain_picture, static_argnums=(1, 2, 3, 4))(scene, *SIZE, "blinn", 1)
    picture = plain_picture(scene, *SIZE, "blinn", 1)
    np.testing.assert_allclose(drawn, picture, rtol=0, atol=1e-12)
    single = jax.eval_shape(lambda scene: plain_picture(scene, *SIZE), scene.astype(np.float32))
    assert single.dtype == np.float32


@pytest.mark.slow
def test_its_derivatives_by_colours_and_coefficients_are_the_renderers():
    scene = SCENES["glass"]
    free = "color", "ka", "kd", "ks", "exponent", "kgr", "kt"
    of = lambda s: [*(getattr(s.spheres, name) for name in free), s.lights.color, s.background]
    needs = st.needs(scene, free=(*free, "light_color", "background"))
    weights = jnp.asarray(np.random.default_rng(0).uniform(size=(HEIGHT, WIDTH, 3)))

    def slopes(picture):
        of_parameters = lambda values: jnp.sum(weights * picture(eqx.tree_at(of, scene, values)))
        return jax.grad(of_parameters)(of(scene))

    size = dict(width=WIDTH, height=HEIGHT, bounces=1)
    fast = slopes(lambda scene: st.render(scene, **size, needs=needs))
    plain = slopes(lambda scene: plain_picture(scene, **size))
    for one, other in zip(plain, fast, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize(
    ("name", "bounces"),
    [
        pytest.param("inside", 1, marks=pytest.mark.slow),
        pytest.param("planes", 1, marks=pytest.mark.slow),
        pytest.param("textures", 1, marks=pytest.mark.slow),
    ],
)
def test_its_derivatives_are_finite_by_everything(name, bounces):
    # the eye looks along the z axis, and a ray shifted by half a pixel goes straight to the pole
    scene = eqx.tree_at(lambda s: s.camera.phi, SCENES[name], jnp.array(0.0))
    column, row = (x.ravel() for x in jnp.indices(SIZE, float))
    rays = lambda scene: plain_rays(scene.camera, column, row, SIZE)
    total = lambda scene: jnp.sum(plain_radiance(scene, *rays(scene), bounces=bounces))
    slopes = jax.grad(total)(scene)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slopes))


def test_it_refuses_unknown_highlights():
    with pytest.raises(Exception, match="gouraud"):
        plain_picture(SCENES["shadows"], 4, 4, "gouraud")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("view", "name"),
    [
        pytest.param(view, name, marks=() if view.endswith("all") and k == 1 else pytest.mark.slow)
        for view in VIEWS
        for k, name in enumerate(("glass", "planes", "textures"))
    ],
)
def test_it_sees_what_the_renderer_sees_by_other_cameras(view, name):
    assert_same_picture(with_camera(SCENES[name], **VIEWS[view]), "phong", bounces=2)


@pytest.mark.parametrize("cut", [0.0, 50.0])
def test_parallel_rays_start_inside_spheres(cut):
    # the plane of the eye cuts one sphere, and the other one is before it or behind
    scene = with_camera(SCENES["shadows"], orthographic=True, window=320.0, mu=cut)
    assert st.needs(scene).inside
    assert_same_picture(scene, "phong", bounces=0)
