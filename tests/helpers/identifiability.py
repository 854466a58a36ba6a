"""Scenes that are made so that what their pictures determine is known, and fits at them."""

import warnings

import numpy as np
from jax.flatten_util import ravel_pytree

import spheretrace_jax as st

SIZE = dict(width=32, height=24)
LIGHTS = [[100.0, 200, 400], [-200, 50, 300]]
BEHIND = [[100.0, 200, -4000], [0, 0, -3000]]
SIDE = [[-400.0, 0, 40], [-500, 0, 60]]  # from here sphere 2 is in the shadow of sphere 1
FAR_AWAY = [1e4, 0, 0]
RED, GREEN = [0.8, 0.3, 0.2], [0.2, 0.7, 0.4]


def scene(dtype=np.float64, camera=(-np.pi / 2, 0.1), planes=None, background=0.0, **changes):
    """Makes sphere 1 on the left, 2 on the right, 3 small above, and two lights above all.

    **Arguments:** `changes`: of the spheres, `lights` and `light_color`.
    """
    parts = (
        dict(
            center=[[-40.0, 0, 0], [45, 10, 0], [0, 45, 60]],
            radius=[35.0, 30, 15],
            color=[RED, GREEN, [0.5, 0.5, 0.9]],
            ka=[0.2, 0.15, 0.3],
            kd=[0.6, 0.7, 0.5],
            ks=[0.4, 0.2, 0.5],
            exponent=[5.0, 10, 3],
            lights=LIGHTS,
            light_color=[[0.5, 0.6, 0.3], [0.4, 0.2, 0.5]],
        )
        | changes
    )
    lights = st.Lights(parts.pop("lights"), parts.pop("light_color"))
    planes = None if planes is None else st.Planes(*planes)
    background = np.broadcast_to(background, 3)
    eye = st.Camera(*camera, 500.0, 800.0, 200.0)
    return st.Scene(st.Spheres(**parts), lights, eye, planes, (), background).astype(dtype)


def fit_at(truth, free, target=None, **settings) -> st.Fit:
    """Returns the fit that starts, and stays, at the scene of its picture."""
    target = st.render(truth, bounces=0, **SIZE) if target is None else target
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*set antialias to 1")
        return st.fit(truth, target, free=free, bounces=0, max_steps=0, **settings)


def check(fit: st.Fit, nullity: int, words: set[str]) -> None:
    known = fit.identifiability
    assert set(known.undetermined) == words
    assert known.free - known.rank == nullity
    assert known.free == ravel_pytree(fit.values)[0].size


def without(row: int, value, name: str):
    """Returns the default numbers of a name, with another for one sphere."""
    numbers = np.array(getattr(scene().spheres, name))
    numbers[row] = value
    return {name: numbers}


HIDDEN = without(1, [-56, 20, -199], "center") | without(1, 20, "radius")  # by sphere 1


def scales(*spheres: int, of: str = "ka and kd") -> set[str]:
    return {f"sphere {i}: the scale of color against {of} is not determined" for i in spheres}


def channels(up: str, down: str, names: str = "red green blue", of: str = "") -> set[str]:
    return {f"{up} against {down} is not determined in {c}{of}" for c in names.split()}
