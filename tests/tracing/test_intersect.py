import jax.numpy as jnp
import numpy as np
import pytest

from spheretrace_jax.base.vec import vec
from spheretrace_jax.tracing.intersect import ray_plane, ray_sphere


def meet(origin, direction, center, radius):
    arrays = (jnp.asarray(x, float) for x in (origin, direction, center))
    near, far = ray_sphere(*(vec(a) for a in arrays), jnp.asarray(radius, float))
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


@pytest.mark.parametrize(("height", "t"), [(3.0, 3.0), (-3.0, -3.0)])
def test_planes_are_met_before_and_behind(height, t):
    origin, direction = vec(jnp.array([1.0, 2, height])), vec(jnp.array([0.0, 0, -1]))
    assert ray_plane(origin, direction, vec(jnp.zeros(3)), vec(jnp.array([0.0, 0, 2]))) == t


def test_a_ray_along_a_plane_does_not_meet_it():
    origin, direction = vec(jnp.array([0.0, 0, 1])), vec(jnp.array([1.0, 0, 0]))
    assert ray_plane(origin, direction, vec(jnp.zeros(3)), vec(jnp.array([0.0, 0, 1]))) == 0
