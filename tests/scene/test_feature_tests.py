"""Feature tests of scenes, against rays."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies

import spheretrace_jax as st
from spheretrace_jax.scene.feature_tests import (
    any_colored,
    eye_inside,
    objects_cross,
    unshadowed_lights,
)


def scene_of(center, radius, lights) -> st.Scene:
    return st.Scene(st.Spheres(center, radius), st.Lights(lights))


@settings(max_examples=200, deadline=None)
@given(strategies.integers(0, 2**32 - 1))
def test_no_ray_to_a_light_that_nothing_can_block_is_blocked(seed):
    rng = np.random.default_rng(seed)
    n = rng.integers(2, 5)
    center, radius = rng.uniform(-1, 1, (n, 3)), rng.uniform(0.02, 0.3, n)
    light = rng.uniform(-1, 1, 3) * 10 ** rng.uniform(0, 3)
    free = unshadowed_lights(scene_of(center, radius, light[None])) == (0,)
    # points all over each sphere that the light shines on, and the spheres in their way
    normal = rng.standard_normal((400, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    point = center[:, None] + radius[:, None, None] * normal
    way = light - point
    shone = np.sum(normal * way, axis=-1) > 0
    to_center = center - point[:, :, None]  # (sphere, point, other sphere, 3)
    share = np.sum(to_center * way[:, :, None], axis=-1) / np.sum(way**2, axis=-1)[..., None]
    nearest = np.linalg.norm(to_center - np.clip(share, 0, 1)[..., None] * way[:, :, None], axis=-1)
    blocked = nearest < radius
    blocked[np.arange(n), :, np.arange(n)] = False
    assert not (free and (blocked & shone[..., None]).any())


@pytest.mark.parametrize(
    ("other", "radius", "expected"),
    [
        ([5.0, 0, 0], 1.0, (0,)),  # beside the first, seen from the light
        ([0.5, 0, -5], 1.0, ()),  # behind it
        ([2.1, 0, -1], 1.0, (0,)),
        ([1.9, 0, -1], 1.0, ()),
        ([0.0, 0, 50], 8.0, ()),  # the light is near the second
        ([0.0, 0, 100], 1.0, ()),  # the light is in it
    ],
)
def test_what_lies_behind_another_sphere_may_be_in_its_shadow(other, radius, expected):
    assert (
        unshadowed_lights(scene_of([[0.0, 0, 0], other], [1.0, radius], [[0.0, 0, 100]]))
        == expected
    )


def test_planes_and_very_many_spheres_are_taken_to_be_in_shadow():
    apart = [[5.0 * k, 0, 0] for k in range(100)]
    assert unshadowed_lights(scene_of(apart[:9], [1.0] * 9, [[0.0, 0, 1e6]])) == (0,)
    assert unshadowed_lights(scene_of(apart, [1.0] * 100, [[0.0, 0, 1e6]])) == ()
    floor = eqx.tree_at(
        lambda s: s.planes,
        scene_of(apart[:2], [1.0] * 2, [[0.0, 0, 1e6]]),
        st.Planes([[0.0, 0, -9]], [[0.0, 0, 1]], (0.5, 0.5, 0.5)),
    )
    assert unshadowed_lights(floor) == ()


def test_spheres_that_touch_cross_and_colours_differ_by_any_channel():
    assert objects_cross(scene_of([[0.0, 0, 0], [2, 0, 0]], [1.0, 1], np.zeros((0, 3))))
    assert not objects_cross(scene_of([[0.0, 0, 0], [2.1, 0, 0]], [1.0, 1], np.zeros((0, 3))))
    assert not any_colored(jnp.ones((3, 3)), jnp.zeros(3)) and any_colored(
        jnp.ones(3), jnp.array([0, 0, 1])
    )


@pytest.mark.parametrize(
    ("camera", "inside"),
    [
        (dict(mu=5.0), False),
        (dict(mu=5.0, look_at=[0.0, 0, -4.5]), True),
        (dict(mu=0.5, look_at=[9.0, 0, 0]), False),
        # the plane where parallel rays start cuts the sphere, though the eye is far away
        (dict(mu=0.5, look_at=[9.0, 0, 0], orthographic=True), True),
        (dict(mu=1.5, look_at=[9.0, 0, 0], orthographic=True), False),
    ],
)
def test_the_eye_in_a_sphere(camera, inside):
    scene = scene_of([[0.0, 0, 0]], [1.0], np.zeros((0, 3)))
    scene = eqx.tree_at(lambda s: s.camera, scene, st.Camera(**camera))
    assert eye_inside(scene) == st.needs(scene).inside == inside
