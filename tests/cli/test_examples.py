"""The examples run, at low resolution, and do what they say."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import spheretrace_jax as st

EXAMPLES = Path(__file__).parents[2] / "examples"


def run(name: str, *arguments: str, folder: Path) -> str:
    command = [sys.executable, str(EXAMPLES / name), *arguments]
    done = subprocess.run(
        command,
        cwd=folder,
        capture_output=True,
        text=True,
        env={**os.environ, "JAX_PLATFORMS": "cpu"},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_example_has_a_test():
    text = Path(__file__).read_text()
    assert all(f'"{path.name}"' in text for path in EXAMPLES.glob("*.py"))


@pytest.mark.slow
def test_render_scene(tmp_path):
    said = run("render_scene.py", "--size", "48", folder=tmp_path)
    picture = st.read_image(tmp_path / "bowl.png")
    assert picture.shape == (48, 48, 3) and 0.05 < picture.mean() < 0.7
    assert "d mean / d kd" in said


@pytest.mark.slow
def test_fit_picture(tmp_path):
    said = run("fit_picture.py", "--size", "40", folder=tmp_path)
    assert "converged after" in said
    found = {k: float(v) for k, v in re.findall(r"(\S+) +largest error (\S+)", said)}
    assert max(found["ka*color"], found["kd*color"], found["ks"]) < 1e-8
    assert found["light_position"] < 1e-5
    assert np.isfinite(list(found.values())).all()


@pytest.mark.slow
def test_optax_loop(tmp_path):
    said = run("optax_loop.py", "--steps", "120", folder=tmp_path)
    errors = [float(x) for x in re.findall(r"error (\S+)", said)]
    assert len(errors) == 4 and errors[-1] < 0.02 * errors[0]


@pytest.mark.slow
def test_several_devices(tmp_path):
    said = run("several_devices.py", "--size", "24", "--devices", "4", folder=tmp_path)
    rows = re.findall(r"has rows (\d+)\.\.(\d+)", said)
    assert rows == [("0", "5"), ("6", "11"), ("12", "17"), ("18", "23")]
    assert "converged after" in said
    same, off = re.findall(r"(?:same to|off by) (\S+)", said)
    assert float(same) < 1e-12 and float(off) < 1e-8


@pytest.mark.slow
def test_fit_geometry(tmp_path):
    said = run("fit_geometry.py", "--size", "40", folder=tmp_path)
    assert "converged after" in said and "NOT" not in said
    found = {k: float(v) for k, v in re.findall(r"(\S+) +largest error (\S+)", said)}
    assert set(found) == {"center", "radius", "light_position"} and max(found.values()) < 1e-8
    assert st.read_image(tmp_path / "fit_geometry.png").mean() > 0.1


@pytest.mark.slow
def test_light_of_ball(tmp_path):
    said = run("light_of_ball.py", "--fit", folder=tmp_path)
    off = [float(x) for x in re.findall(r"([\d.]+) degrees off the truth", said)]
    assert len(off) == 4 and max(off) < 0.6
    assert "free: color, ka, kd, ks, exponent, ior, light_position" in said
