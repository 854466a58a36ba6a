"""The accelerator: every picture equals the one that tests all spheres, to the last pixel."""

from importlib import import_module

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.contexts import context_of

import spheretrace_jax as st
from spheretrace_jax.base.vec import SplitVec, reflect, unit
from spheretrace_jax.scene.camera import Ray, pixel_rays
from spheretrace_jax.scene.light import each_light
from spheretrace_jax.tracing.hit import Hit
from spheretrace_jax.tracing.queries import closest_hit, light_visible
from spheretrace_jax.tracing.surface import surface_at

accelerator_module = import_module("spheretrace_jax.acceleration.accelerator")
samples = import_module("spheretrace_jax.rendering.samples")
render_samples = samples.render_samples

FAR, SIZE = (100.0, 500, 800), (50, 37)
CAMERA = st.Camera(0.3, 0.6, 500.0, 800.0)


COUNT = 500  # spheres of every scene, so that all scenes share one compilation


def cloud(light=FAR, spread=150.0, radius=(3.0, 6.0), extra=(), twins=False, directional=False):
    """Makes spheres of random sizes in a cube; `extra` replaces the last: (x, y, z, radius)."""
    rng = np.random.default_rng(0)
    center, size = rng.uniform(-spread, spread, (COUNT, 3)), rng.uniform(*radius, COUNT)
    if twins:
        twin = rng.permutation(COUNT) % (COUNT // 2)
        center, size = center[twin], size[twin]
    extra = np.reshape(extra, (-1, 4))
    center = np.concatenate([center, extra[:, :3]])[-COUNT:]
    size = np.concatenate([size, extra[:, 3]])[-COUNT:]
    spheres = st.Spheres(center, size, rng.uniform(0.2, 0.9, (COUNT, 3)))
    return st.Scene(spheres, st.Lights([light], directional=directional), CAMERA, antialias=0)


def flat(*scale):
    scene = cloud()
    return eqx.tree_at(lambda s: s.spheres.center, scene, scene.spheres.center * jnp.array([scale]))


def viewed_from(scene, theta=0.3, phi=0.6, mu=500.0, distance=800.0):
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
    "the eye among them": viewed_from(cloud(), mu=10.0, distance=60.0),
    "a wide view": viewed_from(cloud(), mu=200.0, distance=90.0),
    "behind the eye": cloud(spread=1000.0, radius=(10.0, 30.0)),
    "a huge floor": cloud(extra=[(0, 0, -1e5 - 100, 1e5)]),
    "a light among them": cloud(light=(10.0, 20, 30)),
    "a light in one": cloud(light=(10.0, 20, 30), extra=[(10, 20, 25, 30)]),
    "a light at the eye": cloud(light=(83.0, 26, 413)),
    "a light behind all": cloud(light=(-100.0, -500, -800)),
    "a light far away": cloud(light=(1e6, -5e6, 8e6)),
    "a directional light": cloud(light=(0.1, -0.5, 0.8), directional=True),
    "a directional light along an axis": cloud(light=(3e20, 0.0, 0.0), directional=True),
    "in a row": flat(1.0, 1e-3, 1e-3),
    "in a plane": flat(1.0, 1, 0),
    "all at one point": flat(0.0, 0, 0),
    "one far away": cloud(extra=[(0, -1e7, -1e7, 1e3)]),
}


NEEDS = st.Needs(planes=False)


def accelerated(scene, of, bounces=1):
    return of(context_of(scene, NEEDS, SIZE, bounces, accelerated=True))


def exhaustive(scene, of):
    return of(context_of(scene, NEEDS, SIZE, 1))


def eye_rays(scene):
    columns, rows = (jnp.arange(n, dtype=scene.dtype) + 0.5 for n in SIZE)
    return pixel_rays(scene.camera, columns[None], rows[:, None], SIZE)


def visibility(context):
    """Returns the eye's hits, the light's visibility, the mirrored and transmitted rays' hits."""
    strip = context.from_row(jnp.zeros((), jnp.int32))
    ray = eye_rays(context.scene)
    hit = closest_hit(strip, ray)
    surface = surface_at(context, ray, hit)
    light = next(each_light(context.scene.lights, falloff=False))
    lit = light_visible(context, surface.point, hit, light)
    direction = reflect(ray.direction, surface.normal)
    mirrored = closest_hit(context, Ray(surface.point, direction), hit)
    straight_on = Ray(surface.point, ray.direction)
    transmitted = closest_hit(context, straight_on, Hit(hit.id, hit.inside & False))
    any_hit = hit.id >= 0
    if_hit = lambda h: Hit(jnp.where(any_hit, h.id, -1), h.inside & any_hit)
    return hit, lit | ~any_hit, if_hit(mirrored), if_hit(transmitted)


@pytest.fixture(autouse=True, scope="module")
def accelerate_few_spheres():
    limit, accelerator_module.MAX_BRUTE_FORCE = accelerator_module.MAX_BRUTE_FORCE, 1
    yield
    accelerator_module.MAX_BRUTE_FORCE = limit


accelerated_visibility = jax.jit(lambda scene: accelerated(scene, visibility))
exhaustive_visibility = jax.jit(lambda scene: exhaustive(scene, visibility))


def as_float32(scene):
    return jax.tree.map(lambda x: x.astype(jnp.float32), scene)


