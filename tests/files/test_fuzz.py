"""Broken files: a sample of those of the catalogue (extremes/files.py)."""

import numpy as np
import pytest
from helpers.fuzz import SCENES, TEXTURES, fuzz_pictures, fuzz_scenes, good_pictures, is_sane

import spheretrace_jax as st


@pytest.mark.parametrize("name", SCENES)
def test_scenes_are_good_before_they_are_broken(name, tmp_path):
    for texture in TEXTURES:
        st.write_image(tmp_path / texture, np.full((2, 3, 3), 0.5))
    (tmp_path / "scene.txt").write_text(SCENES[name])
    is_sane(st.load_scene(tmp_path / "scene.txt"), tmp_path / "again.txt")


def test_pictures_are_good_before_they_are_broken(tmp_path):
    for name in good_pictures(tmp_path):
        assert st.read_image(tmp_path / name).shape == (6, 5, 3)


def test_broken_scenes_are_read_or_refused():
    tally = fuzz_scenes(150)
    assert tally.read > 3 and tally.refused > 50  # both happen


def test_broken_pictures_are_read_or_refused():
    tally = fuzz_pictures(0, 150)
    assert tally.read > 3 and tally.refused > 50
