"""Shading at its limits.
Pictures of 3 x 3 pixels, of three spheres and two lights, are compared with the lecture's formulas
in numbers of 50 digits.
"""

import jax
import jax.numpy as jnp
import numpy as np

import spheretrace_jax as st
from extremes.case import Case, case
from extremes.pictures import PIXELS, SIDE, Extreme, picture_case, three
from spheretrace_jax.base.vec import dot, unit, vec
from spheretrace_jax.scene.light import Light
from spheretrace_jax.tracing.hit import Surface
from spheretrace_jax.tracing.shading import Finish, blinn, light_terms

AHEAD = st.Camera(0.0, 0.0, 500.0, 900.0, 300.0)  #: the middle pixel looks down the z axis
BALL = dict(center=[[0.0, 0, 0], [-150, 40, 0], [150, -60, 30]], radius=[100.0, 45, 60])
EYE = (0.0, 0, 500)


def ahead(*lights, **changes) -> st.Scene:
    """Makes a sphere in the middle and two next to it, seen along the z axis."""
    return three(lights, AHEAD, **(BALL | changes))


SCENES = {
    "exponent 0": Extreme(ahead(EYE, (300, 0, 600), exponent=0.0), smooth=False),
    "exponent 1": Extreme(ahead(EYE, (300, 0, 600), exponent=1.0)),
    "exponent 1e4": Extreme(ahead((1.0, 2, 500), (300, 0, 600), exponent=1e4), 1e4, 1e5),
    "exponent 1e6": Extreme(ahead((0.1, 0.2, 500), (300, 0, 600), exponent=1e6), 1e6, 1e7),
    "N.L = 0 at the middle pixel": Extreme(ahead((70.0, 0, 100), (0, -900, 100)), smooth=False),
    "a light on the surface, where the middle pixel sees it": Extreme(
        ahead((0.0, 0, 100), (300, 0, 600)), smooth=False
    ),
    "lights in the middle of spheres": Extreme(ahead((0.0, 0, 0), (150, -60, 30))),
    "both lights at the eye": Extreme(ahead(EYE, EYE)),
    "lights 1e12 away": Extreme(ahead((1e12, 0, 1e12), (-1e12, 3e11, 1e12))),
    "all colours and coefficients 0": Extreme(ahead(EYE, EYE, color=(0, 0, 0), ka=0, kd=0, ks=0)),
    "all colours and coefficients 1": Extreme(ahead(EYE, EYE, color=(1, 1, 1), ka=1, kd=1, ks=1)),
    "a hall of mirrors: kgr = 1 in a sphere with two others": Extreme(
        three(
            ((-50.0, -50, 100), (0, 0, -150)),
            st.Camera(0.3, 0.4, 150.0, 900.0, 900.0),
            center=[[0.0, 0, 0], [-60, 0, 0], [60, 10, -30]],
            radius=[300.0, 50, 40],
            kgr=1.0,
        ),
        1e4, 1e5, bounces=3,
    ),
    "three concentric spheres, seen from outside": Extreme(
        ahead(EYE, EYE, center=[[0.0, 0, 0]] * 3)
    ),
    "three concentric spheres, seen from between": Extreme(
        three(
            ((0.0, 0, 90), (10, 20, 40)), st.Camera(0.3, 0.4, 80.0, 900.0, 900.0),
            center=[[1.0, 2, 3]] * 3, radius=[60.0, 50, 100],
        )
    ),
    "three identical spheres": Extreme(
        ahead(EYE, (300, 0, 600), center=[[0.0, 0, 0]] * 3, radius=100.0), smooth=False
    ),
    "a sphere around everything": Extreme(
        ahead(
            EYE, (300, 0, 600),
            center=[[0.0, 0, 0], [-20, 40, 0], [0, 0, 0]], radius=[100.0, 45, 1e4],
        )
    ),
    "radii of a million to one: a floor of 1e6, spheres of 60 and 1": Extreme(
        three(center=[[0.0, 0, -1e6 - 60], [50, 40, 0], [0.2, -0.4, 90]], radius=[1e6, 60, 1]),
        2e3, 1e4,
    ),
    "spheres of 1e-3 of a pixel": Extreme(
        ahead(EYE, (300, 0, 600), radius=[0.03, 0.01, 0.05]), slopes=5e3
    ),
}  # fmt: skip

