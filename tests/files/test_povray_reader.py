"""POV-Ray's language, read: round trips, other people's files, mistakes, and POV-Ray's pictures."""

import json
import re
import shutil
import subprocess
import warnings
from pathlib import Path

import jax
import numpy as np
import pytest
from helpers.scenes import SCENES, VIEWS, with_camera

import spheretrace_jax as st

FOLDER = Path(__file__).parents[2] / "data" / "references"
REFERENCES = json.loads((FOLDER / "references.json").read_text())

#: A file as people write it: names, expressions, a left-handed camera, comments in comments.
BY_HAND = """\
#version 3.7;
/* a comment /* in another */ still */
global_settings { assumed_gamma 1 }
#declare R = 0.5 + 0.25*2; // 1
#declare Lamp = rgb <1, 1, 1>;
camera { location <1, 2, -6> look_at <0, 0.5, 0> angle 40 right x }
background { color rgb <0.1, 0.2, 0.4> }
light_source { <5, 8, -4>, color Lamp*0.8 }
light_source { <-5, 4, -8> rgb 0.3 }
sphere { <0, R, 0>, R texture {
  pigment { color rgb <0.8, 0.2, 0.2> }
  finish { ambient 0.2 diffuse 0.7 phong 0.5 phong_size 30 reflection 0.1 }
} }
sphere { <1.5, 0.5, -0.5>, 0.5 pigment { rgb 0.5 } }
plane { y*2, -0.5 pigment { checker rgb 1, rgb <0.2, 0.3, 0.2>
  matrix <0.7,0,0, 0,0.7,0, 0,0,0.7, 0.1,-0.85,0.2> } }
"""
SMALL = "camera { location <0, 0, -9> right -x*image_width/image_height up y direction z }\n"
SMALL += "light_source { <0, 9, -9> rgb 1 }\nglobal_settings { ambient_light rgb 1 }\n"


def read(tmp_path, text):
    file = tmp_path / "scene.pov"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        scene = st.load_scene(file, np.float64)
    return scene, [str(w.message).removeprefix(f"{file}:") for w in said]


def written(tmp_path, scene, **options):
    st.write_povray(tmp_path / "written.pov", scene, **options)
    return (tmp_path / "written.pov").read_text()


def leaves(scene):
    """Returns a scene's numbers by name, without those that no picture shows or POV-Ray has not."""
    found = {
        jax.tree_util.keystr(path).removeprefix("."): np.asarray(leaf)
        for path, leaf in jax.tree_util.tree_leaves_with_path(scene)
    }
    for table in ("spheres", "planes"):
        shiny = found[f"{table}.ks"] > 0
        found[f"{table}.exponent"] = np.where(shiny, found[f"{table}.exponent"], 0)
    normal, square = found["planes.normal"], found["planes.checker_size"][:, None]
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    found["planes.normal"] = normal
    height = np.sum(found["planes.point"] * normal, axis=1, keepdims=True)
    found["planes.point"] = np.where(square > 0, found["planes.point"], height * normal)
    found["planes.checker_color"] = np.where(square > 0, found["planes.checker_color"], 0)
    return found


@pytest.mark.parametrize("reference", REFERENCES, ids=lambda reference: reference["name"])
def test_scenes_come_back_with_the_same_numbers(reference, tmp_path):
    scene = st.load_scene(FOLDER / f"{reference['name']}.txt", np.float64)
    options = {key: reference[key] for key in ("highlight", "bounces")}
    again, said = read(tmp_path, written(tmp_path, scene, **options))
    if (back := scene.back_plane) is not None:  # comes back as a plane
        assert len(again.planes) == 1
        np.testing.assert_array_equal(again.planes.color[0], back.color)
        return
    assert again.spheres.pic == scene.spheres.pic
    assert all("render with" in line for line in said)
    before, after = leaves(scene), leaves(again)
    before["spheres.kt"] = np.minimum(before["spheres.kt"], 1 - 2.0**-14)  # as is said in the file
    assert before.keys() == after.keys()
    for name, values in before.items():
        np.testing.assert_allclose(after[name], values, rtol=1e-12, atol=1e-12, err_msg=name)


