"""Gauge fixing: of color times c, with ka and kd divided by c, a rule picks the scale c."""

from typing import Literal, get_args

import jax.numpy as jnp
from jaxtyping import PyTree

from ..problem.problem import Problem

Gauge = Literal["ka", "color", "none"]

GAUGES = get_args(Gauge)


def fix_gauge(problem: Problem, values: PyTree, gauge: Gauge) -> PyTree:
    """Returns, of all scenes that look the same, the one that a rule picks.

    Only where color, ka and kd are all free. `"ka"`: the one whose ka is the start's, or, where
    color or kd would leave 0..1 then, the nearest to it; `"color"`: the one whose brightest
    channel is 1; `"none"`: this one.
    """
    if gauge == "none" or not {"color", "ka", "kd"} <= set(values):
        return values
    natural = problem.parameters[0].natural({n: values[n] for n in ("color", "ka", "kd")})
    color, ka, kd = natural["color"], natural["ka"], natural["kd"]
    brightest = jnp.max(color, axis=1)
    most = 1 / jnp.maximum(brightest, jnp.finfo(color.dtype).tiny)
    c = jnp.where(brightest > 0, most, 1)
    if gauge == "ka":
        start = problem.parameters[0].scene.spheres.ka
        # a ka above 0 comes nearest to 0 with the brightest colour; one of 0 is 0 with any
        c = jnp.where(start > 0, ka / jnp.where(start > 0, start, 1), c)
        c = jnp.where(ka > 0, c, 1)
    # ka and kd divided by c stay in 0..1, and so does color times c
    c = jnp.clip(c, jnp.maximum(kd, ka), most)
    c = jnp.where(c > 0, c, 1)
    clipped = lambda x: jnp.clip(x, 0, 1)  # against the last bit of rounding
    scaled = {"color": clipped(color * c[:, None]), "ka": clipped(ka / c), "kd": clipped(kd / c)}
    return {**values, **scaled}
