"""Degenerate scenes: pictures and gradients stay finite."""

import dataclasses
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.antialiasing import FLOOR, TINY, ambient_spheres

import spheretrace_jax as st


def degenerate(center, radius, light=(300.0, 350, 400)) -> st.Scene:
    scene = ambient_spheres(center, radius, ka=0.2, kd=0.6, ks=0.3, exponent=9.0, kgr=0.2)
    return eqx.tree_at(lambda s: s.lights.position, scene, jnp.array([light], float))


# the middle pixel of a picture of 9 x 9 looks along the z axis from (0, 0, 500)
DEGENERATE = {
    "the middle of a sphere": degenerate([[0, 0, 0], [90, 0, 0]], 50.0),
    "a tangent ray": degenerate([[50, 0, 0], [0, 50, -50]], 50.0),
    "coincident spheres": degenerate([[10, 5, 0], [10, 5, 0]], 50.0),
    "concentric spheres": degenerate([[10, 5, 0], [10, 5, 0]], [50.0, 40]),
    "a light inside a sphere": degenerate([[0, 0, 0], [90, 0, 0]], 50.0, (10, 0, 20)),
    "a light at a sphere's centre": degenerate([[0, 0, 0], [90, 0, 0]], 50.0, (0, 0, 0)),
    "a light on a sphere": degenerate([[0, 0, 0], [90, 0, 0]], 50.0, (0, 0, 50)),
    "a light at the eye": degenerate([[0, 0, 0], [90, 0, 0]], 50.0, (0, 0, 500)),
    "a light in the plane of contact": degenerate([[50, 0, 0], [-50, 0, 0]], 50.0, (0, 300, 0)),
    "the eye inside a sphere": degenerate([[0, 0, 0], [90, 0, 0]], [600.0, 50]),
    "the eye on a sphere": degenerate([[0, 0, 0], [90, 0, 0]], [500.0, 50]),
    "the eye at a sphere's centre": degenerate([[0, 0, 500], [90, 0, 0]], 50.0),
    "huge and tiny spheres": degenerate([[0, 0, -1e6 - 50], [0, 0, 0]], [1e6, 1e-3]),
}

LEAN = dataclasses.replace(FLOOR, inside=True, planes=False, reflection=False, background=False)


@cache
def value_and_gradient(dtype, bounces: int):
    needs = dataclasses.replace(LEAN, reflection=bounces > 0)
    draw = lambda s: jnp.mean(st.render(s, **(TINY | dict(bounces=bounces)), needs=needs))
    return jax.jit(jax.value_and_grad(draw))


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("bounces", [0, 1])
@pytest.mark.parametrize("name", DEGENERATE)
def test_degenerate_scenes_are_finite(name, dtype, bounces):
    value, gradient = value_and_gradient(dtype, bounces)(DEGENERATE[name].astype(dtype))
    assert np.isfinite(value) and value > 0
    not_finite = [
        jax.tree_util.keystr(path)
        for path, leaf in jax.tree_util.tree_leaves_with_path(gradient)
        if not np.isfinite(leaf).all()
    ]
    assert not not_finite