@pytest.mark.parametrize("view", [v for v in VIEWS if not v.startswith("orthographic")])
def test_cameras_come_back(view, tmp_path):
    scene = with_camera(SCENES["diffuse"], **VIEWS[view])
    again = read(tmp_path, written(tmp_path, scene))[0]
    before, after = (x.camera.opencv((40, 30)) for x in (scene, again))
    for ours, theirs in zip(before, after, strict=True):
        np.testing.assert_allclose(theirs, ours, rtol=1e-12, atol=1e-9)


def test_lights_come_back(tmp_path):
    lights = st.Lights(
        [[100.0, 200, 300], [0, 3, 4], [50, 0, 700]], [[0.5, 0.25, 0.1]] * 3, (False, True, False),
        [850.0, 0, 0],
    )  # fmt: skip
    scene = st.Scene(SCENES["diffuse"].spheres, lights, SCENES["diffuse"].camera)
    again = read(tmp_path, written(tmp_path, scene))[0].lights
    assert again.directional == lights.directional
    np.testing.assert_allclose(again.position[1], [0, 0.6, 0.8])
    np.testing.assert_array_equal(again.position[::2], lights.position[::2])
    np.testing.assert_allclose(again.color, lights.color, rtol=1e-14)
    np.testing.assert_allclose(again.falloff, lights.falloff, rtol=1e-14)


@pytest.mark.skipif(shutil.which("povray") is None, reason="POV-Ray is not installed")
@pytest.mark.parametrize(
    "width",
    ["right x", pytest.param("right 1.5*x*image_width/image_height", marks=pytest.mark.slow)],
)
def test_picture_of_a_file_by_hand_is_that_of_povray(width, tmp_path):
    scene, said = read(tmp_path, BY_HAND.replace("right x", width))
    assert "z of the world is mirrored" in said[0]
    file, png = tmp_path / "scene.pov", tmp_path / "povray.png"
    command = ["povray", f"+I{file}", f"+O{png}", "+W32", "+H32", "-A", "-D", "+FN16"]
    subprocess.run([*command, "File_Gamma=1.0"], check=True, capture_output=True)
    theirs = st.read_image(png, colorspace="linear")
    ours = np.minimum(st.render(scene, width=32, height=32), 1)
    np.testing.assert_allclose(ours, theirs, atol=1e-5)


def test_a_file_by_hand(tmp_path):
    scene, said = read(tmp_path, BY_HAND)
    assert [line[:2] for line in said] == ["6:", "6:"]
    np.testing.assert_array_equal(scene.spheres.center, [[0, 1, 0], [1.5, 0.5, 0.5]])
    np.testing.assert_allclose(scene.spheres.ka, [0.2 / 0.55, 0.1 / 0.55])  # a mean of 0.55
    np.testing.assert_allclose(scene.lights.color[:, 0], [0.8, 0.3])
    assert float(scene.planes.checker_size[0]) == pytest.approx(0.7)


@pytest.mark.parametrize(
    "text, message",
    [
        ("box { <0, 0, 0>, <1, { } 1> }", "4: box: left out"),
        ("sphere { 0, 1 pigment { rgb 1 } no_shadow }", "4: no_shadow: the sphere casts"),
        ("sphere { 0, 1 interior { ior 1.5 } }", "4: ior 1.5: rays go straight on"),
        ("sphere { 0, 1 pigment { rgbt 0.5 } }", "4: a transparent sphere: its shadow is full"),
        ("sphere { 0, 1 no_image no_reflection }", "4: a sphere that only casts a shadow"),
        ("sphere { 0, 1 finish { specular 1 } }", "4: specular: render with --highlight blinn"),
        ("light_source { <0, 9, -9> rgb 1 spotlight radius 3 }", "4: spotlight: it shines"),
        ("light_source { 9 rgb 1 fade_distance 9 fade_power 1 }", "4: fade_power other than 2"),
        ('#include "colors.inc"', "4: #include"),
        ("#declare T = texture { pigment { rgb 1 } }", "4: T, a texture: left out"),
        ("light_source { 9 rgb <1, 0, 0> }", "3: ambient light of another colour"),
    ],
)  # fmt: skip
def test_what_is_not_carried_over_is_said_by_line(text, message, tmp_path):
    said = read(tmp_path, SMALL + text)[1]
    assert len(said) == 1 and said[0].startswith(message)


