"""Centres, radii, the camera and shadows' light, found from antialiased pictures."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
import pytest
from helpers.scenes import nine_spheres, three_spheres

import spheretrace_jax as st
from spheretrace_jax.fit.model.parameters import Parameters
from spheretrace_jax.fit.problem import problem
from spheretrace_jax.fit.problem.make_problem import make_problem
from spheretrace_jax.fit.solver import driver
from spheretrace_jax.fit.solver.levenberg_marquardt import (
    BoundedLevenbergMarquardt,
    CautiousTrustRegion,
)
from spheretrace_jax.rendering.render import draw
from spheretrace_jax.scene.camera import view_frame
from spheretrace_jax.scene.settings import render_settings

SPHERES = ("center", "radius")
CAMERA = ("theta", "phi", "mu", "distance")
SMALL = dict(width=48, height=48)
MATTE = dict(bounces=0)
# From a lower one some spheres rise out of the others' shadows and never come back.
LIGHT = (100.0, 500, 800)


def two_over_a_floor(unit: float = 1.0) -> st.Scene:
    """Makes two spheres apart over a large one, all lengths in one over `unit`."""
    spheres = st.Spheres(
        unit * np.array([[-50.0, 10, -10], [50, -30, 60], [0, 0, -1100]]),
        unit * np.array([60.0, 45, 1000]),
        [[0.9, 0.2, 0.1], [0.1, 0.8, 0.3], [0.5, 0.5, 0.9]],
        kd=0.7,
    )
    camera = st.Camera(-np.pi / 2, 0.1, 500.0 * unit, 800.0 * unit, 512.0 * unit)
    return st.Scene(spheres, st.Lights(unit * np.array([[200.0, 300, 500]])), camera, antialias=1)


def with_spheres_off(scene: st.Scene, directions, signs) -> st.Scene:
    """Moves centres by half a radius along x and y, and radii by 30 %."""
    s = scene.spheres
    shift = np.pad(np.asarray(directions) / np.sqrt(8), ((0, 0), (0, 1)))
    new = s.center + shift * s.radius[:, None], s.radius * (1 + 0.3 * np.asarray(signs))
    return eqx.tree_at(lambda x: (x.spheres.center, x.spheres.radius), scene, new)


def displaced_two(unit: float = 1.0) -> st.Scene:
    """Returns the two spheres displaced; the floor stays where it is, but is free too."""
    return with_spheres_off(two_over_a_floor(unit), [[1, -1], [-1, 1], [0, 0]], [-1, 1, 0])


def displaced_nine(scene: st.Scene) -> st.Scene:
    """Shifts the rows along x and y in turn, so that no sphere meets another."""
    i, j = np.divmod(np.arange(9), 3)
    return with_spheres_off(scene, np.stack([(-1) ** j, (-1) ** i], 1), -((-1) ** (i + j)))


def turned(scene: st.Scene) -> st.Scene:
    """Turns the camera by 3 degrees, and moves it 2 % too far and too short."""
    c, turn = scene.camera, np.radians(3)
    camera = st.Camera(c.theta + turn, c.phi + turn, c.mu * 1.02, c.distance * 0.98, c.window)
    return eqx.tree_at(lambda s: s.camera, scene, camera)


def sphere_error(found: st.Scene, truth: st.Scene) -> float:
    """Returns the largest error of a centre or radius, relative to the sphere's radius."""
    a, b = found.spheres, truth.spheres
    center = np.abs(a.center - b.center) / b.radius[:, None]
    return float(max(center.max(), np.abs(a.radius / b.radius - 1).max()))


def camera_error(found: st.Scene, truth: st.Scene) -> float:
    """Returns the largest error of an angle in radians, or of a length relative to it."""
    a, b = found.camera, truth.camera
    lengths = [a.mu / b.mu - 1, a.distance / b.distance - 1]
    return float(np.abs([a.theta - b.theta, a.phi - b.phi, *lengths]).max())


@pytest.mark.slow
def test_centers_and_radii():
    truth = two_over_a_floor()
    found = st.fit(displaced_two(), st.render(truth, **SMALL), free=SPHERES)
    assert found.converged and found.steps <= 40
    assert sphere_error(found.scene, truth) < 1e-8


