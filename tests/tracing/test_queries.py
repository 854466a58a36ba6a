import jax.numpy as jnp
import pytest

import spheretrace_jax as st
from spheretrace_jax.base.vec import vec
from spheretrace_jax.scene.camera import Ray
from spheretrace_jax.tracing.queries import closest_hit, light_visible
from spheretrace_jax.tracing.tables import Hit, build_tables


def world_of(*balls, planes=None):
    """Spheres as (x, radius) on the x axis."""
    center = [[float(x), 0, 0] for x, _ in balls]
    spheres = st.Spheres(center, [float(r) for _, r in balls])
    return build_tables(st.Scene(spheres, st.Lights([[0.0, 0, 0]]), planes=planes))


def seen(world, origin, direction, leaving=None):
    ray = Ray(vec(jnp.array(origin, float)), vec(jnp.array(direction, float)))
    hit = closest_hit(world, ray, st.Needs(), leaving)
    return int(hit.id), bool(hit.inside)


def left(number, inside):
    return Hit(jnp.array(number), jnp.array(inside))


def lit(world, point, light, number=-1, inside=False):
    arguments = vec(jnp.array(point, float)), left(number, inside), vec(jnp.array(light, float))
    return bool(light_visible(world, *arguments, st.Needs()))


def test_the_nearest_of_two_is_seen_whatever_their_order():
    assert seen(world_of((0, 1), (5, 1)), [-9, 0, 0], [1, 0, 0]) == (0, False)
    assert seen(world_of((5, 1), (0, 1)), [-9, 0, 0], [1, 0, 0]) == (1, False)


def test_nothing_is_seen_behind_the_eye():
    assert seen(world_of((0, 1)), [9, 0, 0], [1, 0, 0]) == (-1, False)


def test_a_sphere_around_the_origin_is_seen_from_inside():
    assert seen(world_of((0, 4)), [1, 0, 0], [1, 0, 0]) == (0, True)


def test_rays_that_leave_a_sphere_skip_it_and_need_no_epsilon():
    world = world_of((0, 1), (5, 1))
    assert seen(world, [1, 0, 0], [1, 0, 0], left(0, False)) == (1, False)
    assert seen(world, [-1, 0, 0], [1, 0, 0], left(0, False)) == (1, False)  # straight through


def test_rays_mirrored_inside_a_sphere_meet_it_again():
    assert seen(world_of((0, 1)), [1, 0, 0], [-1, 0, 0], left(0, True)) == (0, True)


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
    ids=["between", "beyond the light", "beside", "light inside", "both inside", "point inside"],
)
def test_who_casts_a_shadow(point, light, expected):
    assert lit(world_of((0, 1)), point, light) is expected


@pytest.mark.parametrize("unit", [1e-12, 1e-6, 1.0, 1e6, 1e12])
def test_shadows_of_far_lights_survive_any_unit_of_length_in_float32(unit):
    center = jnp.asarray([[0.0, 0, 0], [300, 0, 0]]) * unit
    spheres = st.Spheres(center.astype(jnp.float32), jnp.full(2, 100 * unit, jnp.float32))
    world = build_tables(st.Scene(spheres, st.Lights([[0.0, 0, 0]])))
    light = vec(jnp.asarray([1e6 * unit, 0, 0], jnp.float32))
    for height, expected in ((99.0, False), (101.0, True)):
        point = vec(jnp.asarray([-200 * unit, height * unit, 0], jnp.float32))
        seen = light_visible(world, point, left(-1, False), light, st.Needs(planes=False))
        assert bool(seen) is expected


def test_the_wall_of_a_room_keeps_outer_lights_out_and_inner_lights_in():
    room = world_of((0, 10))
    assert lit(room, [10, 0, 0], [3, 0, 0], 0, True)
    assert not lit(room, [10, 0, 0], [-30, 0, 0], 0, True)


def test_a_plane_casts_a_shadow_on_the_side_away_from_the_light():
    planes = st.Planes([[0.0, 0, 0]], [[0.0, 0, 1]])
    world = world_of((50, 1), planes=planes)
    assert not lit(world, [0, 0, -1], [0, 0, 5])
    assert lit(world, [0, 0, 1], [0, 0, 5])
    assert lit(world, [0, 0, 0], [0, 0, 5], number=1)


def test_visibility_of_many_spheres_loops_and_agrees_with_few():
    few = [(4.0 * i, 1.0) for i in range(9)]
    far_away = [(1e4 + 4.0 * i, 1.0) for i in range(200)]
    for balls in (few, few + far_away):
        world = world_of(*balls)
        assert seen(world, [18, 0, 0], [-1, 0, 0]) == (4, False)
        assert not lit(world, [18, 0, 0], [30, 0, 0])
        assert lit(world, [18, 0, 0], [18.5, 0, 0])
