"""Studies: references, times, figures and captions."""

import csv
import importlib
import itertools
import math

import jax
import numpy as np
import pytest
from helpers.commands import spheretrace, workplace
from helpers.derivatives import off
from helpers.scenes import three_apart, three_spheres

import spheretrace_jax as st
from spheretrace_jax.display.study_report import write_study
from spheretrace_jax.scene.settings import render_settings
from spheretrace_jax.study.benchmarks.captions import caption
from spheretrace_jax.study.benchmarks.fits import displaced, solvers
from spheretrace_jax.study.benchmarks.reference import fibonacci, lattice, reference_picture
from spheretrace_jax.study.benchmarks.scale import cloud, lit_by, mirroring
from spheretrace_jax.study.benchmarks.settings import Settings
from spheretrace_jax.study.benchmarks.work_precision import Diagram, Point, clock, slope
from spheretrace_jax.study.study import Study, machine, study

LIGHT = [900.0, -400, 700]
TINY = dict(
    bounces=0, size=16, rays=(1, 2, 4), covered=(1,), steps=(0.3,), truth_rays=600, fit_size=16,
    fit_seconds=2.0, sides=(8, 16, 32), counts=(3, 6), lights=(1, 2),
    depths=(0, 1), thorough=False, seconds=0.01,
)  # fmt: skip


def points(method: str, times: list[float], errors: list[float]) -> list[Point]:
    return [
        Point("made", method, f"{k} x {k}", float(k), "float64", t, 0.5, e, 10**6 * k)
        for k, (t, e) in enumerate(zip(times, errors, strict=True), 1)
    ]


MADE = Diagram(
    "made", "Two methods", "error", "known", 1e-7, (
        *points("slow", [0.1, 0.4, 1.6], [1e-2, 5e-3, 2.5e-3]),
        *points("fast", [0.01, 0.04], [4e-3, 1e-5]),
    ),
)  # fmt: skip
GROWTH = Diagram(
    "grown", "Time", "", "alone", math.nan,
    tuple(points("picture", [1.0, 4.0, 9.0, 16.0], [math.nan] * 4)), "spheres",
)  # fmt: skip


def test_lattices_fill_the_square_evenly():
    count, step = fibonacci(600)
    assert count == 610 and step == 377
    x, y = np.asarray(lattice(count, step)).T
    assert ((x > 0) & (x < 1) & (y > 0) & (y < 1)).all()
    # of the area of a box so many points, give or take a few
    for a, b in itertools.product((0.3, 0.5, 0.81), repeat=2):
        assert abs(np.sum((x < a) & (y < b)) - count * a * b) < 4


def test_the_truth_is_what_many_rays_see():
    scene = three_spheres()
    seen = dict(width=16, height=16, bounces=0)
    truth = reference_picture(scene, render_settings(scene, **seen), 2000)(scene)
    assert off(st.render(scene, samples=48, **seen), np.asarray(truth)) < 2e-3


def test_times_are_medians_of_interleaved_runs():
    runs = []
    taken = clock({name: lambda name=name: runs.append(name) for name in "ab"}, 1e-3)
    assert runs[:8] == list("ab") * 4  # the first ones do not count
    assert set(taken) == set("ab")


def test_exponents_are_fitted():
    assert slope([(x, 3 * x**1.5) for x in (1.0, 2.0, 5.0)]) == pytest.approx(1.5)
    assert math.isnan(slope([(1.0, 2.0)])) and math.isnan(slope([]))


def test_two_sentences_say_how_methods_compare():
    assert caption(MADE) == (
        "An error of 3e-03 takes 40 ms with fast (2 x 2), 1.6 s with slow (3 x 3).",
        "The least error is 1.0e-05, of fast (2 x 2) in 40 ms; "
        "the truth itself is known to 1.0e-07.",
    )
    assert caption(GROWTH) == (
        "At the large end the time of a picture grows as (spheres)^2.00.",
        "With 4 x 4 a picture takes 16 s and 4 MB of temporaries.",
    )


def test_a_study_is_written_as_a_page_figures_and_a_table(tmp_path):
    made = Study((MADE, GROWTH), machine(), Settings(seed=7))
    files = write_study(tmp_path / "new", made)
    assert {f.name for f in files} == {
        "study.md", "points.csv", "made.png", "made.svg", "grown.png", "grown.svg",
    }  # fmt: skip
    assert all(f.stat().st_size > 100 for f in files)
    rows = list(csv.DictReader((tmp_path / "new" / "points.csv").open()))
    assert len(rows) == 9
    assert rows[0]["jax"] == jax.__version__ and rows[0]["seed"] == "7"
    assert float(rows[4]["error"]) == 1e-5
    page = (tmp_path / "new" / "study.md").read_text()
    for diagram in (MADE, GROWTH):
        assert " ".join(caption(diagram)) in page and f"({diagram.name}.png)" in page


