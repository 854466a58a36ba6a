"""Scenes and settings of the tests of antialiasing: few and shared, as compiling takes the time."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from helpers.scenes import FLAT

import spheretrace_jax as st

SIZE = dict(width=48, height=48, bounces=0)
TINY = dict(width=9, height=9, bounces=0)
SMALL = dict(width=32, height=32, bounces=1)

#: Needs under ambient light alone, where all edges are silhouettes and crossings.
CROSSINGS = dataclasses.replace(FLAT, crossings=True)
#: Needs of spheres over a floor under a sky, with shadows and mirrors.
FLOOR = st.Needs(textures=False, checkers=False, transmission=False, branching=False, inside=False)


def ambient_spheres(center, radius, color=(1.0, 1, 1), ka=1.0, kd=0.0, **material) -> st.Scene:
    """Makes spheres, by default under ambient light alone, before an eye that looks along -z."""
    camera = st.Camera(-np.pi / 2, 0.0, 500.0, 800.0)
    spheres = st.Spheres(np.asarray(center, float), radius, color, ka, kd, **material)
    return st.Scene(spheres, st.Lights([[300.0, 350, 400]]), camera, antialias=1)


def supersampled(scene: st.Scene, samples: int, **settings) -> np.ndarray:
    """Draws the reference picture: samples x samples single rays per pixel."""
    return np.asarray(st.render(scene.with_antialias(0), samples=samples, **settings))


def with_window(scene: st.Scene, window: float) -> st.Scene:
    """Returns the scene seen through a window of another height."""
    return eqx.tree_at(lambda s: s.camera.window, scene, jnp.asarray(window))
