"""The tables of formats: every entry reads or writes."""

import numpy as np
import pytest
from helpers.scenes import SCENES

import spheretrace_jax as st
from spheretrace_jax.files import formats
from spheretrace_jax.files.picture_formats import PICTURE_FORMATS


@pytest.mark.parametrize("ending", PICTURE_FORMATS)
def test_every_picture_format_is_written_in_all_its_bits(ending, tmp_path):
    picture = np.random.default_rng(0).uniform(0.1, 0.9, (5, 7, 3)).astype(np.float32)
    for bits in PICTURE_FORMATS[ending].bits:
        file = tmp_path / f"picture{ending}"
        st.write_image(file, picture, bits=bits)
        assert st.read_image(file).shape == picture.shape
    with pytest.raises(st.PictureError, match=f"{ending} files have"):
        st.write_image(tmp_path / f"picture{ending}", picture, bits=7)


@pytest.mark.parametrize("ending", formats.EXPORT_FORMATS)
def test_every_export_format_is_written(ending, tmp_path):
    exported, file = formats.EXPORT_FORMATS[ending], tmp_path / f"scene{ending}"
    exported.write(file, SCENES["diffuse"], highlight="phong", bounces=1, scene_path="scene.txt")
    assert file.stat().st_size > 0 and str(file) in exported.usage.format(file=file)


def test_the_ending_chooses_the_reader_and_others_are_scene_text(tmp_path, monkeypatch):
    st.save_scene(tmp_path / "scene.any", SCENES["diffuse"])
    assert len(formats.load_scene(tmp_path / "scene.any", np.float64).spheres) == 3
    monkeypatch.setitem(formats.READERS, ".made", lambda path, dtype: SCENES["mirrors"])
    assert formats.load_scene(tmp_path / "none.MADE") is SCENES["mirrors"]
