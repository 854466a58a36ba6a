"""The command lines of docs/worlds.md: files of other programs, rendered and converted."""

import re
import shlex
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from helpers.commands import python, spheretrace

import spheretrace_jax as st

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "worlds.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^    (spheretrace .*)$", PAGE, re.MULTILINE)


@pytest.fixture(scope="module")
def flake(tmp_path_factory):
    """Writes the sphere flake of size factor 1 as the page says, and changes to its folder."""
    folder = tmp_path_factory.mktemp("flake")
    made = python(str(ROOT / "data" / "make_sphere_flake.py"), "1", folder=folder)
    (folder / "flake.nff").write_text(made.stdout)
    return folder


@pytest.mark.parametrize("line", [line for line in COMMANDS if "convert" in line])
def test_conversions(line, flake, monkeypatch):
    monkeypatch.chdir(flake)
    status, out, err = spheretrace(*shlex.split(line)[1:])
    assert status == 0 and "render it with" in out
    assert PAGE.count("    flake.nff:14: polygon: the whole plane, without edges") == 1
    assert err.startswith("spheretrace: warning: flake.nff:14: polygon: the whole plane, without")
    name = shlex.split(line)[-1]
    if name.endswith(".xml"):
        assert len(ElementTree.parse(name).getroot().findall("shape")) == 11
        assert "flake.nff: spheres 1, 2, 3, 4, 5 and 5 more: highlights: left out" in err
        return
    scenes = [st.load_scene(file, np.float64) for file in ("flake.nff", name)]
    before, after = (np.asarray(scene.spheres.center) for scene in scenes)
    np.testing.assert_allclose(after, before, rtol=1e-14)


@pytest.mark.slow
def test_picture(flake, monkeypatch):
    monkeypatch.chdir(flake)
    (line,) = (line for line in COMMANDS if "render" in line)
    assert spheretrace(*shlex.split(line)[1:], "--size", "32x32")[0] == 0
    small = st.read_image("flake.png")
    # the page's picture is that of four generations: alike in the whole, not in pixels
    page = st.read_image(ROOT / "docs" / "flake.png").reshape(32, 16, 32, 16, 3).mean(axis=(1, 3))
    assert np.abs(small - page).mean() < 0.1 < np.ptp(small)


def test_mistakes_end_in_one_line_and_write_nothing(flake, monkeypatch):
    monkeypatch.chdir(flake)
    Path("broken.nff").write_text("v\nfrom 1 2\n")
    status, out, err = spheretrace("convert", "broken.nff", "broken.pov")
    assert status == 2 and not out and not Path("broken.pov").exists()
    assert err == "spheretrace: broken.nff:3:1: expected Z, a number, got the end of the file\n"


def test_size_factors_out_of_range_are_refused(tmp_path):
    for words in ([], ["7"], ["-1"], ["two"]):
        made = python(str(ROOT / "data" / "make_sphere_flake.py"), *words, folder=tmp_path)
        assert made.returncode == 1 and made.stderr.startswith("usage: ") and not made.stdout
