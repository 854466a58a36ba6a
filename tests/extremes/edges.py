"""Covered edges at their limits (antialias 1).
Spheres smaller than a pixel are discs of known area. An eps is relative to a pixel that the sphere
fills.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

import spheretrace_jax as st
from extremes import shading, views
from extremes.case import case
from extremes.pictures import NEEDS, PIXELS, WEIGHTS

LEAN = dataclasses.replace(
    NEEDS, shadows=False, highlights=False, inside=False, reflection=False, crossings=False
)


SIDE, EYE = 2.0, 600.0  #: the side of a pixel on the view plane, and the distance of that plane


def disc(radius: float, x: float) -> st.Scene:
    """Makes a white sphere in ambient light. **Arguments:** radius and offset in pixels."""
    ball = st.Spheres([[0.0, x * SIDE, 0]], [radius * SIDE], (1.0, 1, 1), ka=1.0, kd=0.0)
    camera = st.Camera(0.0, 0.0, EYE, EYE, SIDE * PIXELS["height"])
    return st.Scene(ball, st.Lights([[0.0, 0, 1e4]]), camera, antialias=1)


def area(radius: float, x: float) -> tuple[float, float]:
    """Returns the area of a sphere's silhouette, in pixels, and R times its derivative by R.

    The silhouette is an ellipse: a cone of half angle a, whose axis is turned by b, cuts a plane at
    distance d with the half axes d sin a cos a / (cos^2 b - sin^2 a) and
    d sin a / sqrt(cos^2 b - sin^2 a).
    """
    away = np.hypot(EYE, x * SIDE)
    sine2 = (radius * SIDE / away) ** 2
    rest = (EYE / away) ** 2 - sine2
    pixels = np.pi * (EYE / SIDE) ** 2 * sine2 * np.sqrt(1 - sine2) / rest**1.5
    return pixels, pixels * (2 - sine2 / (1 - sine2) + 3 * sine2 / rest)


@case(
    "spheres of 1e-4 to 0.9 pixels, in the middle of a pixel, off it and on the line between two",
    "the sum of the picture, and R times its derivative by R, equal those of the disc to 20 eps"
    " plus 2e-5 of its diameter in pixels, as pixels of 0.2 degrees take edges to be straight",
    slow=True,
)
def discs() -> str:
    @jax.jit
    def sums(scene: st.Scene) -> tuple[jax.Array, st.Scene]:
        draw = lambda scene: st.render(scene, needs=LEAN, bounces=0, **PIXELS)[..., 0].sum()
        return jax.value_and_grad(draw)(scene)

    found = []
    for dtype in (np.float32, np.float64):
        worst = 0.0
        for radius in (1e-4, 1e-3, 0.01, 0.1, 0.4, 0.9):
            for x in (0.0, 0.2, 0.5):
                scene = disc(radius, x).astype(dtype)
                value, slopes = sums(scene)
                assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slopes))
                grows = slopes.spheres.radius[0] * scene.spheres.radius[0]
                error = np.abs(np.float64([value, grows]) - area(radius, x)).max()
                assert error <= 4e-5 * radius + 20 * np.finfo(dtype).eps, (dtype, radius, x, error)
                worst = max(worst, error / (2 * radius))
        found.append(f"{worst:.1g} of the diameter in {dtype.__name__}")
    return ", ".join(found)


@case(
    "the scenes of shading and of views, but the hall of mirrors, with covered edges",
    "pictures and the derivatives by all arrays are finite, in float32",
    slow=True,
)
def finite() -> str:
    needs = dataclasses.replace(NEEDS, reflection=False)

    @jax.jit
    def drawn(scene: st.Scene, weights: jax.Array) -> tuple[st.Scene, jax.Array]:
        def weighted(scene: st.Scene) -> tuple[jax.Array, jax.Array]:
            picture = st.render(scene, needs=needs, bounces=0, **PIXELS)
            return jnp.sum(weights * picture), picture

        return jax.grad(weighted, has_aux=True)(scene)

    scenes = {name: x for name, x in (shading.SCENES | views.SCENES).items() if not x.bounces}
    for name, extreme in scenes.items():
        scene = extreme.scene.astype(np.float32).with_antialias(1)
        found = drawn(scene, jnp.asarray(WEIGHTS, np.float32))
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found)), name
    return f"{len(scenes)} scenes"
