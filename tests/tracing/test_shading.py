"""The lecture's shading: Lambert's cosine, Phong's and Blinn's highlights."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spheretrace_jax.base.vec import SplitVec, Vec, dot, norm, reflect, unit, vec
from spheretrace_jax.scene.light import Light
from spheretrace_jax.tracing.fresnel import coat_transmission
from spheretrace_jax.tracing.hit import Surface
from spheretrace_jax.tracing.shading import Finish, blinn, lambert, light_terms, phong, power


def at_angle(degrees: float) -> Vec:
    """Returns the unit vector in the x-z plane at an angle from z."""
    angle = np.deg2rad(degrees)
    return vec(jnp.array([np.sin(angle), 0, np.cos(angle)]))


def viewed_from(viewer: Vec) -> Surface:
    normal = at_angle(0)
    return Surface(vec(jnp.zeros(3)), normal, dot(normal, viewer))


@pytest.mark.parametrize("light", [0, 30, 89, 120])
def test_lambert_is_the_cosine(light):
    cosine = lambert(viewed_from(at_angle(0)), at_angle(light))
    np.testing.assert_allclose(cosine, np.cos(np.deg2rad(light)), atol=1e-15)


@pytest.mark.parametrize(("light", "viewer"), [(30, -30), (30, 0), (80, 10), (10, 75)])
def test_phong_and_blinn_are_cosines(light, viewer):
    L, V = at_angle(light), at_angle(viewer)
    surface = viewed_from(V)
    R = reflect(-L, surface.normal)
    np.testing.assert_allclose(phong(surface, L, -V), dot(R, V), atol=1e-15)
    np.testing.assert_allclose(blinn(surface, L, -V), dot(unit(L + V), surface.normal), atol=1e-15)
    np.testing.assert_allclose(
        phong(surface, L, -V), np.cos(np.deg2rad(light + viewer)), atol=1e-15
    )


def test_halfway_vector_of_opposite_vectors():
    L = at_angle(90)
    value = lambda x: blinn(viewed_from(-L), SplitVec(x, L.y, L.z), L)
    assert value(L.x) == 0
    assert np.isfinite(jax.grad(value)(L.x))


@pytest.mark.parametrize(
    ("cosine", "exponent", "value"),
    [(0.5, 3.0, 0.125), (1.0, 1e6, 1.0), (0.0, 0.0, 1.0), (-0.5, 0.0, 1.0), (0.0, 2.0, 0.0),
     (-1.0, 3.0, 0.0), (0.3, 0.0, 1.0)],
)  # fmt: skip
def test_power_of_the_positive_part(cosine, exponent, value):
    arguments = jnp.array(cosine), jnp.array(exponent)
    np.testing.assert_allclose(power(*arguments), value, rtol=1e-14)
    assert np.isfinite(jax.grad(power, (0, 1))(*arguments)).all()


@pytest.mark.parametrize("exponent", [0.0, 5.0])
@pytest.mark.parametrize(("degrees", "lit"), [(100, True), (30, False)])
@pytest.mark.parametrize("directional", [False, True])
def test_unlit_points_get_no_light(exponent, degrees, lit, directional):
    surface = viewed_from(at_angle(0))
    away = Light(at_angle(degrees) * 1000, None, directional)
    for ior in (None, jnp.array(1.5)):
        finish = Finish(jnp.array(exponent), ior)
        terms = light_terms(surface, -at_angle(0), away, finish, jnp.array(lit), "phong")
        assert terms == (0, 0)


@pytest.mark.parametrize(("light", "viewer"), [(30, -50), (0, 0), (80, 10)])
def test_a_coat_dims_the_diffuse_term_only(light, viewer):
    L, V = at_angle(light), at_angle(viewer)
    surface, n, lit = viewed_from(V), jnp.array(5.0), jnp.array(True)
    arguments = surface, -V, Light(L * 1000, None, directional=False)
    (bare, shine), (coated, same) = (
        light_terms(*arguments, Finish(n, ior), lit, "phong") for ior in (None, jnp.array(1.5))
    )
    through = coat_transmission(lambert(surface, L), surface.cos_view, jnp.array(1.5))
    np.testing.assert_allclose(coated, bare * through, rtol=1e-12)
    assert shine == same and 0 < coated < bare


def test_light_on_the_surface_point():
    surface = viewed_from(at_angle(0))
    light = Light(surface.point, jnp.array(3.0), directional=False)
    finish = Finish(jnp.array(5.0), jnp.array(1.5))
    arguments = surface, -at_angle(0), light, finish, jnp.array(True)
    assert np.isfinite(light_terms(*arguments, "blinn")).all()
    assert norm(surface.point) == 0
