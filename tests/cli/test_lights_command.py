"""`spheretrace lights`: what it prints and writes, and what it says of mistakes."""

import re
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import spheretrace

import spheretrace_jax as st
from spheretrace_jax.calibration.light_files import read_lights, read_lp, read_rows

BALL = Path(__file__).parents[2] / "data" / "ball"
FOCAL = ("--focal", "420", "--no-cache")


def test_lights_are_printed_and_written(tmp_path):
    files = [tmp_path / name for name in ("lights.csv", "lights.lp", "light_directions.txt")]
    outputs = [word for file in files for word in ("-o", file)]
    more = ("--intensities", tmp_path / "i.txt", "--page", tmp_path / "page.html")
    photos = (BALL / "near.png", BALL / "side.png")
    status, out, _ = spheretrace(
        "lights", *photos, "--linear", *FOCAL, *outputs, *more, "--scenes", tmp_path
    )
    assert status == 0
    assert re.search(r"near: \(\+0\.44\d*, \+0\.5\d*, \+0\.7\d*\) \+- \d", out)
    lights = read_lights(files[0])
    truth = {light["name"]: light for light in read_lights(BALL / "lights.csv")}
    for light in lights:
        true = truth[light["name"]]
        assert np.degrees(np.arccos(light["direction"] @ true["direction"])) < 0.6
        assert light["least_distance"] < true["distance"] < light["most_distance"]
        assert light["grade"] == "good" and light["color"].shape == (3,)
    names, directions = read_lp(files[1])
    assert names == ["near", "side"]
    np.testing.assert_allclose(directions, [light["direction"] for light in lights], atol=1e-8)
    np.testing.assert_allclose(read_rows(files[2]), directions, atol=1e-8)
    assert read_rows(tmp_path / "i.txt").shape == (2, 3)
    page = (tmp_path / "page.html").read_text()
    assert page.count("data:image/png;base64,") == 2 and "http" not in page.replace("http-", "")
    scene = st.load_scene(tmp_path / "near.txt")
    assert len(scene.spheres) == 1 and len(scene.lights) == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "expected --focal, the camera's focal length in pixels, or --orthographic"),
        (("--focal", "420", "--orthographic"), "expected --focal"),
        (("--focal", "-1"), "focal: expected a positive length in pixels, got -1"),
        ((*FOCAL, "--linear", "--srgb"), "expected --linear or --srgb, got both"),
        (
            (*FOCAL, "-o", "lights.json"),
            "lights.json: expected a name that ends in .csv, .lp, .txt",
        ),
        ((*FOCAL, "--ball", "1,2,x"), "--ball: expected 3 numbers with commas, got '1,2,x'"),
        ((*FOCAL, "--principal-point", "1"), "--principal-point: expected 2 numbers with commas"),
        ((*FOCAL, "--ball", "80,60,-5"), "radius: expected a positive number of pixels, got -5"),
        ((*FOCAL, "--albedo", "0,1,1"), "albedo: expected three numbers above 0"),
        ((*FOCAL, "--radius", "0"), "radius: expected a length above 0, got 0"),
        ((*FOCAL, "--chrome", "--scenes", "x"), "--scenes: of a chrome ball no scene is made"),
        ((*FOCAL, "--brightest", "0"), "near: expected 50 pixels of the ball"),
    ],
)
def test_mistakes_are_one_line(words, message):
    status, out, err = spheretrace("lights", BALL / "near.png", *words)
    assert status == 2 and out == ""
    line = [line for line in err.splitlines() if "warning" not in line]
    assert len(line) == 1 and re.search(message, line[0]), err


def test_a_missing_photograph_is_one_line(tmp_path):
    status, _, err = spheretrace("lights", tmp_path / "none.png", *FOCAL)
    assert status == 2 and "none.png" in err and len(err.splitlines()) == 1
