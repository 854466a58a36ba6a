"""What photographs leave open of a camera, found from pictures: principal point, focal length."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.antialiasing import ambient_spheres
from helpers.identifiability import check, fit_at
from helpers.scenes import with_camera
from jax.flatten_util import ravel_pytree

import spheretrace_jax as st
from spheretrace_jax.fit.normal_equations.parameter_index import ParameterIndex
from spheretrace_jax.fit.problem.make_problem import make_problem
from spheretrace_jax.fit.solver.driver import normal_at

SIZE = dict(width=32, height=24, bounces=0)


def balls(**camera) -> st.Scene:
    """Makes four balls at several depths, under ambient light alone."""
    center = [[-90.0, 60, 0], [100, 40, 150], [30, -100, -150], [-60, -60, 200]]
    colors = [[1.0, 0.2, 0.1], [0.1, 0.9, 0.3], [0.3, 0.3, 1], [0.8, 0.8, 0.2]]
    scene = ambient_spheres(center, [50.0, 40, 60, 30], colors)
    return with_camera(scene, **camera)


@pytest.mark.slow
@pytest.mark.parametrize("orthographic", [False, True])
def test_principal_point_and_focal_length_are_found(orthographic):
    free = ("principal_point", "roll", "pixel_aspect")
    free = free if orthographic else (*free, "distance")
    numbers = dict(roll=jnp.array(0.1), pixel_aspect=jnp.array(1.2))
    truth = balls(principal_point=jnp.array([0.05, -0.03]), **numbers, orthographic=orthographic)
    # unset numbers start at their defaults
    start = balls(distance=jnp.array(860.0), orthographic=orthographic)
    found = st.fit(start, st.render(truth, **SIZE), free=free, bounces=0)
    assert found.converged
    for name in free:
        wanted = getattr(truth.camera, name)
        np.testing.assert_allclose(getattr(found.scene.camera, name), wanted, rtol=1e-6, atol=1e-7)
    assert found.scene.camera.look_at is None


@pytest.mark.slow
def test_what_the_eye_looks_at_is_found():
    truth = balls(look_at=jnp.array([12.0, -8, 30]), theta=jnp.array(-1.5))
    start = balls(phi=jnp.array(0.02))
    truth = with_camera(truth, phi=jnp.array(0.05))
    free = ("look_at", "theta", "phi")
    found = st.fit(start, st.render(truth, **SIZE), free=free, bounces=0)
    assert found.converged
    np.testing.assert_allclose(found.scene.camera.look_at, truth.camera.look_at, atol=1e-4)


@pytest.mark.slow
def test_rows_of_the_jacobian_are_derivatives():
    free = ("theta", "look_at", "principal_point", "color")
    scene = balls(principal_point=jnp.array([0.05, -0.03]))
    target = np.asarray(st.render(scene, **SIZE)) + 0.01
    problem = make_problem(scene, target, free, bounces=0)
    normal = normal_at(problem, problem.start())
    shapes = {
        n: x.shape for n, x in ParameterIndex(problem.parameters[0].scene, free).places.items()
    }
    assert shapes == {"theta": (), "look_at": (3,), "principal_point": (2,), "color": (4, 3)}
    gradient = ravel_pytree(problem.start())[1](normal.gradient)
    for name in ("look_at", "principal_point"):
        for i in range(shapes[name][0]):
            costs = []
            for step in (1e-6, -1e-6):
                values = problem.start()
                values[name] = values[name].at[i].add(step)
                costs.append(float(normal_at(problem, values).cost))
            expected = (costs[0] - costs[1]) / 2e-6
            np.testing.assert_allclose(gradient[name][i], expected, rtol=0.03, atol=0.02)


AGAINST = "the camera's {} against {} is not determined"


@pytest.mark.parametrize(
    ("camera", "free", "nullity", "words"),
    [
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                ({}, ("mu", "look_at"), 1, {AGAINST.format("mu", "its look_at")}),
                (
                    {"phi": jnp.array(0.0)},
                    ("roll", "theta"),
                    1,
                    {AGAINST.format("roll", "its theta")},
                ),
                (
                    {"orthographic": True},
                    ("principal_point", "look_at"),
                    3,
                    {
                        AGAINST.format("principal_point", "its look_at"),
                        "the camera's look_at along its axis is not determined",
                    },
                ),
                ({"orthographic": True}, ("mu", "roll"), 1, {"the camera's mu is not determined"}),
                ({}, ("principal_point", "distance", "roll"), 0, set()),
            )
        ),
    ],
)
def test_what_no_picture_tells_of_a_camera(camera, free, nullity, words):
    scene = balls(theta=jnp.array(0.4), **({"phi": jnp.array(0.3)} | camera))
    fit = fit_at(scene, free, st.render(scene, **SIZE))
    check(fit, nullity, words)


def test_bounds_ties_and_parts_of_a_camera():
    scene, black = balls(), np.zeros((8, 8, 3))
    made = make_problem(scene, black, {"principal_point": [0], "look_at": [0, 1]}, bounces=0)
    assert {n: x.size for n, x in made.start().items()} == {"principal_point": 1, "look_at": 2}
    with pytest.raises(st.InputError, match="look_at of coordinate 1 starts at 0, outside"):
        make_problem(scene, black, ("look_at",), bounces=0, limits={"look_at": (1, 2)})
    with pytest.raises(st.InputError, match=r"tie.*the camera has one look_at"):
        make_problem(scene, black, ("look_at",), bounces=0, tie={"look_at": True})
    with pytest.raises(st.InputError, match="indices of coordinates from 0 to 1, got 2"):
        make_problem(scene, black, {"principal_point": [2]}, bounces=0)


def test_several_pictures_have_cameras_of_their_own():
    one, other = balls(), balls(look_at=jnp.array([5.0, 0, 0]))
    targets = [np.zeros((8, 8, 3))] * 2
    with pytest.raises(st.InputError, match="look_at is free and starts differently in scene 2"):
        make_problem([one, other], targets, ("look_at",), bounces=0)
    made = make_problem([one, other], targets, ("look_at",), bounces=0, per_picture=("look_at",))
    starts = [p.scene.camera.look_at for p in made.parameters]
    np.testing.assert_array_equal(starts, [[0, 0, 0], [5, 0, 0]])


def test_unknowns_do_not_depend_on_units():
    for unit in (1e-3, 1e3):
        scene = balls(look_at=jnp.array([12.0, -8, 30]))
        at = lambda s: (s.spheres.center, s.spheres.radius, s.camera.look_at)
        scaled = eqx.tree_at(at, scene, [unit * x for x in at(scene)])
        found = [
            make_problem(s, np.zeros((8, 8, 3)), ("look_at",), bounces=0).start()["look_at"]
            for s in (scene, scaled)
        ]
        np.testing.assert_allclose(*found, rtol=1e-13)


@pytest.mark.slow
def test_materials_are_fitted_through_a_parallel_view():
    # shading samples of rays that start all over a plane, with edges and a mirror
    numbers = dict(orthographic=True, window=jnp.array(420.0), roll=jnp.array(0.3))
    scene = balls(**numbers, principal_point=jnp.array([0.05, -0.03]))
    scene = eqx.tree_at(lambda s: s.spheres.kgr, scene, jnp.array([0.0, 0.3, 0, 0]))
    target = st.render(scene, **SIZE | {"bounces": 1})
    problem = make_problem(scene, target, ("color",), bounces=1)
    assert problem.buffers[0] is not None
    normal = normal_at(problem, problem.start())
    assert float(normal.cost) < 1e-24 and float(jnp.trace(normal.square)) > 1
