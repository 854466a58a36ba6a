"""The registry of parameters: complete, and each entry leads to its array."""

import dataclasses

import jax
import numpy as np
import pytest
from helpers.scenes import SCENES

import spheretrace_jax as st
from spheretrace_jax.scene.parameters import PARAMETERS, parameter_names

OWNERS = {"spheres": st.Spheres, "lights": st.Lights, "planes": st.Planes, "camera": st.Camera}


@pytest.mark.parametrize("owner", OWNERS)
def test_every_array_is_registered(owner):
    arrays = {field.name for field in dataclasses.fields(OWNERS[owner])} - {"pic", "directional"}
    registered = [p.attribute or p.name for p in PARAMETERS if p.owner == owner]
    twice = {"position"} & arrays  # those of lights at points, and directions
    assert len(registered) == len(arrays) + len(twice) and set(registered) == arrays


def test_values_are_leaves_of_the_scene():
    scene = SCENES["planes"]
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
            assert inside[p.range](np.asarray(p.value(scene))).all(), p


def test_names():
    assert parameter_names("ks") == {"ks"}
    assert parameter_names(["ks", "light_position", "background"]) >= {"background"}
    with pytest.raises(st.InputError, match="parameters of the scene, got exposure, light"):
        parameter_names(("light", "exposure", "ks"))
