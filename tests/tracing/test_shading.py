import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spheretrace_jax.base.vec import Vec, dot, norm, reflect, unit, vec
from spheretrace_jax.tracing.shading import blinn, lambert, light_terms, phong, power
from spheretrace_jax.tracing.tables import Surface


def at_angle(degrees: float) -> Vec:
    """A unit vector in the x-z plane, so far from z."""
    angle = np.deg2rad(degrees)
    return vec(jnp.array([np.sin(angle), 0, np.cos(angle)]))


def seen_from(viewer: Vec) -> Surface:
    normal = at_angle(0)
    return Surface(vec(jnp.zeros(3)), normal, dot(normal, viewer))


@pytest.mark.parametrize("light", [0, 30, 89, 120])
def test_lambert_is_the_cosine(light):
    cosine = lambert(seen_from(at_angle(0)), at_angle(light))
    np.testing.assert_allclose(cosine, np.cos(np.deg2rad(light)), atol=1e-15)


@pytest.mark.parametrize(("light", "viewer"), [(30, -30), (30, 0), (80, 10), (10, 75)])
def test_phong_is_the_angle_to_the_mirrored_light_and_blinn_to_the_halfway_vector(light, viewer):
    L, V = at_angle(light), at_angle(viewer)
    surface = seen_from(V)
    R = reflect(-L, surface.normal)
    np.testing.assert_allclose(phong(surface, L, -V), dot(R, V), atol=1e-15)
    np.testing.assert_allclose(blinn(surface, L, -V), dot(unit(L + V), surface.normal), atol=1e-15)
    np.testing.assert_allclose(
        phong(surface, L, -V), np.cos(np.deg2rad(light + viewer)), atol=1e-15
    )


def test_the_halfway_vector_of_opposite_vectors_gives_no_highlight_and_no_nan():
    L = at_angle(90)
    value = lambda x: blinn(seen_from(-L), Vec(x, L.y, L.z), L)
    assert value(L.x) == 0
    assert np.isfinite(jax.grad(value)(L.x))


@pytest.mark.parametrize(
    ("cosine", "exponent", "value"),
    [(0.5, 3.0, 0.125), (1.0, 1e6, 1.0), (0.0, 0.0, 1.0), (-0.5, 0.0, 1.0), (0.0, 2.0, 0.0),
     (-1.0, 3.0, 0.0), (0.3, 0.0, 1.0)],
)  # fmt: skip
def test_power_is_that_of_the_positive_part_and_0_to_the_0_is_1(cosine, exponent, value):
    arguments = jnp.array(cosine), jnp.array(exponent)
    np.testing.assert_allclose(power(*arguments), value, rtol=1e-14)
    assert np.isfinite(jax.grad(power, (0, 1))(*arguments)).all()


@pytest.mark.parametrize("exponent", [0.0, 5.0])
@pytest.mark.parametrize(("degrees", "lit"), [(100, True), (30, False)])
def test_unlit_points_get_nothing_from_a_light(exponent, degrees, lit):
    surface = seen_from(at_angle(0))
    away = at_angle(degrees) * 1000
    terms = light_terms(surface, -at_angle(0), away, jnp.array(exponent), jnp.array(lit), "phong")
    assert terms == (0, 0)


def test_the_light_on_the_surface_point_gives_finite_terms():
    surface = seen_from(at_angle(0))
    arguments = surface, -at_angle(0), surface.point, jnp.array(5.0), jnp.array(True)
    assert np.isfinite(light_terms(*arguments, "blinn")).all()
    assert norm(surface.point) == 0
