"""Derivatives of pictures by one parameter: central differences, forward mode, and their errors."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import spheretrace_jax as st
from spheretrace_jax.study.benchmarks.derivatives import blurred as blurred

#: Parameters of `three_spheres`: the leaf, the index in it, and a step that moves edges by about
#: 1/20 pixel of a picture 256 pixels high.
PARAMETERS = {
    "center x": (lambda s: s.spheres.center, (0, 0), 0.06),
    "center y": (lambda s: s.spheres.center, (1, 1), 0.06),
    "center z": (lambda s: s.spheres.center, (1, 2), 0.3),
    "radius": (lambda s: s.spheres.radius, (0,), 0.06),
    "light x": (lambda s: s.lights.position, (0, 0), 0.25),
    "light y": (lambda s: s.lights.position, (0, 1), 0.25),
    "light z": (lambda s: s.lights.position, (0, 2), 0.4),
    "theta": (lambda s: s.camera.theta, (), 8e-4),
    "phi": (lambda s: s.camera.phi, (), 8e-4),
    "mu": (lambda s: s.camera.mu, (), 0.4),
    "distance": (lambda s: s.camera.distance, (), 0.6),
}


def moved(scene: st.Scene, name: str, step: float) -> st.Scene:
    """Returns the scene with one of its parameters changed."""
    leaf, index, _ = PARAMETERS[name]
    return eqx.tree_at(leaf, scene, leaf(scene).at[index].add(step))


def difference(scene: st.Scene, name: str, step: float, **settings) -> np.ndarray:
    """Returns the derivative of a picture by one parameter, as a central difference."""
    up, down = (st.render(moved(scene, name, s), **settings) for s in (step, -step))
    return np.asarray((up - down) / (2 * step))


def derivative(scene: st.Scene, **settings) -> Callable[[str], np.ndarray]:
    """Returns a function from a parameter's name to the picture's derivative, in forward mode."""
    settings = dict(needs=st.needs(scene)) | settings
    forward = eqx.filter_jit(
        lambda along: jax.jvp(lambda s: st.render(s, **settings), (scene,), (along,))[1]
    )
    still = jax.tree.map(jnp.zeros_like, scene)
    return lambda name: np.asarray(forward(moved(still, name, 1.0)))


def off(value: np.ndarray, truth: np.ndarray) -> float:
    """Returns the relative error in the L2 norm."""
    return float(np.linalg.norm(np.asarray(value) - truth) / np.linalg.norm(truth))
