"""Natural JAX is fast JAX: a scene that is closed over compiles to the program of an argument.

XLA knows all numbers of a scene that is a constant of the compiled function. Branches that keep
values from being computed again must not be folded away then (`barriers.compute_once`): the
optimised program would be one loop that finds every hit again for each of its uses.
"""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest
from helpers.scenes import nine_spheres

import spheretrace_jax as st

SIZE = dict(width=64, height=48, bounces=0)
COLOR = lambda s: s.spheres.color


def branches(function, *arguments) -> int:
    """Counts the conditional branches that are left in the optimised program."""
    text = jax.jit(function).lower(*arguments).compile().as_text()
    return len(re.findall(r"= .* conditional\(", text))


@pytest.mark.parametrize("work", ["picture", pytest.param("gradient", marks=pytest.mark.slow)])
def test_branches_stay_in_closures(work):
    scene = nine_spheres().astype(jnp.float32)
    needs = st.needs(scene, free=("color",))
    render = lambda s: st.render(s, **SIZE, needs=needs)
    closed = lambda color: render(eqx.tree_at(COLOR, scene, color))
    passed = lambda color, scene: render(eqx.tree_at(COLOR, scene, color))
    if work == "gradient":
        closed, passed = (jax.grad(lambda *a, f=f: jnp.sum(f(*a) ** 2)) for f in (closed, passed))
    color = COLOR(scene)
    as_argument = branches(passed, color, scene)
    assert as_argument > 2
    assert branches(closed, color) == as_argument
