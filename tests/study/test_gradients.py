"""Derivatives across scenes and parameters: the table is `check_gradients`."""

from collections.abc import Iterator

import equinox as eqx
import jax
import jax.extend.core
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import SCENES, nine_spheres

import spheretrace_jax as st
from spheretrace_jax.antialiasing import coverage

SIZE = dict(width=20, height=20, bounces=2)


@pytest.mark.parametrize(
    ("name", "highlight"),
    [
        pytest.param("two_coloured_lights", "blinn", marks=pytest.mark.slow),
        ("glass", "phong"),
        pytest.param("planes", "phong", marks=pytest.mark.slow),
        pytest.param("textures", "phong", marks=pytest.mark.slow),
        pytest.param("inside", "phong", marks=pytest.mark.slow),
    ],
)
def test_forward_reverse_and_differences_agree_by_every_parameter(name, highlight):
    scene = SCENES[name]
    table = st.check_gradients(scene, highlight=highlight, **SIZE)
    arrays = [leaf for leaf in jax.tree.leaves(scene) if leaf.size]
    uncoated = sum(bool(len(x)) for x in (scene.spheres, scene.planes))  # ior 1 has no row
    left_out = uncoated + 1  # and the fall-off, which no light has
    assert len(table.rows) == len(arrays) - left_out, "every other array of the scene has its row"
    for row in table.rows:
        assert row.forward < 1e-6, row
        assert row.reverse < 1e-14, row
        assert row.second < 1e-6, row
        assert row.left_out <= 0.05 * row.pixels, row
    moving = [row.parameter for row in table.rows if row.largest > 0]
    assert {"spheres.center", "spheres.radius", "spheres.color", "camera.theta"} <= set(moving)


@pytest.mark.slow
def test_derivatives_by_indices_of_refraction_agree():
    scene = eqx.tree_at(lambda s: s.spheres.ior, SCENES["coated"], jnp.array([1.5, 1.3, 2.0]))
    table = st.check_gradients(scene, every=False, width=20, height=20, bounces=0)
    rows = {row.parameter: row for row in table.rows}
    for owner in ("spheres", "planes"):
        row = rows[f"{owner}.ior"]
        assert row.forward < 1e-6 and row.reverse < 1e-14 and row.second < 1e-6, row
        assert row.largest > 0.01 and row.left_out == 0, row
    idle = st.check_gradients(SCENES["diffuse"], every=False, width=4, height=4, second=False)
    assert "every ior is 1: spheres" in str(idle)


def test_derivatives_by_directions_and_falloff():
    lights = st.Lights(
        [[300.0, 350, 400], [-0.5, 0.2, 0.9], [60, -80, 150]], (0.4, 0.3, 0.3),
        directional=(False, True, False), falloff=(0, 0, 180),
    )  # fmt: skip
    scene = eqx.tree_at(lambda s: s.lights, SCENES["shadows"], lights)
    table = st.check_gradients(scene, width=16, height=16, bounces=0, every=False, second=False)
    rows = {row.parameter: row for row in table.rows}
    for name in ("lights.position", "lights.falloff"):
        row = rows[name]
        assert row.forward < 1e-6 and row.reverse < 1e-13 and row.largest > 0, row


def test_what_the_table_leaves_out_lies_on_edges():
    table = st.check_gradients(nine_spheres(), width=48, height=48, bounces=0, second=False)
    assert "second" not in str(table)
    rows = {row.parameter: row for row in table.rows}
    # colours move no edges, so nothing is left out; moving centres and lights does
    for name in ("color", "ka", "kd", "ks"):
        assert rows[f"spheres.{name}"].left_out == 0
    assert all(row.pixels == 48 * 48 for row in table.rows)
    assert f"{rows['spheres.ka'].left_out} of 2304" in str(table)


def test_a_wrong_derivative_is_caught():
    # needs of the scene as it is: rays are not followed into spheres whose kgr is 0 now
    scene = SCENES["mirrors"]
    table = st.check_gradients(scene, needs=st.needs(scene), **SIZE)
    rows = {row.parameter: row for row in table.rows}
    assert rows["spheres.kgr"].forward > 0.1
    assert rows["spheres.color"].forward < 1e-5
    assert table.worst == max(max(r.forward, r.reverse) for r in table.rows)


