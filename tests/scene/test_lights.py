"""Lights: their constructor, one light as shading asks for it, and what is known of shadows."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import SCENES

import spheretrace_jax as st
from spheretrace_jax.base.vec import vec
from spheretrace_jax.scene.light import each_light, make_light, map_lights
from spheretrace_jax.scene.parameters import light_places

PLACES = [[0.0, 0, 9], [1, 2, 3], [4, 0, 0]]


def test_one_value_holds_for_all():
    lights = st.Lights(PLACES, directional=True)
    assert lights.directional == (True,) * 3 and not lights.falloff.any()
    lights = st.Lights(PLACES, falloff=5)
    assert lights.directional == (False,) * 3 and (lights.falloff == 5).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            dict(directional=(True,)),
            "directional must be True or False for each of 3 lights, got 1",
        ),
        (dict(directional=(1, 0, 0)), "directional must be True or False, got 1"),
        (dict(falloff=(0, -1, 0)), "light 2: the fall-off must be at least 0, got -1"),
        (dict(directional=True, falloff=2), "light 1 is directional: it has no fall-off, got 2"),
        (dict(falloff=(1, 2)), r"falloff must be an array of shape \(3,\)"),
    ],
)
def test_wrong_arguments_are_named(arguments, message):
    with pytest.raises(st.InputError, match=message):
        st.Lights(PLACES, **arguments)


def test_a_direction_must_not_be_zero():
    with pytest.raises(st.InputError, match="its direction must not be 0 0 0"):
        st.Lights([[0.0, 0, 0]], directional=True)


def test_a_scene_checks_the_kinds():
    scene = SCENES["shadows"]
    moved = eqx.tree_at(lambda s: s.lights.position, scene, jnp.ones((2, 3)))
    moved = eqx.tree_at(
        lambda s: (s.lights.color, s.lights.falloff), moved, (moved.lights.position, jnp.zeros(2))
    )
    with pytest.raises(st.InputError, match="directional"):
        st.render(moved, width=4, height=4)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("length", [1e-30, 1.0, 1e30])
def test_a_direction_has_any_length(dtype, length):
    light = make_light(jnp.asarray([3 * length, 0, 4 * length], dtype), None, directional=True)
    point = vec(jnp.asarray([1e3, 2e3, -5e3], dtype))
    found = [float(x) for x in (light.direction(point).x, light.direction(point).z)]
    np.testing.assert_allclose(found, [0.6, 0.8], rtol=2e-7)
    assert (
        light.distance(point) == np.inf and light.scaled(jnp.asarray(8, dtype)).place == light.place
    )


def test_derivatives_by_a_direction_are_across_it():
    at = lambda position: jnp.stack(jax.tree.leaves(make_light(position, None, True)))
    jacobian = jax.jacobian(at)(jnp.array([0.0, 0, 2]))
    np.testing.assert_allclose(jacobian, np.diag([0.5, 0.5, 0]), atol=1e-15)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_inverse_square_law(dtype):
    light = make_light(jnp.zeros(3, dtype), jnp.asarray(6, dtype), directional=False)
    for distance, part in ((6, 1), (3, 4), (12, 0.25), (1e18, 0), (0, 36)):
        point = vec(jnp.asarray([distance, 0, 0], dtype))
        faded = light.faded(point, jnp.ones((), dtype))
        np.testing.assert_allclose(faded, part, rtol=1e-6, atol=1e-30)
    # where the square overflows, what is dark stays dark
    near = vec(jnp.asarray([1e-18, 0, 0], dtype))
    bright = make_light(jnp.zeros(3, dtype), jnp.asarray(1e18, dtype), directional=False)
    assert bright.faded(near, jnp.zeros((), dtype)) == 0
    none = make_light(jnp.zeros(3, dtype), jnp.zeros((), dtype), directional=False)
    assert none.faded(near, jnp.full((), 0.3, dtype)) == np.asarray(0.3, dtype)


def test_a_map_over_both_kinds_keeps_the_order():
    lights = st.Lights(PLACES, directional=(False, True, False), falloff=(1, 0, 3))
    found = map_lights(
        lambda place, falloff, far: jnp.stack([place[0], falloff, 1.0 * far]), lights
    )
    np.testing.assert_array_equal(found, [[0, 1, 0], [1, 0, 1], [4, 3, 0]])
    assert [light.directional for light in each_light(lights, False)] == [False, True, False]


def test_needs_know_what_fades_and_what_moves():
    scene = SCENES["shadows"]
    fades = eqx.tree_at(lambda s: s.lights.falloff, scene, jnp.ones(1))
    assert not st.needs(scene).falloff and st.needs(fades).falloff
    assert st.needs(scene, free=("light_falloff",)).falloff
    far = with_lights(scene, st.Lights(PLACES, directional=True))
    assert not st.needs(far, free=("light_falloff",)).falloff


def with_lights(scene, lights):
    return eqx.tree_at(lambda s: s.lights, scene, lights)


def test_lights_that_nothing_can_block():
    spheres = st.Spheres([[0.0, 0, 0], [10, 0, 0]], [1.0, 2.0])
    camera = st.Camera(mu=100.0)
    directions = [[0.0, 0, 1], [1, 0, 0], [-5, 0, 0], [0.29, 0, 1], [1, 0.4, 0]]
    scene = st.Scene(spheres, st.Lights(directions, directional=True), camera)
    # a cylinder of radius 3 along the way from one to the other
    assert st.needs(scene).clear == (0, 3, 4)
    all_clear = st.Scene(spheres, st.Lights([[0.0, 0, 1]], directional=True), camera)
    assert not st.needs(all_clear).shadows


def test_the_summary_says_what_a_light_is():
    lights = st.Lights(PLACES, directional=(False, True, False), falloff=(0, 0, 7))
    lines = str(with_lights(SCENES["shadows"], lights)).splitlines()
    assert lines[2] == "light 1: at 0 0 9, color 1 1 1"
    assert lines[3] == "light 2: toward 1 2 3, color 1 1 1"
    assert lines[4] == "light 3: at 4 0 0, color 1 1 1 at a distance of 7"


def test_places_of_lights_are_named_by_their_kinds():
    named = lambda **kinds: light_places(with_lights(SCENES["shadows"], st.Lights(PLACES, **kinds)))
    assert named() == ("light_position",) and named(directional=True) == ("light_direction",)
    both = named(directional=(True, False, False))
    assert both == ("light_position", "light_direction")