@pytest.mark.slow
def test_coarse_to_fine(monkeypatch):
    truth = two_over_a_floor()
    target, boxes = st.render(truth, **SMALL), []
    looked = driver.normal_at

    def look(problem, values):
        boxes.append(float(problem.settings[0].box))
        return looked(problem, values)

    monkeypatch.setattr(driver, "normal_at", look)
    alone = st.fit(displaced_two(), target, free=SPHERES)
    assert set(boxes) == {1.0}
    boxes.clear()
    monkeypatch.setattr(problem, "_LEAST_BOXES", 9)
    found = st.fit(displaced_two(), target, free=SPHERES)
    assert sphere_error(found.scene, truth) < 1e-8
    assert boxes == sorted(boxes, reverse=True) and set(boxes) == {5.0, 1.0}
    assert boxes.count(1.0) < 0.75 * alone.steps


def test_coarser_problems():
    def boxes(size, gaps=0.0, free=SPHERES):
        mask = np.random.default_rng(0).uniform(size=(size, size)) >= gaps
        scene, black = two_over_a_floor(), np.zeros((size, size, 3))
        made = make_problem(scene, black, free, bounces=0, mask=mask)
        return [float(wide.settings[0].box) for wide in made.coarser()]

    assert boxes(1200) == [25, 5]
    assert boxes(240) == [5] and boxes(239) == []
    assert boxes(240, gaps=0.01) == [5] and boxes(240, gaps=0.1) == []
    assert boxes(240, free=("color", "light_position")) == []


def test_users_solver_stays_fine(monkeypatch):
    monkeypatch.setattr(problem, "_LEAST_BOXES", 1)
    made = make_problem(two_over_a_floor(), np.zeros((8, 8, 3)), SPHERES, bounces=0)

    def coarse_to_fine(solver, dense=False):
        made_driver = driver.Driver(lambda _: solver, dense, 1e-8, 9, None)
        made_driver.begin(made)
        return made_driver.coarse_to_fine

    own = BoundedLevenbergMarquardt(1e-8, 1e-8, {}, {}, cautious=True)
    assert coarse_to_fine(own) and not coarse_to_fine(own, dense=True)
    assert not coarse_to_fine(optx.LevenbergMarquardt(1e-8, 1e-8))


@pytest.mark.slow
def test_boxes_are_pixels_of_smaller_picture():
    # ambient light alone, so that no smooth shading is averaged by its neighbours
    scene = eqx.tree_at(
        lambda s: (s.spheres.ka, s.spheres.kd, s.spheres.ks),
        two_over_a_floor(),
        (jnp.ones(3), jnp.zeros(3), jnp.zeros(3)),
    )
    whole = render_settings(scene, 48, 48, bounces=0)
    wide = np.asarray(draw(scene, dataclasses.replace(whole, box=jnp.array(3.0))))
    small = np.asarray(st.render(scene, width=16, height=16, bounces=0))
    np.testing.assert_allclose(wide[1::3, 1::3], small, atol=1e-12)


def test_rejected_steps_drop_further():
    search, y = CautiousTrustRegion(), jnp.array([1.0])
    jacobian = lx.MatrixLinearOperator(jnp.eye(1))
    here = optx.FunctionInfo.ResidualJac(y, jacobian)
    seen = lambda residual: optx.FunctionInfo.ResidualJac(jnp.array([residual]), jacobian)
    state, sizes = search.init(y, here), []
    # as foretold, then worse three times, then as foretold
    for residual in (0.0, 9.0, 9.0, 9.0, 0.0, 9.0):
        size, accepted, _, state = search.step(
            jnp.array(False), y, jnp.zeros(1), here, seen(residual), state
        )
        assert bool(accepted) == (residual == 0)
        sizes.append(float(size))
    ratios = np.array(sizes) / np.array([1.0, *sizes[:-1]])
    np.testing.assert_allclose(ratios, [3, 1 / 4, 1 / 16, 1 / 64, 3, 1 / 4])


@pytest.mark.slow
def test_camera():
    truth = two_over_a_floor()
    found = st.fit(turned(truth), st.render(truth, **SMALL), free=CAMERA)
    assert found.converged and found.steps <= 20
    assert camera_error(found.scene, truth) < 1e-8


def test_unknowns_are_unit_free():
    free = (*SPHERES, *CAMERA, "light_position")
    scenes = [displaced_two(unit) for unit in (1.0, 1e3, 1e-3)]
    numbers = [Parameters(scene, free).start() for scene in scenes]
    for other in numbers[1:]:
        for name in free:
            np.testing.assert_allclose(other[name], numbers[0][name], rtol=1e-14)


