"""Second derivatives of pictures with covered edges, against differences of the first."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import SCENES

import spheretrace_jax as st
from spheretrace_jax.fit.solution import solution

EYE = st.Camera(theta=0.3, phi=0.8)
LIGHT = st.Lights([[200.0, -300, 500]])


def ball(color: float) -> st.Scene:
    """Returns a scene of one sphere of a uniform grey."""
    spheres = st.Spheres([[0.0, 0, 0]], [100.0], (color,) * 3, ka=1.0, kd=0.0)
    return st.Scene(spheres, LIGHT, EYE, antialias=1)


def grown(t: jax.Array) -> jax.Array:
    """Returns the mean square of a picture of a sphere that is larger by t."""
    scene = ball(1.0)
    larger = eqx.tree_at(lambda s: s.spheres.radius, scene, scene.spheres.radius + t)
    return jnp.mean(st.render(larger, width=12, height=12, bounces=0) ** 2)


def moved(name: str, bounces: int) -> Callable[[jax.Array], jax.Array]:
    """Returns a mean square of a picture as a function of how far all of its scene has moved."""
    scene = SCENES[name].with_antialias(1)
    rng = np.random.default_rng(0)
    change = lambda x: 0.05 * rng.normal(size=x.shape) * np.maximum(np.abs(x), 0.1)
    along = jax.tree.map(change, scene)
    # the squares of a checker have no covered edges
    no_checker = lambda s: eqx.tree_at(
        lambda s: s.planes.checker_size, s, replace_fn=jnp.zeros_like
    )
    scene, along = no_checker(scene), no_checker(along)

    def mean_square(t: jax.Array) -> jax.Array:
        at = jax.tree.map(lambda x, by: x + t * by, scene, along)
        return jnp.mean(st.render(at, width=20, height=20, bounces=bounces) ** 2)

    return mean_square


def along_one(function: Callable, t: float) -> jax.Array:
    return jax.jvp(function, (t,), (1.0,))[1]


@pytest.mark.slow
@pytest.mark.parametrize("inner", [jax.jacfwd, jax.jacrev])
@pytest.mark.parametrize("outer", [jax.jacfwd, jax.jacrev])
def test_forward_and_reverse_over_forward_and_reverse(outer, inner):
    first, second = jax.jit(inner(grown)), jax.jit(outer(inner(grown)))
    for t in (0.0, 5.1):
        difference = (first(t + 1e-4) - first(t - 1e-4)) / 2e-4
        np.testing.assert_allclose(second(t), difference, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "bounces"), [("two_coloured_lights", 0), ("planes", 1), ("mirrors", 2), ("glass", 1)]
)
def test_second_derivatives_are_differences_of_the_first(name, bounces):
    picture = moved(name, bounces)
    first = jax.jit(lambda t: along_one(picture, t))
    second = jax.jit(lambda t: along_one(lambda t: along_one(picture, t), t))
    off = []
    for t in np.linspace(-1, 1, 9):
        each = [(first(t + h) - first(t - h)) / (2 * h) for h in (1e-6, 2e-6)]
        # where the two differences disagree the first derivative jumps: an object comes into view
        if abs(each[0] - each[1]) < 1e-3 * abs(each[0]):
            off.append(abs(second(t) - each[0]) / abs(each[0]))
    assert len(off) >= 7
    assert max(off) < 1e-4, off


@pytest.mark.slow
def test_solution_moves_as_refits_do():
    truth = st.render(ball(0.8), width=12, height=12, bounces=0)
    rng = np.random.default_rng(0)
    target = truth + 0.08 * rng.normal(size=truth.shape)
    problem = st.fit(ball(0.8), target, free=("radius",), bounces=0).problem
    along = rng.normal(size=truth.shape)

    @jax.jit
    def radius(t: jax.Array) -> jax.Array:
        at = eqx.tree_at(lambda p: p.targets[0].image, problem, target + t * along)
        return solution(at)[0][0].spheres.radius[0]

    slope = jax.jit(lambda t: along_one(radius, t))(0.0)
    np.testing.assert_allclose(slope, (radius(1e-3) - radius(-1e-3)) / 2e-3, rtol=1e-4)
