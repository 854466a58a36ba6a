"""Pictures of 3 x 3 pixels and their derivatives.

All scenes have three spheres and two lights, so that they share one compiled program.
"""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

import spheretrace_jax as st
from extremes.case import Case
from extremes.exact import exact, picture as exact_picture, to_float

SIDE = 3
PIXELS = dict(width=SIDE, height=SIDE)
WEIGHTS = np.random.default_rng(5).uniform(0.5, 1.5, (SIDE, SIDE, 3))

#: Needs: mirrors, eyes and lights inside spheres, shadows, highlights, a background.
NEEDS = dataclasses.replace(
    st.Needs(), transmission=False, branching=False, textures=False, planes=False, checkers=False
)


@dataclasses.dataclass(frozen=True)
class Extreme:
    """A scene of the catalogue and its tolerances."""

    scene: st.Scene  #: with numbers that are rounded to float32, also for pictures in float64
    #: The largest error of pictures, in eps, relative to the largest number of the picture. An eps
    #: of an angle or a length may be many eps of the picture: n in (R.V)^n.
    rounding: float = 20
    slopes: float = 200  #: the largest error of derivatives, likewise
    smooth: bool = True  #: false on an edge, where no derivative exists
    bounces: int = 0


def three(lights=((300.0, 350, 400), (-250, 100, 300)), camera=None, **changes) -> st.Scene:
    """Makes three shiny spheres before the eye, two of them around the middle pixel."""
    columns = dict(
        center=[[-60.0, -30, 0], [50, 40, -40], [10, -20, 90]],
        radius=[60.0, 70, 45],
        color=[[0.8, 0.3, 0.2], [0.2, 0.7, 0.4], [0.5, 0.5, 0.9]],
        ka=[0.2, 0.15, 0.3],
        kd=[0.6, 0.7, 0.5],
        ks=[0.4, 0.2, 0.5],
        exponent=[5.0, 20, 2],
    )
    colors = [[0.5, 0.6, 0.3], [0.4, 0.2, 0.5]]
    camera = st.Camera(0.3, 0.4, 500.0, 900.0, 300.0) if camera is None else camera
    background = (0.1, 0.2, 0.3)
    spheres = st.Spheres(**(columns | changes))
    return st.Scene(spheres, st.Lights(lights, colors), camera, background=background)


@partial(jax.jit, static_argnames="bounces")
def _drawn(scene: st.Scene, weights: jax.Array, bounces: int):
    needs = NEEDS if bounces else dataclasses.replace(NEEDS, reflection=False)

    def weighted(scene):
        picture = st.render(scene, needs=needs, bounces=bounces, **PIXELS)
        return jnp.sum(weights * picture), picture

    return jax.grad(weighted, has_aux=True)(scene)


def drawn(scene: st.Scene, bounces: int = 0) -> tuple[st.Scene, np.ndarray]:
    """Returns the derivatives of the weighted sum of a picture, and the picture."""
    slopes, picture = _drawn(scene, jnp.asarray(WEIGHTS, scene.dtype), bounces)
    return slopes, np.asarray(picture)


def picture_case(tried: str, extreme: Extreme) -> Case:
    """Compares a picture in float32 and float64 with the picture in exact numbers."""

    def check() -> str:
        off, scene = [], extreme.scene.astype(np.float32)
        true = to_float(exact_picture(exact(scene), (SIDE, SIDE), extreme.bounces))
        for dtype in (np.float32, np.float64):
            _, picture = drawn(scene.astype(dtype), extreme.bounces)
            off.append(np.abs(picture - true).max() / (true.max() or 1) / np.finfo(dtype).eps)
        assert max(off) <= extreme.rounding, off
        return "{:.2g} eps in float32, {:.2g} in float64".format(*off)

    promise = f"the picture to {extreme.rounding:g} eps of its largest number"
    return Case(tried, promise, check, slow=extreme.bounces > 0)
