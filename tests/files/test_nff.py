"""NFF, read: its grammar, its camera and lights, what becomes of polygons, and broken files."""

import re
import warnings
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.commands import python

import spheretrace_jax as st
from spheretrace_jax.base.vec import components
from spheretrace_jax.scene.camera import pixel_rays
from spheretrace_jax.tracing.plain import plain_picture

VIEW = """\
v
from 2.1 1.3 1.7
at 0 0 0.1
up 0 0 1
angle 45
hither 0.1
resolution 32 32
"""
SCENE = f"""\
# a comment
{VIEW}b .1 .2 .3
l 4 3 2
l 1 -4 4 0.5 0.25 1 # coloured
f 1 0.75 0.33 0.8 0 0 0 0
p 4
12 12 -0.5  -12 12 -0.5
-12 -12 -0.5
12 -12 -0.5
f 1 0.9 0.7 0.5 0.25 15 0.5 1
s 0 0 0 0.5
s 0.6 0 0 .1#touches
"""


def read(tmp_path, text, dtype=np.float64):
    file = tmp_path / "scene.nff"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        scene = st.load_scene(file, dtype)
    return scene, [str(w.message).removeprefix(f"{file}:") for w in said]


def test_every_entity(tmp_path):
    scene, said = read(tmp_path, SCENE)
    s, p = scene.spheres, scene.planes
    np.testing.assert_array_equal(s.center, [[0, 0, 0], [0.6, 0, 0]])
    np.testing.assert_array_equal(s.radius, [0.5, 0.1])
    np.testing.assert_array_equal(s.color, [[1, 0.9, 0.7]] * 2)
    for table, material in ((s, (0, 0.5, 0.25, 15, 0.25)), (p, (0, 0.8, 0, 0, 0))):
        got = [np.asarray(getattr(table, n))[0] for n in ("ka", "kd", "ks", "exponent", "kgr")]
        assert got == list(material)
    np.testing.assert_array_equal(s.kt, 0.5)
    np.testing.assert_array_equal(p.point, [[12, 12, -0.5]])
    np.testing.assert_allclose(p.normal, [[0, 0, 1]])
    np.testing.assert_allclose(scene.lights.color, [[0.5**0.5] * 3, [0.5, 0.25, 1]])
    np.testing.assert_allclose(scene.background, [0.1, 0.2, 0.3])
    assert said == ["13: polygon: the whole plane, without edges"]


@pytest.mark.parametrize("up", [(0, 0, 1), (1, -2, 0.5)])
def test_camera_by_its_definition(up, tmp_path):
    view = VIEW.replace("up 0 0 1", "up {} {} {}".format(*up)).replace("32 32", "32 20")
    camera = read(tmp_path, view)[0].camera
    columns, rows = jnp.array([[15.5, 16, 31.5]]), jnp.array([[0.5], [10], [19.5]])
    rays = pixel_rays(camera, columns, rows, (32, 20))
    origin, d = (
        np.stack([np.broadcast_to(x, (3, 3)) for x in components(v)], axis=-1)
        for v in (rays.origin, rays.direction)
    )
    eye, at = np.array([2.1, 1.3, 1.7]), np.array([0, 0, 0.1])
    np.testing.assert_allclose(origin[0, 0], eye)
    forward = (at - eye) / np.linalg.norm(at - eye)
    np.testing.assert_allclose(d[1, 1], forward, atol=1e-14)
    # between the centres of the top and the bottom row
    assert np.degrees(np.arccos(d[0, 1] @ d[2, 1])) == pytest.approx(45)
    assert d[0, 1] @ np.array(up) > d[2, 1] @ np.array(up)
    assert np.linalg.det([d[1, 2] - d[1, 1], d[0, 1] - d[1, 1], -forward]) > 0, "mirrored"