@pytest.mark.parametrize("dtype", [pytest.param("float64", marks=pytest.mark.slow), "float32"])
@pytest.mark.parametrize("name", SCENES)
def test_same_hits(name, dtype):
    scene = SCENES[name] if dtype == "float64" else as_float32(SCENES[name])
    found, expected = accelerated_visibility(scene), exhaustive_visibility(scene)
    if name == "twins":  # a ray that leaves a sphere starts on its twin, up to rounding
        found, expected = found[:2], expected[:2]
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(a, b)


def picture(scene, **settings):
    shape = dict(width=SIZE[0], height=SIZE[1], needs=NEEDS, bounces=1)
    return st.render(scene, **(shape | settings))


def unaccelerated(monkeypatch, function, *arguments):
    """Runs a function, compiled anew, with an accelerator only above `COUNT` spheres."""
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


def several_lights(scene):
    lights = jnp.array([[FAR], [(200.0, -400, 800)]])
    at = lambda light: eqx.tree_at(lambda s: s.lights.position, scene, light)
    lit = lambda light: picture(at(light), bounces=0)
    return jax.vmap(lit)(lights)


def two_samples(scene):
    return picture(scene, samples=2, bounces=0)


SLOW = [pytest.param(f, marks=pytest.mark.slow) for f in (gradient, several_lights, two_samples)]


@pytest.mark.slow
@pytest.mark.parametrize("draw", [picture, *SLOW], ids=IDS)
def test_same_pictures_and_gradients(draw, monkeypatch):
    monkeypatch.setattr(samples, "STRIP_PIXELS", 700)  # three strips
    jax.clear_caches()
    fast, slow = draw(MIRRORS), unaccelerated(monkeypatch, draw, MIRRORS)
    for a, b in zip(jax.tree.leaves(fast), jax.tree.leaves(slow), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)


def test_same_hits_of_any_rays():
    scene, rng = cloud(), np.random.default_rng(0)
    origin, direction = (
        SplitVec(*jnp.asarray(rng.standard_normal((3, 100, 90)))) for _ in range(2)
    )
    ray = Ray(origin * 100, unit(direction))
    no_source = Hit(jnp.full((100, 90), COUNT, jnp.int16), jnp.full((100, 90), False))
    found = accelerated(scene, lambda context: closest_hit(context, ray, no_source))
    expected = exhaustive(scene, lambda context: closest_hit(context, ray, no_source))
    np.testing.assert_array_equal(found.id, expected.id)
    np.testing.assert_array_equal(found.inside, expected.inside)
    assert (found.id < 0).any() and len(np.unique(found.id)) > 100 and found.inside.any()


def test_last_of_many_spheres_is_seen():
    spheres = st.Spheres(jnp.full((300_000, 3), 1e4).at[-1].set(0), jnp.full(300_000, 20.0))
    scene = st.Scene(spheres, st.Lights([FAR]), CAMERA, antialias=0)
    assert picture(scene, bounces=0)[SIZE[1] // 2, SIZE[0] // 2].sum() > 0


def test_program_size_is_constant():
    def lines(n):
        spheres = st.Spheres(jnp.zeros((n, 3)), jnp.ones(n))
        scene = st.Scene(spheres, st.Lights([FAR]), CAMERA, antialias=0)
        return len(jax.jit(lambda s: picture(s)).lower(scene).as_text().splitlines())

    assert lines(40_000) == lines(400_000)


def test_other_lights_have_no_buffers():
    scene = cloud()
    top = scene.spheres.center.at[:, 2].add(scene.spheres.radius)
    point = SplitVec(*top.T)
    hit = Hit(jnp.arange(COUNT, dtype=jnp.int32), jnp.full(COUNT, False))
    lights = st.Lights(jnp.array([[-300.0, 20, 500]]))

    def test(context):
        light = next(each_light(lights, falloff=False))
        return light_visible(context.with_lights(lights), point, hit, light)

    lit = accelerated(scene, test, bounces=0), exhaustive(scene, test)
    np.testing.assert_array_equal(*lit)
    assert 0 < lit[0].sum() < lit[0].size


# -- covered edges


def covered(bounces, is_accelerated):
    """Returns a function from a scene to its picture before the pixel filter, and its edges."""
    needs = st.Needs(
        planes=False, transmission=False, branching=False, textures=False, background=False,
        reflection=bounces > 0,
    )  # fmt: skip

    @jax.jit
    def draw(scene):
        return render_samples(context_of(scene, needs, SIZE, bounces, is_accelerated))

    return draw


def assert_same_covered(scene, draw, tolerance):
    (found, found_edges), (expected, edges) = (d(scene.with_antialias(1)) for d in draw)
    np.testing.assert_array_equal(found_edges, edges)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance)


DRAW = covered(0, True), covered(0, False)
DRAW_MIRRORS = covered(2, True), covered(2, False)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [pytest.param("float64", marks=pytest.mark.slow), "float32"])
@pytest.mark.parametrize("name", SCENES)
def test_same_covered_edges(name, dtype):
    if dtype == "float64":
        assert_same_covered(SCENES[name], DRAW, 1e-13)
    else:
        assert_same_covered(as_float32(SCENES[name]), DRAW, 1e-6)


# a ray that leaves a twin starts on the other one, up to rounding
@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in SCENES if name != "twins"])
def test_same_covered_edges_in_mirrors(name):
    scene = SCENES[name]
    mirrors = eqx.tree_at(lambda s: s.spheres.kgr, scene, jnp.full(COUNT, 0.4))
    assert_same_covered(mirrors, DRAW_MIRRORS, 1e-12)
