"""Ray queries: the closest hit and the visibility of lights."""

from functools import partial

import jax.numpy as jnp
import pytest
from helpers.contexts import context_of

import spheretrace_jax as st
from spheretrace_jax.base.vec import vec
from spheretrace_jax.scene.camera import Ray
from spheretrace_jax.scene.light import make_light
from spheretrace_jax.tracing.hit import Hit
from spheretrace_jax.tracing.queries import closest_hit, light_visible


def context_of_spheres(*spheres, planes=None):
    """Builds the context of spheres on the x axis, each as (x, radius)."""
    center = [[float(x), 0, 0] for x, _ in spheres]
    spheres = st.Spheres(center, [float(r) for _, r in spheres])
    return context_of(st.Scene(spheres, st.Lights([[0.0, 0, 0]]), planes=planes))


def hit_by(context, origin, direction, source_hit=None):
    ray = Ray(vec(jnp.array(origin, float)), vec(jnp.array(direction, float)))
    hit = closest_hit(context, ray, source_hit)
    return int(hit.id), bool(hit.inside)


def source(number, inside):
    return Hit(jnp.array(number), jnp.array(inside))


def lit(context, point, light, number=-1, inside=False, directional=False):
    light = make_light(jnp.array(light, float), None, directional)
    return bool(light_visible(context, vec(jnp.array(point, float)), source(number, inside), light))


def test_nearest_of_two_in_any_order():
    assert hit_by(context_of_spheres((0, 1), (5, 1)), [-9, 0, 0], [1, 0, 0]) == (0, False)
    assert hit_by(context_of_spheres((5, 1), (0, 1)), [-9, 0, 0], [1, 0, 0]) == (1, False)


def test_nothing_is_hit_behind_the_eye():
    assert hit_by(context_of_spheres((0, 1)), [9, 0, 0], [1, 0, 0]) == (-1, False)


def test_sphere_around_the_origin_is_hit_inside():
    assert hit_by(context_of_spheres((0, 4)), [1, 0, 0], [1, 0, 0]) == (0, True)


def test_ray_skips_its_source_without_epsilon():
    context = context_of_spheres((0, 1), (5, 1))
    assert hit_by(context, [1, 0, 0], [1, 0, 0], source(0, False)) == (1, False)
    assert hit_by(context, [-1, 0, 0], [1, 0, 0], source(0, False)) == (
        1,
        False,
    )  # straight through


def test_ray_inside_hits_its_source_again():
    assert hit_by(context_of_spheres((0, 1)), [1, 0, 0], [-1, 0, 0], source(0, True)) == (0, True)


@pytest.mark.parametrize(
    ("point", "light", "expected"),
    [
        ([-9, 0, 0], [9, 0, 0], False),
        ([-9, 0, 0], [-5, 0, 0], True),
        ([-9, 2, 0], [9, 2, 0], True),
        ([-9, 0, 0], [0.5, 0, 0], False),
        ([0.5, 0, 0], [-0.5, 0, 0], True),
        ([0.5, 0, 0], [9, 0, 0], False),
    ],
    ids=["between", "beyond the light", "past it", "light inside", "both inside", "point inside"],
)
def test_shadow_of_a_sphere(point, light, expected):
    assert lit(context_of_spheres((0, 1)), point, light) is expected


@pytest.mark.parametrize(
    ("point", "light", "expected"),
    [
        ([-9, 0, 0], [9, 0, 0], False),
        ([9, 0, 0], [9, 0, 0], True),
        ([-9, 2, 0], [1, 0, 0], True),
        ([-9, 0, 0], [-1e-30, 0, 0], True),
        ([0.5, 0, 0], [1e30, 0, 0], False),
    ],
    ids=["in the way", "behind", "past it", "other way", "point inside"],
)
def test_shadow_of_a_sphere_from_a_directional_light(point, light, expected):
    assert lit(context_of_spheres((0, 1)), point, light, directional=True) is expected


def test_shadow_of_a_plane_from_a_directional_light():
    context = context_of_spheres((50, 1), planes=st.Planes([[0.0, 0, 3]], [[0.0, 0, 2]]))
    shines = partial(lit, context, directional=True)
    assert not shines([0, 0, 2], [0, 0, 5]) and shines([0, 0, 4], [0, 0, 5])
    assert shines([0, 0, 2], [0, 0, -5]) and shines([0, 0, 2], [1, 0, 0])


@pytest.mark.parametrize("directional", [False, True])
@pytest.mark.parametrize("unit", [1e-12, 1e-6, 1.0, 1e6, 1e12])
def test_shadows_in_any_unit_of_length(unit, directional):
    center = jnp.asarray([[0.0, 0, 0], [300, 0, 0]]) * unit
    spheres = st.Spheres(center.astype(jnp.float32), jnp.full(2, 100 * unit, jnp.float32))
    scene = st.Scene(spheres, st.Lights([[0.0, 0, 0]]))
    context = context_of(scene, st.Needs(planes=False))
    light = make_light(jnp.asarray([1e6 * unit, 0, 0], jnp.float32), None, directional)
    for height, expected in ((99.0, False), (101.0, True)):
        point = vec(jnp.asarray([-200 * unit, height * unit, 0], jnp.float32))
        visible = light_visible(context, point, source(-1, False), light)
        assert bool(visible) is expected


def test_wall_of_a_room_blocks_outer_lights():
    room = context_of_spheres((0, 10))
    assert lit(room, [10, 0, 0], [3, 0, 0], 0, True)
    assert not lit(room, [10, 0, 0], [-30, 0, 0], 0, True)


def test_shadow_of_a_plane():
    planes = st.Planes([[0.0, 0, 0]], [[0.0, 0, 1]])
    context = context_of_spheres((50, 1), planes=planes)
    assert not lit(context, [0, 0, -1], [0, 0, 5])
    assert lit(context, [0, 0, 1], [0, 0, 5])
    assert lit(context, [0, 0, 0], [0, 0, 5], number=1)


def test_many_spheres_agree_with_few():
    few = [(4.0 * i, 1.0) for i in range(9)]
    far_away = [(1e4 + 4.0 * i, 1.0) for i in range(200)]
    for balls in (few, few + far_away):
        context = context_of_spheres(*balls)
        assert hit_by(context, [18, 0, 0], [-1, 0, 0]) == (4, False)
        assert not lit(context, [18, 0, 0], [30, 0, 0])
        assert lit(context, [18, 0, 0], [18.5, 0, 0])