@pytest.mark.slow
def test_steps_are_unit_free():
    steps = set()
    for unit in (1e3, 1e-3):
        target = st.render(two_over_a_floor(unit), **SMALL)
        found = st.fit(displaced_two(unit), target, free=SPHERES)
        assert sphere_error(found.scene, two_over_a_floor(unit)) < 1e-8
        steps.add(next(i for i, cost in enumerate(found.costs) if cost < 1e-12))
    assert len(steps) == 1


def test_warning_without_antialiasing():
    truth = three_spheres()
    with pytest.warns(st.SceneWarning, match="radius, mu free: .*; set antialias to 1") as caught:
        st.fit(truth, np.zeros((4, 4, 3)), free=("color", "radius", "mu"), max_steps=0)
    assert len(caught) == 1


@pytest.mark.parametrize("name", ["center", "radius"])
def test_missing_spheres_cannot_be_free(name):
    nothing = st.Scene(st.Spheres(np.zeros((0, 3)), np.zeros(0)), st.Lights([[0.0, 0, 9]]))
    with pytest.raises(st.InputError, match=f"{name} is free, but the scene has no spheres"):
        st.fit(nothing, np.zeros((4, 4, 3)), free=(name,))


def test_zero_length_cannot_be_free():
    at_the_origin = eqx.tree_at(lambda s: s.camera.mu, two_over_a_floor(), jnp.array(0.0))
    with pytest.raises(st.InputError, match="mu is free: it must start above 0"):
        st.fit(at_the_origin, np.zeros((4, 4, 3)), free=("mu",))


@pytest.mark.slow
def test_nine_spheres_antialiased():
    truth = nine_spheres(LIGHT).with_antialias(1)
    target = st.render(truth, width=256, height=256, **MATTE)
    found = st.fit(displaced_nine(truth), target, free=SPHERES, **MATTE)
    assert found.converged
    assert sphere_error(found.scene, truth) < 1e-8


def depth_and_other_errors(found: st.Scene, truth: st.Scene) -> tuple[float, float]:
    """Returns the largest error of a centre along the line of sight; across it, or of a radius.

    Both are relative to the sphere's radius.
    """
    a, b = jax.tree.map(np.asarray, (found.spheres, truth.spheres))
    eye = view_frame(truth.camera).eye
    sight = b.center - np.array([eye.x, eye.y, eye.z])
    sight = sight / np.linalg.norm(sight, axis=1, keepdims=True)
    off = (a.center - b.center) / b.radius[:, None]
    along = np.sum(off * sight, axis=1, keepdims=True)
    across = np.linalg.norm(off - along * sight, axis=1)
    return np.abs(along).max(), max(across.max(), np.abs(a.radius / b.radius - 1).max())


def fitted_to_rays(displaced, free: tuple[str, ...]) -> tuple[st.Scene, st.Scene]:
    """Returns the nine spheres, displaced and fitted to 16 x 16 rays a pixel; and the truth."""
    truth = nine_spheres(LIGHT)
    target = st.render(truth, width=256, height=256, samples=16, **MATTE)
    found = st.fit(displaced(truth.with_antialias(1)), target, free=free, **MATTE)
    assert found.converged
    return found.scene, truth


@pytest.mark.slow
def test_nine_spheres_supersampled():
    depth, other = depth_and_other_errors(*fitted_to_rays(displaced_nine, SPHERES))
    assert other < 1e-3
    # the sampling error of 16 x 16 rays alone moves the best depth by 1.8e-3 (docs/edges.md)
    assert depth < 1e-2


@pytest.mark.slow
def test_camera_supersampled():
    assert camera_error(*fitted_to_rays(turned, CAMERA)) < 1e-3


@pytest.mark.slow
def test_light_with_and_without_antialiasing():
    # single rays came to 4.9 units before their fits looked past shadows a second time; 0.5 now
    size = dict(width=96, height=96)
    target = st.render(three_spheres(), samples=16, **size)
    apart = {}
    for antialias in (0, 1):
        truth = three_spheres(antialias)
        off = truth.lights.position + jnp.array([[80.0, -80, 80]])
        start = eqx.tree_at(lambda s: s.lights.position, truth, off)
        found = st.fit(start, target, free=("light_position",)).scene.lights.position
        apart[antialias] = float(jnp.linalg.norm(found - truth.lights.position))
    assert apart[1] < 0.05 and apart[1] < apart[0] / 10
