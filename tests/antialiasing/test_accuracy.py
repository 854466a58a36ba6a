"""Antialiased pictures and derivatives against references: many rays per pixel, and differences."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.antialiasing import FLOOR, SIZE, SMALL, ambient_spheres, supersampled, with_window
from helpers.derivatives import PARAMETERS, blurred, derivative, difference, off
from helpers.scenes import FLAT, SCENES, WHITE, nine_spheres, three_spheres

import spheretrace_jax as st
from spheretrace_jax.tracing.plain import plain_picture


def test_picture_error():
    scene = three_spheres()
    truth = np.asarray(st.render(scene, samples=64, **SIZE))
    point = off(st.render(scene, **SIZE), truth)
    one = off(st.render(scene.with_antialias(1), **SIZE), truth)
    assert one < 0.01
    assert one < point / 10


@pytest.mark.slow
@pytest.mark.parametrize("name", ["coated", "coated_aside"])
def test_picture_error_of_coats(name):
    # lit from the eye's side, and from behind, where the rim is most of what is lit
    scene = SCENES["coated"]
    if name == "coated_aside":
        scene = eqx.tree_at(lambda s: s.lights.position, scene, jnp.array([[900.0, -200, 40]]))
    size = dict(width=32, height=32, bounces=0)
    truth = np.asarray(plain_picture(scene, 32, 32, bounces=0, samples=24))
    point = off(st.render(scene, **size), truth)
    one = off(st.render(scene.with_antialias(1), **size), truth)
    assert one < 0.02
    assert one < point / 5


@pytest.mark.slow
def test_error_falls_with_samples():
    scene = three_spheres()
    truth = np.asarray(st.render(scene, samples=64, **SIZE))
    one, two = (off(st.render(scene.with_antialias(1), samples=k, **SIZE), truth) for k in (1, 2))
    assert two < one / 3


@cache
def derivatives():
    scene = three_spheres()
    return derivative(scene.with_antialias(1), **SIZE), derivative(scene, **SIZE)


@pytest.mark.slow
@pytest.mark.parametrize("name", PARAMETERS)
def test_derivative_error(name):
    smooth, hard = (by(name) for by in derivatives())
    truth = difference(three_spheres(), name, 5 * PARAMETERS[name][2], samples=48, **SIZE)
    weight = blurred(truth, 2.0)
    total = lambda picture: np.vdot(weight, picture) / np.vdot(weight, truth)
    assert abs(total(smooth) - 1) < 0.03
    assert off(smooth, truth) < 0.2
    # the derivative of single rays does not see edges
    assert abs(total(hard) - 1) > 0.3
    assert off(hard, truth) > 0.9


@pytest.mark.slow
def test_forward_reverse_and_differences():
    scene = ambient_spheres([[-8.0, 0, 0], [9, 4, 3]], [10.0, 9.0], ka=[0.4, 0.8])
    table = st.check_gradients(with_window(scene, 60.0), needs=FLAT, width=12, height=12, bounces=0)
    for row in table.rows:
        assert row.forward < 2e-2, row  # smaller bends do not count as kinks there
        assert row.reverse < 1e-13, row
        # a layer starts to count, without a jump, where it touches the pixel: few pixels
        assert row.left_out <= 4, row
    moving = {row.parameter for row in table.rows if row.largest > 0}
    assert {"spheres.center", "spheres.radius", "camera.phi", "camera.distance"} <= moving


@pytest.mark.slow
def test_gradient_is_traced():
    # tracing finds what JAX cannot transpose; compiling as well would take half a minute
    scene = three_spheres(antialias=1)
    needs = st.needs(scene, free=("center", "radius", "light_position"))
    gradient = jax.grad(lambda s: st.render(s, needs=needs, **SIZE).sum())
    assert jax.tree.structure(jax.eval_shape(gradient, scene)) == jax.tree.structure(scene)


@pytest.mark.slow
def test_highlights_in_mirrors():
    # each of nine spheres mirrors the others, whose highlights are smaller than a pixel there
    scene, settings = nine_spheres((100.0, 500, 800)), dict(width=64, height=64, bounces=1)
    truth = supersampled(scene, 32, **settings)
    smooth = st.render(scene.with_antialias(1), **settings)
    assert off(smooth, truth) < off(st.render(scene, **settings), truth) / 4
    assert np.abs(smooth - truth).max() < 0.15


def over_floor(center, radius, kgr=0.0) -> st.Scene:
    """Makes three spheres over a floor under a blue sky, seen from not far above."""
    spheres = st.Spheres(np.asarray(center, float), radius, (0.9, 0.5, 0.2), ks=0.2, kgr=kgr)
    floor = st.Planes([[0.0, 0, -60]], [[0.0, 0, 1]], (0.8, 0.8, 0.7))
    camera = st.Camera(0.2, 1.45, 400.0, 500.0)
    return st.Scene(
        spheres, st.Lights(WHITE), camera, floor, background=(0.2, 0.3, 0.6), antialias=1
    )


FLOORS = {
    "horizon": over_floor([[0, 0, -200], [0, 10, -200], [9, 0, -200]], 20.0),
    "shadow": over_floor([[150, 170, 190], [0, 10, -200], [9, 0, -200]], 50.0),
    "mirror": over_floor([[0, 0, 0], [40, 110, -20], [60, -90, -10]], [55.0, 30, 40], [0.9, 0, 0]),
}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "better"), [("horizon", 20), ("shadow", 20), ("mirror", 4)])
def test_error_of_floors_and_mirrors(name, better):
    scene = FLOORS[name]
    truth = supersampled(scene, 48, needs=FLOOR, **SMALL)
    point = off(supersampled(scene, 1, needs=FLOOR, **SMALL), truth)
    assert off(st.render(scene, needs=FLOOR, **SMALL), truth) < point / better
