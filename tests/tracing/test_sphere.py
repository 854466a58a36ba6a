"""The sphere: roots of its quadratic equation, and the mean surface under a pixel."""

import jax.numpy as jnp
import numpy as np
import pytest

from spheretrace_jax.base.vec import SplitVec, dot, vec
from spheretrace_jax.tracing.shapes.sphere import Sphere, ray_sphere


def roots(origin, direction, center, radius):
    arrays = (jnp.asarray(x, float) for x in (origin, direction, center))
    near, far = ray_sphere(*(vec(a) for a in arrays), jnp.asarray(radius, float))
    return float(near), float(far)


@pytest.mark.parametrize(
    ("height", "expected"),
    [(0.0, (4.0, 6.0)), (0.6, (4.2, 5.8)), (1.0, (5.0, 5.0)), (1.5, (np.nan, np.nan))],
    ids=["two roots", "two roots off the middle", "one root: tangent", "none"],
)
def test_three_cases_of_the_discriminant(height, expected):
    np.testing.assert_allclose(
        roots([0, height, 5], [0, 0, -1], [0, 0, 0], 1), expected, rtol=1e-15
    )


def test_near_root_is_behind_from_inside():
    near, far = roots([0, 0, 0.5], [0, 0, 1], [0, 0, 0], 1)
    assert (near, far) == (-1.5, 0.5)


def test_roots_are_negative_behind():
    near, far = roots([0, 0, 5], [0, 0, 1], [0, 0, 0], 1)
    assert near < far < 0


def test_mean_normal_is_at_most_1():
    # from the middle to outside of the sphere, pixels from narrow to wider than the sphere
    q, reach = np.meshgrid(np.linspace(0, 3, 200), np.geomspace(1e-4, 10, 200))
    zero = jnp.zeros(q.shape)
    sphere = Sphere(SplitVec(zero, zero, zero), 1 + zero)
    half_chord, mean = sphere.mean_chord(SplitVec(jnp.asarray(q), zero, zero), jnp.asarray(reach))
    assert np.sqrt(half_chord**2 + dot(mean, mean)).max() <= 1 + 1e-15
