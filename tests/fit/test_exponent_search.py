"""Exponents that are tried with the lights."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from helpers.scenes import three_apart

import spheretrace_jax as st
from spheretrace_jax.fit.problem.make_problem import make_problem
from spheretrace_jax.fit.solver.exponent_search import with_best_exponents, with_exponents
from spheretrace_jax.fit.solver.variable_projection import sample_pixels

TRUTH = three_apart([900.0, -400, 700], exponent=[4.0, 64, 16])
START = eqx.tree_at(lambda s: s.spheres.exponent, TRUTH, jnp.full(3, 10.0))
FREE = ("color", "ka", "kd", "ks", "exponent", "light_position")
SIZE = dict(width=64, height=64, bounces=0)


def sampled(free, **asked):
    problem = make_problem(START, st.render(TRUTH, **SIZE), free, bounces=0, **asked)
    parts = problem.parameters[0], problem.targets[0], problem.settings[0]
    return sample_pixels(*parts), problem.parameters[0]


def test_which_are_tried():
    exponents = lambda *of, **asked: [
        np.asarray(s.scene.spheres.exponent).tolist()
        for s in with_exponents(*sampled(*of, **asked))
    ]
    assert exponents(FREE)[0] == [10, 10, 10] and len(exponents(FREE)) == 5
    assert all(len(set(x)) == 1 for x in exponents(FREE))
    assert len(exponents(("color", "light_position"))) == 1
    assert len(exponents(FREE, limits={"exponent": (1, 50)})) == 1
    some = exponents({"exponent": [1], "color": True, "light_position": True})
    assert all(x[0] == x[2] == 10 for x in some) and len({x[1] for x in some}) == 5


def test_each_sphere_takes_its_own():
    sample, parameters = sampled(FREE)
    best = with_best_exponents(sample, parameters, TRUTH.lights.position)
    np.testing.assert_array_equal(best.scene.spheres.exponent, TRUTH.spheres.exponent)
    held, parameters = sampled(("color", "light_position"))
    assert with_best_exponents(held, parameters, TRUTH.lights.position) is held
