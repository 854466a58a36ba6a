"""Views at their limits.
Pictures as for shading, of angles and lengths that are rounded to float32: the rounding error of a
theta of 2 pi 1e6 is up to a quarter.
"""

import jax
import jax.numpy as jnp
import numpy as np

import spheretrace_jax as st
from extremes.case import Case, case
from extremes.exact import exact, pixel, to_float
from extremes.pictures import Extreme, drawn, picture_case, three

ROOM = dict(
    lights=((-50.0, -50, 100), (0, 0, -150)),
    center=[[0.0, 0, 0], [-60, 0, 0], [60, 10, -30]],
    radius=[300.0, 50, 40],
)
WRAPPED = 0.3 + 2e6 * np.pi


def fov(degrees: float) -> float:
    """Returns the distance of a window 300 units high with this vertical angle of view."""
    return 150 / np.tan(np.deg2rad(degrees) / 2)


def view(*camera: float, **digits: float) -> Extreme:
    """Makes a scene. **Arguments:** of `Camera`, and of `Extreme`."""
    return Extreme(three(camera=st.Camera(*camera)), **digits)


SCENES = {
    "phi = 0": view(0.3, 0.0, 500.0, 900.0, 300.0),
    "phi = pi": view(0.3, np.pi, 500.0, 900.0, 300.0, rounding=50),
    "theta = 0.3 + 2 pi 1e6": view(WRAPPED, 0.4, 500.0, 900.0, 300.0, slopes=1e3),
    "mu = 0, in the middle of a room": Extreme(
        three(camera=st.Camera(0.3, 0.4, 0.0, 900.0, 900.0), **ROOM)
    ),
    "mu = 1e6": view(0.3, 0.4, 1e6, 1.8e6, 300.0, rounding=2e4, slopes=1e5),
    "a field of view of 179.9 degrees": Extreme(
        three(camera=st.Camera(0.3, 0.4, 150.0, fov(179.9), 300.0), **ROOM)
    ),
    "a field of view of 0.001 degrees": view(0.3, 0.4, 500.0, fov(0.001), 300.0),
    "distance and window times 1e-23": view(0.3, 0.4, 500.0, 900e-23, 300e-23),
    "distance and window times 1e20": view(0.3, 0.4, 500.0, 900e20, 300e20),
}

PICTURES = [picture_case(tried, extreme) for tried, extreme in SCENES.items()]


@case("theta = 0.3 + 2 pi 1e6 in float64", "the picture of theta = 0.3 to 1e-8")
def wrapped() -> str:
    pictures = [drawn(view(theta, 0.4, 500.0, 900.0, 300.0).scene)[1] for theta in (0.3, WRAPPED)]
    off = np.abs(pictures[0] - pictures[1]).max()
    assert off < 1e-8
    return f"{off:.1g}; float64 rounds such an angle by {np.spacing(WRAPPED) / 2:.1g}"


def strip_case(width: int, height: int) -> Case:
    """Makes a case: a picture of one column, row or pixel is compared with exact pixels."""

    def check() -> str:
        size, longest = (width, height), max(width, height)
        window = 300 * height / longest
        scene = three(camera=st.Camera(0.3, 0.4, 500.0, 900.0, window)).astype(np.float32)
        needs = st.needs(scene)

        @jax.jit
        def draw(scene: st.Scene) -> tuple:
            picture = lambda s: st.render(s, width=width, height=height, needs=needs)
            seen, back = jax.vjp(picture, scene)
            return seen, back(jnp.ones_like(seen))

        seen, slopes = draw(scene)
        assert all(np.isfinite(x).all() for x in jax.tree.leaves(slopes))
        pixels = [(k, 0) if width > 1 else (0, k) for k in range(0, longest, 256)]
        true = np.array([to_float(pixel(exact(scene), *at, size)) for at in pixels])
        found = np.array([seen[row, column] for column, row in pixels])
        assert len(np.unique(true[:, 0])) > min(4, longest - 1)
        off = np.abs(found - true).max() / true.max() / np.finfo(np.float32).eps
        assert off <= 50, off
        return f"{off:.2g} eps"

    compared = "the pixel" if width == height else "each 256th pixel"
    promise = f"{compared} to 50 eps in float32; finite derivatives"
    slow = width > height  # the other shapes suffice, and each is compiled
    return Case(f"a picture of {width}x{height} pixels", promise, check, slow=slow)


STRIPS = [strip_case(1, 1), strip_case(1, 8192), strip_case(8192, 1)]
