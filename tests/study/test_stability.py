"""Float32 against float64, of scenes with a known cause of errors."""

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import SCENES

import spheretrace_jax as st

SIDE = 16
SIZE = dict(width=SIDE, height=SIDE, bounces=0)
COLUMN, ROW = 10, 9


def ball(radius=100.0, eye=(0.0, 0.0), window=512.0, light=(300.0, 200, 600), n=5.0, unit=1.0):
    """Builds a sphere at the origin, by default seen along -z from a distance of 5 radii."""
    sphere = st.Spheres(
        [[0.0, 0, 0]], [radius * unit], (0.8, 0.5, 0.3), ka=0.2, kd=0.6, ks=0.3, exponent=n
    )
    camera = st.Camera(*eye, 500.0 * unit, 800.0 * unit, window * unit)
    return st.Scene(sphere, st.Lights(np.multiply([light], unit)), camera)


def touching() -> float:
    """Returns the radius of the sphere at the origin that the ray of a pixel touches."""
    pitch = 512 / SIDE
    across = np.hypot(COLUMN + 0.5 - SIDE / 2, ROW + 0.5 - SIDE / 2) * pitch
    return 500 * across / np.hypot(across, 800)


def shaded(off: float) -> st.Scene:
    """Builds a small sphere over a large one, whose shadow edge passes the hit of a pixel's ray.

    **Arguments:** `off`: the distance of the edge from the hit, per radius of the small sphere.
    """
    pitch, radius, below = 512 / SIDE, 20.0, np.array([0.0, 0, -2000])
    x, y = (COLUMN + 0.5 - SIDE / 2) * pitch, -(ROW + 0.5 - SIDE / 2) * pitch
    eye, ray = np.array([0.0, 0, 500]), np.array([-y, x, -800]) / np.linalg.norm([x, y, 800])
    along = np.dot(below - eye, ray)
    foot = below - eye - along * ray
    seen = eye + ray * (along - np.sqrt(1900**2 - foot @ foot))
    light = np.add(seen, [3000.0, 0, 4000])
    middle = np.add(seen, [300.0, radius * (1 + off), 400])
    spheres = st.Spheres([below, middle], [1900.0, radius], ka=0.2, kd=0.6)
    return st.Scene(spheres, st.Lights([light]), st.Camera(0.0, 0.0, 500.0, 800.0))


CASES = {
    "a silhouette through a pixel": (ball(touching() * (1 - 1e-9)), "silhouette tie"),
    "a pixel just inside of it": (ball(touching() * (1 + 1e-9)), "grazing"),
    "an exponent of 1e5": (ball(n=1e5, light=(0.0, 0, 900), window=4.0), "highlight exponent"),
    "a sphere at 50,000 radii": (ball(0.01, eye=(0.3, 0.4), window=0.05), "cancellation"),
    "lengths of 1e20": (ball(unit=1e18), "overflow"),
}


@pytest.mark.parametrize("case", CASES)
def test_the_cause_is_found(case):
    scene, cause = CASES[case]
    table = st.check_stability(scene, limit=1e-5, **SIZE)
    assert table.rows and table.shown >= len(table.rows)
    assert list(table.counts) == [cause]
    assert all(row.object == "sphere 1" and row.bounce == 0 for row in table.rows)
    assert len(table.warnings) == 1 and "sphere 1" in table.warnings[0]
    assert cause in str(table)


def test_the_rows_are_what_the_pictures_differ_by():
    scene, _ = CASES["a silhouette through a pixel"]
    table = st.check_stability(scene, **SIZE)
    single, double = (
        np.asarray(st.render(scene.astype(dtype), **SIZE), np.float64)
        for dtype in (jnp.float32, jnp.float64)
    )
    error = np.abs(single - double).max(-1)
    assert (COLUMN, ROW) in [(row.column, row.row) for row in table.rows]
    assert table.shown == np.count_nonzero(error > 1e-4 * double.max()) == len(table.rows)
    assert table.largest == error.max() == table.rows[0].error
    assert table.median == np.median(error[error > 0])
    assert table.share == table.shown / SIDE**2 and not table.ok
    for row in table.rows:
        assert row.error == error[row.row, row.column]
        ulp = np.spacing(np.float32(double[row.row, row.column].max() or double.max()))
        assert row.ulps == row.error / ulp


def test_factors_are_those_of_the_formulas():
    worst = {case: st.check_stability(CASES[case][0], **SIZE).rows[0].factor for case in CASES}
    np.testing.assert_allclose(worst["an exponent of 1e5"], 1e5, rtol=0.01)  # R.V is near 1
    np.testing.assert_allclose(worst["a sphere at 50,000 radii"], 5e4, rtol=1e-6)


def test_a_scene_without_trouble_has_none():
    table = st.check_stability(ball(), **SIZE)
    assert table.ok and table.shown == 0 and table.rows == () == table.warnings
    assert 0 < table.median <= table.largest < 1e-5


def test_a_shadow_s_edge_through_a_pixel_is_a_tie():
    # by 1e-8 of a radius each: sooner or later float32 is on the other side
    tables = [st.check_stability(shaded(i * 1e-8), **SIZE) for i in range(-3, 4)]
    rows = [row for table in tables for row in table.rows]
    assert rows
    for row in rows:
        assert (row.column, row.row, row.cause) == (COLUMN, ROW, "silhouette tie")
        assert row.object == "the shadow of sphere 2"
    assert st.check_stability(shaded(0.01), **SIZE).ok


@pytest.mark.slow
def test_mirrors_multiply_the_rounding_of_rays():
    table = st.check_stability(SCENES["inside"], width=SIDE, height=SIDE, bounces=3, limit=1e-6)
    assert next(iter(table.counts)) == "mirrors"
    rows = [row for row in table.rows if row.cause == "mirrors"]
    assert all(row.bounce >= 1 and row.factor > 30 for row in rows)
    assert max(row.factor for row in rows if row.bounce == 3) > 300
    assert not table.counts.keys() & {"cancellation", "overflow", "highlight exponent"}