@pytest.mark.parametrize(
    "text, where, message",
    [
        ("", "1:1", "got an empty file"),
        ("// nothing", "1:11", "got an empty file"),
        ("background { rgb 0 }", "1:21", "expected a camera"),
        ("/* open /* */", "1:1", "this comment has no end"),
        (SMALL + "sphere { <0, 0, 0>, 0 }", "4:21", "greater than 0"),
        (SMALL + "sphere { <0, 0>, 1 }", "4:10", "three numbers, got 2"),
        (SMALL + "sphere { <0, 0, 1e999>, 1 }", "4:17", "must be finite"),
        (SMALL + "sphere { <0, 0, nan>, 1 }", "4:17", "a name declared before"),
        (SMALL + "sphere { 0, 1/0 }", "4:14", "division by 0"),
        (SMALL + "sphere { 0, 1e200*1e200 }", "4:18", "not finite"),
        (SMALL + "sphere { 0, 1 rotate x }", "4:15", "one of texture, pigment"),
        (SMALL + "sphere { 0, 1 finish { metallic } }", "4:24", "one of ambient"),
        (SMALL + "sphere { 0, 1 finish { phong 1 specular 1 } }", "4:32", "not both"),
        (SMALL + "sphere { 0, 1 pigment { Red } }", "4:25", "a name declared before"),
        (SMALL + "sphere { 0, 1 pigment { rgb 1 }", "4:8", "has no }"),
        (SMALL + "sphere { 0, 1 pigment { rgbt 1 } }", "4:25", "below 1"),
        (SMALL + "sphere { 0, 1 pigment { checker rgb 0 rgb 1 } }", "4:1", "only planes"),
        (SMALL + "plane { 0, 1 }", "4:9", "must not be 0 0 0"),
        (SMALL + "plane { x + y, 1 pigment { checker rgb 0 rgb 1 } }", "4:1", "squares here lie"),
        (SMALL + "plane { y, 1 pigment { checker rgb 0 rgb 1 } }", "4:1", "cut in their middle"),
        (SMALL + "#while (1) #end", "4:1", "expected one of #version"),
        (SMALL + "box { 0, 1", "4:5", "has no }"),
        (SMALL + "camera { }", "4:1", "given before, on line 1"),
        (SMALL + "#macro M() #end", "4:8", "macros are not read"),
        (SMALL + "sphere { " + "(" * 5000, "4:30", "brackets are open"),
        ("camera { location 0 look_at 0 }", "1:21", "must not be where"),
        ("camera { right y up y }", "1:1", "must be orthogonal"),
        (b"camera \x00", "1:8", "binary data"),
    ],
)  # fmt: skip
def test_mistakes_are_named_with_their_place(text, where, message, tmp_path):
    with pytest.raises(st.SceneError, match=message) as error:
        read(tmp_path, text)
    assert f"scene.pov:{where}: " in str(error.value) and "\n" not in str(error.value)


def test_truncated_files_are_read_or_refused(tmp_path):
    refused = 0
    for end in range(0, len(BY_HAND), 11):
        try:
            read(tmp_path, BY_HAND[:end])
        except st.SceneError as error:
            refused += 1
            assert re.match(r"[^\n]*scene\.pov:\d+:\d+: [^\n]+$", str(error))
    assert 30 < refused < len(BY_HAND) / 11