@pytest.mark.slow
def test_a_wrong_second_derivative_is_caught(monkeypatch):
    scene = SCENES["diffuse"].with_antialias(1)
    check = lambda: st.check_gradients(scene, needs=st.needs(scene), width=12, height=12, bounces=0)
    of_radius = lambda table: next(r for r in table.rows if r.parameter == "spheres.radius")
    right = check()
    assert 0 < of_radius(right).second < 1e-4
    assert "second - fd" in str(right)
    monkeypatch.setattr(coverage, "stop_first_gradient", jax.lax.stop_gradient)
    jax.clear_caches()
    wrong = of_radius(check())
    assert wrong.second > 0.1 and not wrong.agree
    np.testing.assert_allclose(wrong.forward, of_radius(right).forward, rtol=1e-6)


def programs(jaxpr: jax.extend.core.Jaxpr) -> Iterator[jax.extend.core.Jaxpr]:
    """Yields a program and all programs within it."""
    yield jaxpr
    for equation in jaxpr.eqns:
        for inner in jax.extend.core.jaxprs_in_params(equation.params):
            yield from programs(inner)


def equal_maxima(function, *arguments) -> list[str]:
    """Finds comparisons of numbers with their maximum or minimum, in the derivative of a function.

    Such comparisons are how jax 0.10 differentiates both; they fail where XLA rounds twice
    (`vec.larger`).
    """
    slopes = lambda *a: jax.jvp(function, a, jax.tree.map(jnp.ones_like, a))
    found = []
    for program in programs(jax.make_jaxpr(slopes)(*arguments).jaxpr):
        extremes = {
            v for e in program.eqns if e.primitive.name in ("max", "min") for v in e.outvars
        }
        equal = [e for e in program.eqns if e.primitive.name == "eq"]
        found += [str(e) for e in equal if any(v in extremes for v in e.invars if v.aval.shape)]
    return found


@pytest.mark.skipif(jax.__version_info__ >= (0, 12), reason="jax asks which number is larger")
@pytest.mark.parametrize("antialias", [0, 1])
@pytest.mark.parametrize("name", ["planes", "glass", "textures"])
def test_no_derivative_asks_whether_a_number_is_the_maximum(name, antialias):
    scene = SCENES[name].with_antialias(antialias)
    known = st.needs(scene, free=("center", "radius", "ks", "kgr"))
    assert not equal_maxima(lambda s: st.render(s, needs=known, **SIZE), scene)
    assert equal_maxima(lambda x: jnp.maximum(x, 1), jnp.zeros(3))


@pytest.mark.slow
@pytest.mark.skipif(jax.__version_info__ >= (0, 12), reason="jax asks which number is larger")
@pytest.mark.parametrize("name", ["planes", "glass"])
def test_no_second_derivative_asks_either(name):
    scene = SCENES[name].with_antialias(1)
    known = st.needs(scene, free=("center", "radius", "ks", "kgr"))
    picture = lambda s: st.render(s, needs=known, **SIZE)
    slope = lambda s: jax.jvp(picture, (s,), (jax.tree.map(jnp.ones_like, s),))[1]
    assert not equal_maxima(slope, scene)


def test_float32_scenes_are_checked_in_float64():
    scene = SCENES["diffuse"].astype(jnp.float32)
    known = st.needs(scene)  # without mirrors, which compile for long
    assert st.check_gradients(scene, needs=known, width=8, height=8).worst < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [n if n == "shadows" else pytest.param(n, marks=pytest.mark.slow) for n in SCENES],
)
def test_gradients_of_float32_pictures_are_finite_and_near_those_of_float64(name):
    scene = SCENES[name]
    needs = st.needs(scene, free=("ks", "kgr"))
    loss = lambda s: jnp.mean(st.render(s, needs=needs, **SIZE) ** 2)
    gradients = [jax.grad(loss)(scene.astype(dtype)) for dtype in (jnp.float32, jnp.float64)]
    for single, double in zip(*map(jax.tree.leaves, gradients), strict=True):
        assert np.isfinite(single).all()
        if double.size:
            np.testing.assert_allclose(
                single, double, atol=2e-3 * float(jnp.abs(double).max()) + 1e-9
            )
