"""Gauge fixing: of color times c, with ka and kd divided by c, a rule picks the scale c."""

from typing import Literal, get_args

import jax.numpy as jnp
from jaxtyping import Array, Bool, PyTree

from ..model.parameters import Parameters
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
    parameters = problem.parameters[0]
    natural = parameters.natural({n: values[n] for n in ("color", "ka", "kd")})
    color, ka, kd = natural["color"], natural["ka"], natural["kd"]
    brightest = jnp.max(color, axis=1)
    most = 1 / jnp.maximum(brightest, jnp.finfo(color.dtype).tiny)
    c = jnp.where(brightest > 0, most, 1)
    if gauge == "ka":
        start = parameters.scene.spheres.ka
        # a ka above 0 comes nearest to 0 with the brightest colour; one of 0 is 0 with any
        c = jnp.where(start > 0, ka / jnp.where(start > 0, start, 1), c)
        c = jnp.where(ka > 0, c, 1)
    # ka and kd divided by c stay in 0..1, and so does color times c
    c = jnp.clip(c, jnp.maximum(kd, ka), most)
    c = jnp.where(c > 0, c, 1)
    if parameters.constraints:
        c = jnp.where(_has_gauge(parameters), c, 1)
    clipped = lambda x: jnp.clip(x, 0, 1)  # against the last bit of rounding
    scaled = {"color": clipped(color * c[:, None]), "ka": clipped(ka / c), "kd": clipped(kd / c)}
    constraints = parameters.constraints
    reduced = {n: constraints[n].reduced(x) if n in constraints else x for n, x in scaled.items()}
    return {**values, **reduced}


def _has_gauge(parameters: Parameters) -> Bool[Array, " spheres"]:
    """Returns the spheres whose color, ka and kd may be scaled without changing another's.

    All of these must be free and without bounds or priors, and if they are tied to other spheres',
    then all three to the same.
    """
    own = jnp.arange(len(parameters.scene.spheres), dtype=jnp.int32)
    free, alone, firsts = jnp.full(own.shape, True), jnp.full(own.shape, True), []
    for name in ("color", "ka", "kd"):
        constraint, first = parameters.constraints.get(name), own
        if constraint is not None:
            unknown = constraint.unknown.reshape(len(own), -1)
            limits = jnp.isfinite(constraint.lower) | jnp.isfinite(constraint.upper)
            free &= jnp.all(unknown >= 0, axis=1) & ~jnp.any(limits | (constraint.weight > 0))
            shared = constraint.first[jnp.maximum(unknown[:, 0], 0)] // unknown.shape[1]
            first = jnp.where(unknown[:, 0] < 0, own, shared)
        alone &= jnp.zeros_like(own).at[first].add(1)[first] == 1
        firsts.append(first)
    alike = jnp.all(jnp.stack(firsts) == firsts[0][None])
    return free & (alone | alike)