PICTURES = [picture_case(tried, extreme) for tried, extreme in SCENES.items()]


@case("a halfway vector of length 0 (L = -V, seen edge-on)", "no highlight; finite derivatives")
def opposite() -> str:
    for dtype in (np.float32, np.float64):
        normal, direction = (vec(jnp.asarray(x, dtype)) for x in ([0.0, 0, 1], [1.0, 0, 0]))
        surface = Surface(normal * 0, normal, -dot(normal, direction))
        shine = lambda light, s=surface, d=direction: blinn(s, unit(light), d)
        value, slope = jax.value_and_grad(shine)(direction * 7)
        assert value == 0 and all(np.isfinite(jax.tree.leaves(slope)))
    return "0"


@case(
    "R.V = 0 where N.L > 0, exponents 0, 1 and 1e6",
    "highlights of 1 (0^0 = 1), 0 and 0 to 4 eps; finite derivatives",
)
def right_angle() -> str:
    worst = 0.0
    for dtype in (np.float32, np.float64):
        rows = [0.0, 0, 1], [-0.6, 0, -0.8], [0.8, 0, 0.6]
        normal, direction, light = (vec(jnp.asarray(row, dtype)) for row in rows)
        surface = Surface(normal * 0, normal, -dot(normal, direction))
        shine = lambda light, n, s=surface, d=direction: light_terms(
            s, d, Light(light, None, False), Finish(n, None), jnp.array(True), "phong"
        )[1]
        for exponent, expected in ((0.0, 1), (1.0, 0), (1e6, 0)):
            arguments = light, jnp.asarray(exponent, dtype)
            value, slopes = jax.value_and_grad(shine, (0, 1))(*arguments)
            assert all(np.isfinite(jax.tree.leaves(slopes)))
            worst = max(worst, abs(float(value) - expected) / np.finfo(dtype).eps)
    assert worst <= 4
    return f"{worst:.2g} eps"


def nothing_case(tried: str, promise: str, spheres: int, lights: int, middle: tuple) -> Case:
    """Makes a case of a number of spheres, all in the middle, and a number of lights."""

    def check() -> str:
        balls = st.Spheres(np.zeros((spheres, 3)), np.full(spheres, 100.0), ka=1.0)
        lamps = st.Lights(np.full((lights, 3), 500.0))
        scene = st.Scene(balls, lamps, background=(0.1, 0.2, 0.3)).astype(np.float32)
        needs = st.needs(scene)
        draw = lambda scene: st.render(scene, needs=needs, **PIXELS)
        weighted = jax.jit(jax.grad(lambda s: (jnp.sum(draw(s)), draw(s)), has_aux=True))
        slopes, picture = weighted(scene)
        assert all(np.isfinite(x).all() for x in jax.tree.leaves(slopes))
        expected = np.full((SIDE, SIDE, 3), np.float32([0.1, 0.2, 0.3]))
        expected[SIDE // 2, SIDE // 2] = middle
        np.testing.assert_array_equal(picture, expected)
        return "the same, bit for bit"

    return Case(tried, promise + "; finite derivatives", check)


NOTHING = [
    nothing_case("an empty scene", "the background", 0, 1, (0.1, 0.2, 0.3)),
    nothing_case("no lights", "black: the mean of no lights is 0, not NaN", 1, 0, (0, 0, 0)),
    nothing_case("neither spheres nor lights", "the background", 0, 0, (0.1, 0.2, 0.3)),
]
