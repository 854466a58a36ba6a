import jax.numpy as jnp
import numpy as np
import pytest

from spheretrace_jax.intersect import ray_plane, ray_sphere
from spheretrace_jax.vec import vec


def meet(origin, direction, center, radius, dtype=np.float64):
    arrays = (jnp.asarray(x, dtype) for x in (origin, direction, center))
    near, far = ray_sphere(*(vec(a) for a in arrays), jnp.asarray(radius, dtype))
    return float(near), float(far)


@pytest.mark.parametrize(
    ("height", "roots"),
    [(0.0, (4.0, 6.0)), (0.6, (4.2, 5.8)), (1.0, (5.0, 5.0)), (1.5, (np.nan, np.nan))],
    ids=["two roots", "two roots off the middle", "one root: tangent", "none"],
)
def test_the_three_cases_of_the_discriminant(height, roots):
    np.testing.assert_allclose(meet([0, height, 5], [0, 0, -1], [0, 0, 0], 1), roots, rtol=1e-15)


def test_from_inside_the_near_root_is_behind():
    near, far = meet([0, 0, 0.5], [0, 0, 1], [0, 0, 0], 1)
    assert (near, far) == (-1.5, 0.5)


def test_spheres_behind_have_negative_roots():
    near, far = meet([0, 0, 5], [0, 0, 1], [0, 0, 0], 1)
    assert near < far < 0


@pytest.mark.parametrize("distance", [1e2, 2e3, 4.1e3, 8e3, 1e7])
def test_unit_sphere_far_away_is_hit_to_4_ulp_in_float32(distance):
    # Ray Tracing Gems, ch. 7: b^2 - 4ac misses these; at 1e7 the ray aims at the centre, since a
    # direction of float32 cannot aim at anything else there
    rng = np.random.default_rng(0)
    for _ in range(50):
        off = rng.uniform(-0.5, 0.5, 2) * (distance < 1e7)
        turn = np.linalg.qr(rng.standard_normal((3, 3)))[0] if distance < 1e7 else np.eye(3)
        center = (turn @ [0, 0, distance]).astype(np.float32)
        aim = turn @ [*off, distance]
        direction = (aim / np.linalg.norm(aim)).astype(np.float32)
        near, _ = meet([0, 0, 0], direction, center, 1, np.float32)
        c, d = center.astype(np.longdouble), direction.astype(np.longdouble)
        a, b = d @ d, d @ c
        true = (b - np.sqrt(b * b - a * (c @ c - 1))) / a
        assert abs(near - true) <= 4 * np.spacing(np.float32(distance))


@pytest.mark.parametrize(("height", "t"), [(3.0, 3.0), (-3.0, -3.0)])
def test_planes_are_met_before_and_behind(height, t):
    origin, direction = vec(jnp.array([1.0, 2, height])), vec(jnp.array([0.0, 0, -1]))
    assert ray_plane(origin, direction, vec(jnp.zeros(3)), vec(jnp.array([0.0, 0, 2]))) == t


def test_a_ray_along_a_plane_does_not_meet_it():
    origin, direction = vec(jnp.array([0.0, 0, 1])), vec(jnp.array([1.0, 0, 0]))
    assert ray_plane(origin, direction, vec(jnp.zeros(3)), vec(jnp.array([0.0, 0, 1]))) == 0
