"""The registry of parameters: complete, and each entry leads to its array."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
import pytest
from helpers.scenes import SCENES

import spheretrace_jax as st
from spheretrace_jax.scene.camera import DEFAULTS
from spheretrace_jax.scene.parameters import PARAMETERS, parameter_names, with_optional

OWNERS = {"spheres": st.Spheres, "lights": st.Lights, "planes": st.Planes, "camera": st.Camera}


@pytest.mark.parametrize("owner", OWNERS)
def test_every_array_is_registered(owner):
    arrays = {field.name for field in dataclasses.fields(OWNERS[owner])}
    arrays -= {"pic", "directional", "orthographic"}
    registered = [p.attribute or p.name for p in PARAMETERS if p.owner == owner]
    twice = {"position"} & arrays  # those of lights at points, and directions
    assert len(registered) == len(arrays) + len(twice) and set(registered) == arrays


def test_values_are_leaves_of_the_scene():
    scene = with_optional(SCENES["planes"], DEFAULTS)
    leaves = [id(leaf) for leaf in jax.tree.leaves(scene)]
    values = [id(p.value(scene)) for p in PARAMETERS]
    assert set(values) <= set(leaves) and len(set(values)) == len(values) - 1  # lights' places


def test_values_lie_in_their_range():
    inside = {
        "unit": lambda x: (x >= 0) & (x <= 1),
        "positive": lambda x: x > 0,
        "nonnegative": lambda x: x >= 0,
        "refraction": lambda x: x >= 1,
        "any": np.isfinite,
    }
    for scene in SCENES.values():
        for p in PARAMETERS:
            if (value := p.value(scene)) is not None:
                assert inside[p.range](np.asarray(value)).all(), p


def test_optional_numbers():
    scene = SCENES["planes"].astype(np.float32)
    assert with_optional(scene, ("kd", "theta")) is scene
    rolled = with_optional(scene, ("roll", "kd"))
    assert rolled.camera.roll == 0 and rolled.camera.roll.dtype == np.float32
    assert rolled.camera.look_at is None
    looking = eqx.tree_at(lambda s: s.camera, scene, st.Camera(look_at=[1.0, 2, 3], phi=0.5))
    assert with_optional(looking, ("look_at",)).camera.look_at.tolist() == [1, 2, 3]


def test_names():
    assert parameter_names("ks") == {"ks"}
    assert parameter_names(["ks", "light_position", "background"]) >= {"background"}
    with pytest.raises(st.InputError, match="parameters of the scene, got exposure, light"):
        parameter_names(("light", "exposure", "ks"))
