"""Summaries of scenes: short, and of what the scene holds."""

import equinox as eqx
import jax
import numpy as np
import pytest
from helpers.scenes import SCENES, nine_spheres

import spheretrace_jax as st


def test_lines_of_nine_spheres():
    assert str(nine_spheres()).splitlines() == [
        "9 spheres, 1 light, 0 planes, 0 textures, float64, antialias 0",
        "camera: theta -0.01, phi 0.01, mu 500, distance 800, window 512",
        "light 1: at 100 900 300, color 1 1 1",
        "spheres: radius 40, ka 0.2, kd 0.1 to 0.9, ks 0 to 0.8, exponent 4 to 36, kgr 0"
        " to 0.8, kt 0",
    ]


def test_coats_are_named():
    assert str(SCENES["coated"]).endswith("kt 0, ior 1 to 1.5")


@pytest.mark.parametrize("name", SCENES)
def test_at_most_ten_lines(name):
    assert 3 <= len(str(SCENES[name]).splitlines()) <= 10
    assert str(SCENES[name]) != repr(SCENES[name])


def test_no_objects_and_many_lights():
    empty = st.Scene(st.Spheres(np.zeros((0, 3)), []), st.Lights(np.zeros((0, 3))))
    assert str(empty).startswith("0 spheres, 0 lights, 0 planes")
    lights = st.Lights(np.ones((40, 3)))
    many = st.Scene(st.Spheres([[0.0, 0, 0]], [2.0]), lights)
    assert "and 36 more lights" in str(many) and len(str(many).splitlines()) <= 10


def test_under_a_trace():
    said = []
    jax.jit(lambda scene: said.append(str(scene)) or 0)(SCENES["diffuse"])
    assert said == ["3 spheres, 1 light, 0 planes, 0 textures, float64: its numbers are traced"]


def test_what_is_set_of_a_camera_is_said():
    camera = st.Camera(roll=0.5, look_at=[1, 2, 3.5], pixel_aspect=1.25, orthographic=True)
    scene = eqx.tree_at(lambda s: s.camera, nine_spheres(), camera)
    assert str(scene).splitlines()[1] == (
        "camera: theta 0, phi 0, mu 500, distance 800, window 512, roll 0.5, look_at 1 2 3.5, "
        "pixel_aspect 1.25, orthographic"
    )