@pytest.mark.slow
def test_pictures_are_compared_with_the_truth():
    ball = st.Spheres([[0.0, 0, 0]], [200.0])  # has neither shadows nor crossings to compile
    scene = st.Scene(ball, st.Lights([LIGHT]))
    (diagram,) = study(scene, parts=["picture"], **TINY).diagrams
    errors = {name: [p.error for p in curve] for name, curve in diagram.curves.items()}
    assert len(errors) == 3
    rays, covered = errors["single rays, float32"], errors["covered edges, float32"]
    assert rays[0] > rays[1] > rays[2] > diagram.uncertainty
    assert covered[0] < rays[0] / 4
    assert errors["single rays, float64"] == pytest.approx(rays[:1], rel=1e-3)
    assert all(p.seconds > 0 and p.compile_seconds > 0 for p in diagram.points)


@pytest.mark.slow
def test_a_whole_study_of_a_small_scene():
    told = []
    found = study(three_apart(LIGHT), say=lambda *text: told.append(text), **TINY)
    names = [d.name for d in found.diagrams]
    assert names[:4] == ["picture", "derivative", "derivative_sum", "fit"] and len(names) == 8
    assert {part for part, _ in told} == {"picture", "derivative", "fit", "scale"}
    curves = {d.name: d.curves for d in found.diagrams}
    derived = curves["derivative"]
    assert derived["single rays, forward mode"][0].error > 0.5
    assert derived["covered edges, forward mode"][0].error < 0.5
    assert set(curves["fit"]) == set(solvers(thorough=False))
    ours = curves["fit"]["ours"]
    assert ours[0].error > 0.05 and ours[-1].error < 1e-9


def test_the_start_of_fits_is_wrong_in_all_that_is_fitted():
    truth = three_apart(LIGHT)
    start = displaced(truth)
    assert start.spheres.kd[0] == pytest.approx(0.9 * truth.spheres.kd[0])
    assert np.linalg.norm(start.lights.position) > 1.1 * np.linalg.norm(truth.lights.position)
    np.testing.assert_array_equal(start.spheres.center, truth.spheres.center)


def test_sweeps_change_one_thing():
    scene = three_apart(LIGHT)
    many = cloud(scene, 50)
    assert len(many.spheres) == 50
    volume = lambda s: float(np.sum(s.spheres.radius**3))
    assert 0.3 < volume(many) / volume(scene) < 3
    lights = lit_by(scene, 4).lights
    np.testing.assert_allclose(np.asarray(lights.color).sum(0), 1)
    far = np.linalg.norm(lights.position, axis=1)
    np.testing.assert_allclose(far, np.linalg.norm(LIGHT))
    assert st.needs(mirroring(scene)).reflection and not st.needs(scene).reflection


@pytest.mark.parametrize("parts", [["picture", "speed"], []])
def test_parts_that_there_are_not_are_refused(parts):
    with pytest.raises(st.InputError, match="must be among picture, derivative, fit, scale, got"):
        study(three_spheres(), parts=parts)


def test_the_command_studies_a_scene_and_says_what_it_wrote(monkeypatch):
    asked = {}

    def made(scene, **settings):
        asked.update(settings, spheres=len(scene.spheres), dtype=scene.dtype)
        return Study((MADE, GROWTH), machine(), Settings())

    monkeypatch.setattr(importlib.import_module("spheretrace_jax.study.study"), "study", made)
    with workplace() as folder:
        status, out, err = spheretrace(
            "study", "scene.txt", "--report", "new/report", "--quick", "--parts", "picture, fit",
            "--seed", 3,
        )  # fmt: skip
        assert (status, err) == (0, "")
        written = [line.strip() for line in out.splitlines()[1:]]
        assert "new/report/study.md" in written and all((folder / f).is_file() for f in written)
    del asked["say"]
    assert asked == dict(
        parts=("picture", "fit"), quick=True, seed=3, highlight="phong", spheres=2,
        dtype=np.float64,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["scene.txt", "--report", "scene.txt"], "expected a folder to write to, this is a file"),
        (["scene.txt", "--report", "new", "--parts", "speed"], "must be among picture, derivative"),
        (["scene.txt", "--report", "new", "--bounces", "-1"], "--bounces must be at least 0"),
        (["none.txt", "--report", "new"], "none.txt: cannot read the scene: No such file"),
    ],
)
def test_mistakes_of_the_command_are_one_line(words, said):
    with workplace() as folder:
        status, _, err = spheretrace("study", *words)
        assert status == 2 and err.startswith("spheretrace: ") and err.count("\n") == 1
        assert said in err
        assert not (folder / "new").exists()
