"""Ray queries: the closest hit and the visibility of lights."""

import jax.numpy as jnp
import pytest

import spheretrace_jax as st
from spheretrace_jax.base.vec import vec
from spheretrace_jax.scene.camera import Ray
from spheretrace_jax.tracing.queries import closest_hit, light_visible
from spheretrace_jax.tracing.tables import Hit, build_tables


def tables_of(*balls, planes=None):
    """Builds the tables of spheres on the x axis, each as (x, radius)."""
    center = [[float(x), 0, 0] for x, _ in balls]
    spheres = st.Spheres(center, [float(r) for _, r in balls])
    return build_tables(st.Scene(spheres, st.Lights([[0.0, 0, 0]]), planes=planes))


def hit_by(tables, origin, direction, source_hit=None):
    ray = Ray(vec(jnp.array(origin, float)), vec(jnp.array(direction, float)))
    hit = closest_hit(tables, ray, st.Needs(), source_hit)
    return int(hit.id), bool(hit.inside)


def source(number, inside):
    return Hit(jnp.array(number), jnp.array(inside))


def lit(tables, point, light, number=-1, inside=False):
    arguments = vec(jnp.array(point, float)), source(number, inside), vec(jnp.array(light, float))
    return bool(light_visible(tables, *arguments, st.Needs()))


def test_nearest_of_two_in_any_order():
    assert hit_by(tables_of((0, 1), (5, 1)), [-9, 0, 0], [1, 0, 0]) == (0, False)
    assert hit_by(tables_of((5, 1), (0, 1)), [-9, 0, 0], [1, 0, 0]) == (1, False)


def test_nothing_is_hit_behind_the_eye():
    assert hit_by(tables_of((0, 1)), [9, 0, 0], [1, 0, 0]) == (-1, False)


def test_sphere_around_the_origin_is_hit_inside():
    assert hit_by(tables_of((0, 4)), [1, 0, 0], [1, 0, 0]) == (0, True)


def test_ray_skips_its_source_without_epsilon():
    tables = tables_of((0, 1), (5, 1))
    assert hit_by(tables, [1, 0, 0], [1, 0, 0], source(0, False)) == (1, False)
    assert hit_by(tables, [-1, 0, 0], [1, 0, 0], source(0, False)) == (1, False)  # straight through


def test_ray_inside_hits_its_source_again():
    assert hit_by(tables_of((0, 1)), [1, 0, 0], [-1, 0, 0], source(0, True)) == (0, True)


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
    assert lit(tables_of((0, 1)), point, light) is expected


@pytest.mark.parametrize("unit", [1e-12, 1e-6, 1.0, 1e6, 1e12])
def test_shadows_in_any_unit_of_length(unit):
    center = jnp.asarray([[0.0, 0, 0], [300, 0, 0]]) * unit
    spheres = st.Spheres(center.astype(jnp.float32), jnp.full(2, 100 * unit, jnp.float32))
    tables = build_tables(st.Scene(spheres, st.Lights([[0.0, 0, 0]])))
    light = vec(jnp.asarray([1e6 * unit, 0, 0], jnp.float32))
    for height, expected in ((99.0, False), (101.0, True)):
        point = vec(jnp.asarray([-200 * unit, height * unit, 0], jnp.float32))
        visible = light_visible(tables, point, source(-1, False), light, st.Needs(planes=False))
        assert bool(visible) is expected


def test_wall_of_a_room_blocks_outer_lights():
    room = tables_of((0, 10))
    assert lit(room, [10, 0, 0], [3, 0, 0], 0, True)
    assert not lit(room, [10, 0, 0], [-30, 0, 0], 0, True)


def test_shadow_of_a_plane():
    planes = st.Planes([[0.0, 0, 0]], [[0.0, 0, 1]])
    tables = tables_of((50, 1), planes=planes)
    assert not lit(tables, [0, 0, -1], [0, 0, 5])
    assert lit(tables, [0, 0, 1], [0, 0, 5])
    assert lit(tables, [0, 0, 0], [0, 0, 5], number=1)


def test_many_spheres_agree_with_few():
    few = [(4.0 * i, 1.0) for i in range(9)]
    far_away = [(1e4 + 4.0 * i, 1.0) for i in range(200)]
    for balls in (few, few + far_away):
        tables = tables_of(*balls)
        assert hit_by(tables, [18, 0, 0], [-1, 0, 0]) == (4, False)
        assert not lit(tables, [18, 0, 0], [30, 0, 0])
        assert lit(tables, [18, 0, 0], [18.5, 0, 0])
