"""Every picture by lists is the one that looks at all spheres, to the last pixel."""

from importlib import import_module

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spheretrace_jax as st
from spheretrace_jax.acceleration.accelerator import build_accelerator
from spheretrace_jax.base.vec import Vec, reflect, unit, vec
from spheretrace_jax.scene.camera import Ray, pixel_rays
from spheretrace_jax.scene.settings import render_settings
from spheretrace_jax.tracing.queries import closest_hit, light_visible
from spheretrace_jax.tracing.tables import Hit, build_tables, surface_at

accelerator_module = import_module("spheretrace_jax.acceleration.accelerator")
render_module = import_module("spheretrace_jax.rendering.render")

FAR, SIZE = (100.0, 500, 800), (50, 37)
CAMERA = st.Camera(0.3, 0.6, 500.0, 800.0)


COUNT = 500  # of all scenes, so that all of them are compiled once


def cloud(light=FAR, spread=150.0, radius=(3.0, 6.0), extra=(), twins=False):
    """Spheres in a cube, of random sizes, of which the last few are given as (x, y, z, radius)."""
    rng = np.random.default_rng(0)
    center, size = rng.uniform(-spread, spread, (COUNT, 3)), rng.uniform(*radius, COUNT)
    if twins:
        some = rng.permutation(COUNT) % (COUNT // 2)
        center, size = center[some], size[some]
    extra = np.reshape(extra, (-1, 4))
    center = np.concatenate([center, extra[:, :3]])[-COUNT:]
    size = np.concatenate([size, extra[:, 3]])[-COUNT:]
    spheres = st.Spheres(center, size, rng.uniform(0.2, 0.9, (COUNT, 3)))
    return st.Scene(spheres, st.Lights([light]), CAMERA, antialias=0)


def flat(*scale):
    scene = cloud()
    return eqx.tree_at(lambda s: s.spheres.center, scene, scene.spheres.center * jnp.array([scale]))


def seen_from(scene, theta=0.3, phi=0.6, mu=500.0, distance=800.0):
    return eqx.tree_at(lambda s: s.camera, scene, st.Camera(theta, phi, mu, distance))


SCENES = {
    "apart": cloud(radius=(1.0, 2.0)),
    "overlapping": cloud(radius=(10.0, 50.0)),
    "of all sizes": eqx.tree_at(
        lambda s: s.spheres.radius, cloud(), jnp.asarray(100 * 10 ** -np.linspace(0, 5, COUNT))
    ),
    "tiny": cloud(radius=(1e-3, 1e-1)),
    "twins": cloud(twins=True),
    "the eye inside one": cloud(extra=[(0, 0, 40, 500)]),
    "the eye among them": seen_from(cloud(), mu=10.0, distance=60.0),
    "a wide view": seen_from(cloud(), mu=200.0, distance=90.0),
    "behind the eye": cloud(spread=1000.0, radius=(10.0, 30.0)),
    "a huge floor": cloud(extra=[(0, 0, -1e5 - 100, 1e5)]),
    "a light among them": cloud(light=(10.0, 20, 30)),
    "a light in one": cloud(light=(10.0, 20, 30), extra=[(10, 20, 25, 30)]),
    "a light at the eye": cloud(light=(83.0, 26, 413)),
    "a light behind all": cloud(light=(-100.0, -500, -800)),
    "a light far away": cloud(light=(1e6, -5e6, 8e6)),
    "in a row": flat(1.0, 1e-3, 1e-3),
    "in a plane": flat(1.0, 1, 0),
    "all in one place": flat(0.0, 0, 0),
    "one far away": cloud(extra=[(0, -1e7, -1e7, 1e3)]),
}


NEEDS = st.Needs(planes=False)


def accelerator(scene, bounces):
    settings = render_settings(scene, *SIZE, bounces=bounces, needs=NEEDS)
    spheres = scene.spheres
    return build_accelerator(Vec(*spheres.center.T), spheres.radius, scene, settings)


def by_lists(scene, of):
    return of(scene, build_tables(scene).listed(accelerator(scene, bounces=1)))


def plainly(scene, of):
    return of(scene, build_tables(scene))


def eye_rays(scene):
    columns, rows = (jnp.arange(n, dtype=scene.dtype) + 0.5 for n in SIZE)
    return pixel_rays(scene.camera, columns[None], rows[:, None], SIZE)


def looked_at(scene, world):
    """What the eye sees, whether the light does, and what is seen mirrored and straight on."""
    strip = world.of_strip(jnp.zeros((), jnp.int32))
    ray = eye_rays(scene)
    hit = closest_hit(strip, ray, NEEDS)
    surface = surface_at(world, ray, hit, NEEDS)
    lit = light_visible(world, surface.point, hit, vec(scene.lights.position[0]), NEEDS)
    direction = reflect(ray.direction, surface.normal)
    mirrored = closest_hit(world, Ray(surface.point, direction), NEEDS, hit)
    on = closest_hit(
        world, Ray(surface.point, ray.direction), NEEDS, Hit(hit.id, hit.inside & False)
    )
    some = hit.id >= 0
    none = lambda h: Hit(jnp.where(some, h.id, -1), h.inside & some)
    return hit, lit | ~some, none(mirrored), none(on)


@pytest.fixture(autouse=True, scope="module")
def lists_even_of_few():
    limit, accelerator_module.MAX_BRUTE_FORCE = accelerator_module.MAX_BRUTE_FORCE, 1
    yield
    accelerator_module.MAX_BRUTE_FORCE = limit


look_by_lists = jax.jit(lambda scene: by_lists(scene, looked_at))
look_plainly = jax.jit(lambda scene: plainly(scene, looked_at))


def as_float32(scene):
    return jax.tree.map(lambda x: x.astype(jnp.float32), scene)


@pytest.mark.parametrize("dtype", [pytest.param("float64", marks=pytest.mark.slow), "float32"])
@pytest.mark.parametrize("name", SCENES)
def test_the_same_is_met_by_lists_as_without(name, dtype):
    scene = SCENES[name] if dtype == "float64" else as_float32(SCENES[name])
    found, expected = look_by_lists(scene), look_plainly(scene)
    if name == "twins":  # where a ray leaves one it starts on the other, up to rounding
        found, expected = found[:2], expected[:2]
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(a, b)


def picture(scene, **options):
    shape = dict(width=SIZE[0], height=SIZE[1], needs=NEEDS, bounces=1)
    return st.render(scene, **(shape | options))


def without_lists(monkeypatch, function, *arguments):
    """What a function gives, compiled anew, where spheres are few."""
    with monkeypatch.context() as patch:
        patch.setattr(accelerator_module, "MAX_BRUTE_FORCE", COUNT)
        jax.clear_caches()
        value = function(*arguments)
    jax.clear_caches()
    return value


MIRRORS = eqx.tree_at(lambda s: s.spheres.kgr, cloud(), jnp.full(COUNT, 0.4))
IDS = ["picture", "gradient", "many", "samples"]


def gradient(scene):
    weights = jnp.cos(jnp.arange(3 * SIZE[0] * SIZE[1])).reshape(*SIZE[::-1], 3)
    return jax.grad(lambda s: jnp.sum(weights * picture(s, bounces=0)))(scene)


def of_many(scene):
    lights = jnp.array([[FAR], [(200.0, -400, 800)]])
    at = lambda light: eqx.tree_at(lambda s: s.lights.position, scene, light)
    lit = lambda light: picture(at(light), bounces=0)
    return jax.vmap(lit)(lights)


def of_samples(scene):
    return picture(scene, samples=2, bounces=0)


SLOW = [pytest.param(f, marks=pytest.mark.slow) for f in (of_many, of_samples)]


@pytest.mark.parametrize("draw", [picture, gradient, *SLOW], ids=IDS)
def test_pictures_and_gradients_are_those_without_lists(draw, monkeypatch):
    monkeypatch.setattr(render_module, "STRIP_PIXELS", 700)  # three strips
    jax.clear_caches()
    listed, plain = draw(MIRRORS), without_lists(monkeypatch, draw, MIRRORS)
    for a, b in zip(jax.tree.leaves(listed), jax.tree.leaves(plain), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)


def test_rays_from_anywhere_that_go_on_in_chunks_meet_the_same():
    scene, rng = cloud(), np.random.default_rng(0)
    origin, direction = (Vec(*jnp.asarray(rng.standard_normal((3, 100, 90)))) for _ in range(2))
    ray = Ray(origin * 100, unit(direction))
    nobody = Hit(jnp.full((100, 90), COUNT, jnp.int16), jnp.full((100, 90), False))
    found = by_lists(scene, lambda _, world: closest_hit(world, ray, NEEDS, nobody))
    expected = plainly(scene, lambda _, world: closest_hit(world, ray, NEEDS, nobody))
    np.testing.assert_array_equal(found.id, expected.id)
    np.testing.assert_array_equal(found.inside, expected.inside)
    assert (found.id < 0).any() and len(np.unique(found.id)) > 100 and found.inside.any()


def test_the_last_of_very_many_is_seen():
    spheres = st.Spheres(jnp.full((300_000, 3), 1e4).at[-1].set(0), jnp.full(300_000, 20.0))
    scene = st.Scene(spheres, st.Lights([FAR]), CAMERA, antialias=0)
    assert picture(scene, bounces=0)[SIZE[1] // 2, SIZE[0] // 2].sum() > 0


def test_compiling_does_not_depend_on_how_many_spheres_there_are():
    def lines(n):
        spheres = st.Spheres(jnp.zeros((n, 3)), jnp.ones(n))
        scene = st.Scene(spheres, st.Lights([FAR]), CAMERA, antialias=0)
        return len(jax.jit(lambda s: picture(s)).lower(scene).as_text().splitlines())

    assert lines(40_000) == lines(400_000)


def test_a_light_that_has_no_list_is_looked_at_past_all_spheres():
    scene = cloud()
    world = build_tables(scene).listed(accelerator(scene, bounces=0))
    point = world.balls.center
    point = Vec(point.x, point.y, point.z + world.balls.radius)
    hit = Hit(jnp.arange(COUNT, dtype=jnp.int32), jnp.full(COUNT, False))
    light = vec(jnp.array([-300.0, 20, 500]))
    lit = [light_visible(w, point, hit, light, NEEDS) for w in (world, build_tables(scene))]
    np.testing.assert_array_equal(*lit)
    assert 0 < lit[0].sum() < lit[0].size
