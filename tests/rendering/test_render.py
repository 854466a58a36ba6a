"""Rendering: closed forms, features one by one, memory, compilation and arguments."""

import dataclasses
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import CAMERA, FLAT, SCENES, WHITE, nine_spheres

import spheretrace_jax as st
from spheretrace_jax.rendering import samples

module = sys.modules["spheretrace_jax.rendering.render"]

SMALL = dict(width=24, height=24)


def sphere(**changes) -> st.Spheres:
    return st.Spheres([[0.0, 0, 0]], [100.0], **changes)


def middle(picture) -> np.ndarray:
    """Returns the pixel that looks at the origin."""
    height, width, _ = picture.shape
    return np.asarray(picture[height // 2, width // 2])


def test_sphere_lit_from_the_eye():
    # straight ahead N.L = R.V = 1, the ambient light is the light's colour
    spheres = sphere(color=(0.5, 0.4, 0.3), ka=0.2, kd=0.6, ks=0.3, exponent=7.0)
    scene = st.Scene(spheres, st.Lights([[0.0, 0, 500]], [[1.0, 0.5, 0.25]]), st.Camera())
    light, color = np.array([1, 0.5, 0.25]), np.array([0.5, 0.4, 0.3])
    expected = 0.2 * light * color + light * (0.6 * color + 0.3)
    for highlight in ("phong", "blinn"):
        picture = st.render(scene, width=1, height=1, highlight=highlight)
        np.testing.assert_allclose(middle(picture), expected, rtol=1e-14)


def test_ambient_room():
    scene = st.Scene(sphere(ka=0.3, kd=0.0), st.Lights([[1e3, 0, 0]]), st.Camera(mu=0.0))
    np.testing.assert_allclose(st.render(scene, **SMALL), 0.3 * 0.5, rtol=1e-15)


def test_floor_has_lamberts_closed_form():
    floor = st.Planes([[0.0, 0, 0]], [[0.0, 0, 1]], (1.0, 1, 1), ka=0.0, kd=1.0)
    no_spheres = st.Spheres(np.zeros((0, 3)), np.zeros(0))
    scene = st.Scene(no_spheres, st.Lights([[0.0, 0, 100]]), st.Camera(), floor)
    picture = st.render(scene, **SMALL)[..., 0]
    offset = (np.arange(24) + 0.5 - 12) * (512 / 24) * 500 / 800
    distance = np.sqrt(offset[:, None] ** 2 + offset[None] ** 2 + 100**2)
    np.testing.assert_allclose(picture, 100 / distance, rtol=1e-13)


def test_ambient_is_the_mean_light():
    ambient = sphere(color=(1.0, 1, 1), ka=1.0, kd=0.0)
    two = st.Lights([[9.0, 9, 999], [-9, 9, 999]], [[1.0, 0, 0.5], [0.0, 1, 0.5]])
    np.testing.assert_allclose(middle(st.render(st.Scene(ambient, two), **SMALL)), 0.5)
    none = st.Lights(np.zeros((0, 3)))
    assert not st.render(st.Scene(ambient, none), **SMALL).any()


def test_empty_scene_shows_its_background():
    empty = st.Spheres(np.zeros((0, 3)), np.zeros(0))
    scene = st.Scene(empty, st.Lights([[0.0, 0, 9]]), background=(0.1, 0.2, 0.3))
    for needs in (None, st.Needs()):
        picture = st.render(scene, needs=needs, **SMALL)
        np.testing.assert_array_equal(picture, np.broadcast_to([0.1, 0.2, 0.3], (24, 24, 3)))


def test_shadows_of_nine_spheres():
    for light, shadows in (((100.0, 500, 800), False), ((100.0, 900, 300), True)):
        scene = nine_spheres(light)
        with_shadows = st.render(scene, bounces=0, width=64, height=64)
        no_shadows = dataclasses.replace(FLAT, highlights=True)
        picture = st.render(scene, needs=no_shadows, width=64, height=64)
        assert bool(jnp.any(picture != with_shadows)) is shadows


def test_hall_of_mirrors():
    # between two facing mirrors of kgr 1 and ambient colour 1 every bounce adds 1
    mirrors = st.Planes(
        [[0.0, 0, -100], [0, 0, 600]], [[0.0, 0, 1]] * 2, (1.0, 1, 1), 1.0, 0.0, kgr=1.0
    )
    empty = st.Spheres(np.zeros((0, 3)), np.zeros(0))
    scene = st.Scene(empty, st.Lights([[0.0, 0, 300]]), st.Camera(), mirrors)
    for bounces in (0, 1, 4, 30):
        picture = st.render(scene, width=1, height=1, bounces=bounces)
        np.testing.assert_allclose(middle(picture), 1 + bounces, rtol=1e-12)


def test_bubble_adds_the_color_behind_it():
    spheres = st.Spheres([[0.0, 0, 0], [0, 0, -300]], 100.0, (1.0, 1, 1), 0.25, 0.0, kt=[0.5, 0.0])
    scene = st.Scene(spheres, st.Lights([[0.0, 0, 900]]))
    np.testing.assert_allclose(middle(st.render(scene, **SMALL)), 0.25 + 0.5 * 0.25)
    assert middle(st.render(scene, bounces=0, **SMALL))[0] == 0.25


def test_back_plane_hides_objects_beyond_it():
    spheres = st.Spheres([[0.0, 0, -900]], [100.0], (1.0, 0, 0))
    back = st.BackPlane((0.0, 0, 1), 1.0, 0.0)
    scene = st.Scene(spheres, st.Lights([[0.0, 0, 900]]), back_plane=back)
    np.testing.assert_allclose(st.render(scene, **SMALL), np.broadcast_to([0.0, 0, 1], (24, 24, 3)))


@pytest.mark.parametrize("name", ["shadows", "glass", "planes", "textures"])
def test_samples_are_the_mean_of_a_finer_picture(name):
    scene = SCENES[name]
    fine = st.render(scene, width=24, height=24, samples=1, bounces=2)
    coarse = st.render(scene, width=12, height=12, samples=2, bounces=2)
    np.testing.assert_allclose(coarse, fine.reshape(12, 2, 12, 2, 3).mean((1, 3)), atol=1e-12)


@pytest.mark.slow
def test_antialias_1_against_samples():
    scene = SCENES["shadows"]
    smooth = scene.with_antialias(1)
    size = dict(width=48, height=48)
    truth = st.render(scene, samples=16, **size)
    error = lambda picture: float(jnp.linalg.norm(picture - truth))
    assert error(st.render(smooth, **size)) < error(st.render(scene, samples=3, **size))


def test_strips_leave_no_seams(monkeypatch):
    scene, size = SCENES["planes"], dict(width=23, height=19, bounces=1)
    one_strip = st.render(scene, **size)
    monkeypatch.setattr(samples, "STRIP_PIXELS", 100)
    strips = eqx.filter_jit(module.draw.__wrapped__)(scene, module.render_settings(scene, **size))
    np.testing.assert_allclose(strips, one_strip, atol=1e-14)


@pytest.mark.parametrize(
    ("side", "antialias", "most"),
    [(1024, 0, 32e6), (4096, 0, 32e6), pytest.param(4096, 1, 1.5e9, marks=pytest.mark.slow)],
)
def test_memory_of_large_pictures(side, antialias, most):
    scene = SCENES["shadows"].astype(jnp.float32).with_antialias(antialias)
    needs = st.needs(scene)
    draw = jax.jit(lambda s: st.render(s, width=side, height=side, needs=needs))
    used = draw.lower(scene).compile().memory_analysis()
    assert used.temp_size_in_bytes < most
    assert used.output_size_in_bytes == side * side * 3 * 4


def test_many_lights_and_spheres():
    rng = np.random.default_rng(0)
    spheres, few = SCENES["shadows"].spheres, st.Lights(rng.uniform(200, 500, (3, 3)))
    unlit = np.zeros((9, 3))
    many = st.Lights(
        np.concatenate([few.position, rng.uniform(200, 500, (9, 3))]),
        np.concatenate([4 * np.ones((3, 3)), unlit]),  # the mean of the lights stays white
    )
    hidden = st.Spheres(
        np.concatenate([spheres.center, np.tile([[0.0, 0, 4000]], (40, 1))]),
        np.concatenate([spheres.radius, np.full(40, 1e-3)]),
        np.concatenate([spheres.color, np.ones((40, 3))]),
        *(
            np.concatenate([x, np.full(40, 0.1)])
            for x in (spheres.ka, spheres.kd / 4, spheres.ks / 4)
        ),
        np.concatenate([spheres.exponent, np.ones(40)]),
    )
    a = st.render(st.Scene(spheres, few, CAMERA), **SMALL)
    b = st.render(st.Scene(hidden, many, CAMERA), **SMALL)
    np.testing.assert_allclose(a, b, atol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("count", [pytest.param(128, marks=pytest.mark.slow), 300])
def test_ids_do_not_overflow(count):
    behind = np.arange(count)[::-1]  # the last sphere is in the middle of the picture
    center = np.stack([30.0 * (behind % 10), 30.0 * (behind // 10), 0 * behind], axis=1)
    scene = st.Scene(st.Spheres(center, 10.0, pic=0), st.Lights([[0.0, 0, 900]]))
    picture = st.render(scene, width=64, height=64, needs=st.Needs(), bounces=0, samples=1)
    lean = st.render(scene, width=64, height=64, bounces=0)
    np.testing.assert_allclose(picture, lean, atol=1e-13)
    last = st.render(
        eqx.tree_at(lambda s: s.spheres.color, scene, jnp.zeros((count, 3)).at[-1].set(1.0)),
        width=64, height=64,
    )  # fmt: skip
    assert 0 < np.count_nonzero(last.max(-1)) < 64


def test_new_numbers_do_not_compile_again(monkeypatch):
    traced = []
    inner = module.build_context
    counted = lambda *arguments: traced.append(1) or inner(*arguments)
    monkeypatch.setattr(module, "build_context", counted)
    scene = SCENES["mirrors"]
    for factor in (1.0, 1.01, 0.99):
        changed = jax.tree.map(lambda leaf, f=factor: leaf * f, scene)
        iors = lambda s: (s.spheres.ior, s.planes.ior)  # at least 1
        changed = eqx.tree_at(iors, changed, iors(scene))
        st.render(changed, width=17, height=13)
    assert len(traced) == 1


def test_jit_and_vmap():
    scene = SCENES["planes"]
    needs = st.needs(scene)
    draw = lambda s: st.render(s, needs=needs, bounces=1, **SMALL)
    lights = st.Lights(WHITE, [[2.0, 2, 2]])
    brighter = eqx.tree_at(lambda s: s.lights, scene, lights)
    both = jax.tree.map(lambda a, b: jnp.stack([a, b]), scene, brighter)
    pictures = jax.vmap(draw)(both)
    np.testing.assert_allclose(pictures[0], jax.jit(draw)(scene), atol=1e-13)
    np.testing.assert_allclose(pictures[1], 2 * pictures[0], atol=1e-12)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (dict(width=0), "width must be at least 1, got 0"),
        (dict(height=-3), "height must be at least 1, got -3"),
        (dict(bounces=-1), "bounces must be at least 0, got -1"),
        (dict(samples=0), "samples must be in 1..256, got 0"),
        (dict(samples=1000), "samples must be in 1..256, got 1000"),
        (dict(bounces=17), "bounces must be at most 16, got 17"),
    ],
)
def test_arguments_out_of_range(wrong, message):
    with pytest.raises(st.InputError, match=message):
        st.render(SCENES["glass"], **(SMALL | wrong))
