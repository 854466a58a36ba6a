"""Mitsuba's XML: its pictures where the models are the same, and what is said of the others."""

import warnings
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from helpers.scenes import SCENES

import spheretrace_jax as st
from spheretrace_jax.files.mitsuba import mitsuba_text

SUN = st.Lights([[2.0, 1, 3]], directional=True)
LAMP = st.Lights([[3.0, 2, 4]], falloff=5.0)
FLOOR = st.Planes(
    [[0.0, 0, -1]], [[0, 0, 1.0]], [[0.8, 0.7, 0.5]], ka=0.0, kd=0.7, ks=0.0,
    checker_color=[[0.1, 0.2, 0.3]], checker_size=0.7,
)  # fmt: skip
ASIDE = dict(roll=0.4, look_at=[0.2, 0.1, 0], principal_point=[0.1, -0.2])


def matt(lights=SUN, planes=None, view=None, **material) -> st.Scene:
    center = [[0.0, 0, 0], [1.5, 0.5, 0.3], [-0.8, -1, 0.8]]
    color = [[0.9, 0.2, 0.1], [0.2, 0.8, 0.3], [0.3, 0.4, 1]]
    material = {"ka": 0.0, "kd": [0.8, 0.5, 0.6], "ks": 0.0, **material}
    camera = st.Camera(0.5, 1.0, 6.0, 6.0, 4.5, **(view or {}))
    return st.Scene(st.Spheres(center, [1.0, 0.5, 0.4], color, **material), lights, camera, planes)


#: Scenes whose picture Mitsuba's is, and the part by which edges and noise may differ.
SAME = {
    "sun": (matt(), 0.05),
    "lamp": (matt(LAMP), 0.05),
    "floor": (matt(LAMP, FLOOR), 0.06),
    "aside": (matt(view=ASIDE), 0.07),
    "orthographic": (matt(view=dict(orthographic=True, **ASIDE)), 0.07),
    "mirrors": (matt(kd=0.2, kgr=[0.5, 0, 0.3]), 0.06),
    "bubbles": (matt(kd=[0.1, 0.2, 0.3], kt=[0.3, 0, 0.2], kgr=[0.1, 0, 0]), 0.1),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SAME)
def test_picture_is_mitsubas_where_models_are_the_same(name, tmp_path):
    mitsuba = pytest.importorskip("mitsuba", reason="Mitsuba is not installed (extra bench)")
    mitsuba.set_variant("scalar_rgb")
    scene, tolerance = SAME[name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        st.write_mitsuba(tmp_path / "scene.xml", scene, bounces=3)
    spp = 512 if name in ("mirrors", "bubbles") else 128
    loaded = mitsuba.load_file(str(tmp_path / "scene.xml"), width=32, height=32, spp=spp)
    theirs = np.array(mitsuba.render(loaded))
    ours = np.asarray(st.render(scene, width=32, height=32, bounces=3, samples=4))
    assert np.linalg.norm(theirs - ours) < tolerance * np.linalg.norm(ours)
    assert theirs.mean() == pytest.approx(ours.mean(), rel=0.01)
    # inside of objects and away from edges nothing but rounding is left, without random paths
    if name in ("sun", "lamp", "orthographic"):
        assert np.median(np.abs(theirs - ours)[ours > 0]) < 2e-3


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_is_xml_or_refused(name):
    try:
        text, _ = mitsuba_text(SCENES[name])
    except st.SceneError as error:
        assert "must add up to at most 1" in str(error)
        return
    root = ElementTree.fromstring(text)
    scene = SCENES[name]
    assert len(root.findall("shape")) == scene.objects
    lights = [e for e in root.findall("emitter") if e.get("type") != "constant"]
    assert len(lights) == len(scene.lights)
    assert "nan" not in text and '"inf' not in text


@pytest.mark.parametrize(
    "changes, message",
    [
        (dict(ka=0.2), "spheres 1, 2, 3: ambient light: left out"),
        (dict(ks=[0, 0.1, 0]), "sphere 2: highlights: left out"),
        (dict(ior=1.5), "coats"),
        (dict(lights=st.Lights([[9.0, 9, 9]])), "light 1: the inverse-square law"),
        (dict(planes=FLOOR), "planes: squares with sides of"),
        (dict(kd=0.2, kgr=0.5), "path tracer adds light"),
        (dict(view=dict(principal_point=[0.1, 0])), "camera: that of a square picture"),
    ],
)  # fmt: skip
def test_what_is_not_exact_is_said_and_written(changes, message, tmp_path):
    with pytest.warns(st.SceneWarning, match=message) as said:
        st.write_mitsuba(tmp_path / "out.xml", matt(**changes), scene_path="/a/in.txt")
    assert len(said) == 1 and str(said[0].message).startswith("in.txt: ")
    assert f"<!-- not exact: {str(said[0].message)[8:]} -->" in (tmp_path / "out.xml").read_text()


def test_nothing_is_said_where_all_is_the_same(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        st.write_mitsuba(tmp_path / "out.xml", matt(LAMP))


@pytest.mark.parametrize(
    "changes, message",
    [
        (dict(view=dict(pixel_aspect=1.5)), "square pixels"),
        (dict(kd=0.9, kgr=0.5), "sphere 1 reflects and transmits more"),
    ],
)
def test_what_mitsuba_refuses_is_refused_here(changes, message, tmp_path):
    with pytest.raises(st.SceneError, match=message):
        st.write_mitsuba(tmp_path / "out.xml", matt(**changes))
    assert not (tmp_path / "out.xml").exists()