@pytest.mark.parametrize("bounces", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_picture_is_that_of_the_plain_path_tracer(bounces, tmp_path):
    scene = read(tmp_path, SCENE)[0]
    ours = st.render(scene, width=24, height=24, bounces=bounces)
    plain = plain_picture(scene, width=24, height=24, bounces=bounces)
    np.testing.assert_allclose(ours, plain, atol=1e-12)
    assert np.ptp(np.asarray(ours)) > 0.5


@pytest.mark.parametrize(
    "polygon, becomes",
    [
        ("p 3 0 0 .5  1 0 .5  0 1 .5", "left out, as its whole plane would cut"),
        ("p 4 0 0 -9  1 0 -9  0 1 -8  1 1 -7", "left out, as its vertices are in no one plane"),
        ("p 3 0 0 -9  1 1 -9  2 2 -9", "left out, as its vertices are in no one plane"),
        ("p 3 -9 0 -9  -9 1 -9  -9 0 -8", "the whole plane, without edges"),
        ("pp 3 0 0 -9 0 0 1  1 0 -9 0 0 1  0 1 -9 0 1 1", "the plane is flat"),
    ],
)  # fmt: skip
def test_polygons_become_planes_or_are_left_out(polygon, becomes, tmp_path):
    scene, said = read(tmp_path, VIEW + "f 1 1 1 .5 0 0 0 0\ns 0 0 0 1\n" + polygon)
    assert becomes in said[-1] and said[-1].startswith("10: ")
    assert len(scene.planes) == ("left out" not in said[-1])


def test_polygons_of_one_plane(tmp_path):
    fill = "f 1 1 {} .5 0 0 0 0\n"
    floor = "p 3 {0} 0 -9  {1} 0 -9  {0} 1 -9\n"
    text = VIEW + fill.format(1) + floor.format(0, 1) + floor.format(3, 5)
    scene, said = read(tmp_path, text)
    assert len(scene.planes) == 1 and len(said) == 1
    scene, said = read(tmp_path, text + fill.format(0) + floor.format(7, 8))
    assert len(scene.planes) == 1 and "another fill on line 9" in said[1]


def test_what_is_not_carried_over_is_said_by_line(tmp_path):
    rest = "f 1 1 1 .5 .5 3 .5 1.5\nc 0 0 0 1\n0 0 1 .5\ns 0 0 0 -9\np 3 0 0 -9 1 0 -9 0 1 -9\n"
    scene, said = read(tmp_path, VIEW.replace("hither 0.1", "hither 9") + rest)
    assert [re.sub(":.*", "", line) for line in said] == ["1", "8", "9", "11", "12", "12"]
    words = ("hither", "refraction", "c, a cone", "outside", "plane", "opaque")
    assert all(word in line for word, line in zip(words, said, strict=True))
    np.testing.assert_array_equal(scene.spheres.radius, [9])


@pytest.mark.parametrize(
    "text, where, message",
    [
        ("", "1:1", "got an empty file"),
        ("# nothing\n", "2:1", "got an empty file"),
        ("s 0 0 0 1", "1:1", "expected f, a fill"),
        ("b 0 0 0", "1:8", "expected a view"),
        (VIEW + "f 1 1 1 1 1 1 1 1\ns 0 0 0 0", "9:1", "must not be 0"),
        (VIEW + "f 1 1 1 1 1 1 1 1\ns 0 0 1e999 1", "9:1", "finite in float64"),
        (VIEW + "f 1 1 1 1 1 1 1 1\ns 0 0 nan 1", "9:7", "expected Z, a number, got nan"),
        (VIEW + "f 1 1 1 1 1 1 1 1\ns 0 0 0\ns 0 0 0 1", "10:1", "the radius, a number"),
        (VIEW + "f 1 1 1 1 1 1 1 1\np 2 0 0 0 0 0 1", "9:3", "3 vertices or more"),
        (VIEW + "f 1 1 1 1 1 1 1 1\np 999999999999 0 0 0", "9:21", "a number, got the end"),
        (VIEW + "f 1 1 1 2 1 1 1 1", "8:9", "Kd must be in 0..1"),
        (VIEW + "f 1 1 1 1 1 1 1 1\ns 9 9 9 -1", "9:1", "the eye is outside"),
        (VIEW + "l 1 2 3 4", "8:10", "3 or 6 columns"),
        (VIEW + "sphere 1 2 3 4", "8:1", "expected one of v, b, l"),
        (VIEW + VIEW, "8:1", "v was given before, on line 1"),
        (VIEW.replace("angle 45", "angle 180"), "5:7", "between 0 and 180"),
        (VIEW.replace("angle 45\n", ""), "7:1", "expected angle of the view"),
        (VIEW.replace("0 0 0.1", "2.1 1.3 1.7"), "3:1", "must not be where from is"),
        (VIEW.replace("up 0 0 1", "up 2.1 1.3 1.6"), "4:1", "along the view"),
        (VIEW.replace("32 32", "32 -1"), "7:15", "a whole number"),
        (b"\x00\x01\x02", "1:1", "binary data"),
        (VIEW + "l 1 2 \N{MINUS SIGN}3", "8:7", "MINUS SIGN"),
    ],
)  # fmt: skip
def test_mistakes_are_named_with_their_place(text, where, message, tmp_path):
    with pytest.raises(st.SceneError, match=message) as error:
        read(tmp_path, text)
    assert f"scene.nff:{where}: " in str(error.value) and "\n" not in str(error.value)


def test_truncated_files_are_read_or_refused(tmp_path):
    refused = 0
    for end in range(0, len(SCENE), 5):
        try:
            read(tmp_path, SCENE[:end])
        except st.SceneError as error:
            refused += 1
            assert re.match(r"[^\n]*scene\.nff:\d+:\d+: [^\n]+$", str(error))
    assert 30 < refused < len(SCENE) / 5


def test_100000_spheres_take_below_two_seconds(tmp_path):
    rows = np.random.default_rng(0).uniform(0.1, 1, (100_000, 4))
    lines = "\n".join("s {:g} {:g} {:g} {:g}".format(*row) for row in rows)
    (tmp_path / "many.nff").write_text(f"{SCENE}{lines}\n")
    # as users read files: without checks of annotations
    program = """
import sys, time, warnings
import spheretrace_jax as st
warnings.simplefilter("ignore")
start = time.process_time()
scene = st.load_scene(sys.argv[1])
print(len(scene.spheres), float(scene.spheres.center[2:].sum()), time.process_time() - start)
"""
    ran = python("-c", program, str(tmp_path / "many.nff"), folder=Path(__file__).parents[2])
    count, total, seconds = map(float, ran.stdout.split())
    assert count == 100_002 and seconds < 2
    assert total == pytest.approx(rows[:, :3].sum(), rel=1e-4)


def test_lines_of_spheres_may_be_broken(tmp_path):
    broken, whole = (
        read(tmp_path, text)[0].spheres
        for text in (SCENE.replace("s 0 0 0 0.5", "s\n0 0 # x\n 0\r\n0.5"), SCENE)
    )
    np.testing.assert_array_equal(broken.center, whole.center)
    np.testing.assert_array_equal(broken.radius, whole.radius)


def test_float32(tmp_path):
    scene = read(tmp_path, SCENE, np.float32)[0]
    assert scene.dtype == np.float32
    with pytest.raises(st.SceneError, match="finite in float32"):
        read(tmp_path, SCENE + "s 1e39 0 0 1", np.float32)
