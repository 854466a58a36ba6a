"""The scene file: what it may look like, what it must not, and that writing keeps every bit."""

import time
import warnings
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import pytest
from helpers.picture_files import P3_D50, icc_profile, write_raw
from helpers.scenes import assert_same
from hypothesis import given, settings, strategies as some
from hypothesis.extra.numpy import arrays

import spheretrace_jax as st

NINE_SPHERES = Path(__file__).parents[2] / "data" / "nine_spheres.txt"

HEADER = "0 0 500 800\n0\n"
LIGHT = "1\n100 500 800\n"
SPHERE = "1 2 3 40  .9 .1 0  .2 .7 .1  4  0 0 0"
OTHER = "UTF-16 or UTF-32: save the file as UTF-8"
WIDE = ("utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-be")
LAST_KEYWORDS = "plane, window, look_at, roll, principal_point, pixel_aspect, orthographic"
SCENE = f"{HEADER}{LIGHT}1\n{SPHERE}\n"  # the sphere stands on line 6, keywords start on line 7


def read(folder: Path, text: str | bytes, dtype=np.float64) -> st.Scene:
    file = folder / "scene.txt"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return st.load_scene(file, dtype)


# --- what may stand in a file ---------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_nine_spheres_are_read_to_the_last_bit(dtype):
    scene = st.load_scene(NINE_SPHERES, dtype)
    k = np.arange(9)
    number = lambda text: np.asarray([float(word) for word in text.split()], dtype)
    expected = {
        "center": np.stack([k // 3 * 100 - 100, k % 3 * 100 - 100, 0 * k], axis=1).astype(dtype),
        "radius": np.full(9, 40, dtype),
        "color": np.tile(number(".9 0 0"), (9, 1)),
        "ka": number(".2 " * 9),
        "kd": number(".9 .8 .7 .6 .5 .4 .3 .2 .1"),
        "ks": number(".0 .1 .2 .3 .4 .5 .6 .7 .8"),
        "exponent": (4 * k + 4).astype(dtype),
        "kgr": number("0 .1 .2 .3 .4 .5 .6 .7 .8"),
        "kt": np.zeros(9, dtype),
    }
    for name, value in expected.items():
        np.testing.assert_array_equal(getattr(scene.spheres, name), value, err_msg=name)
    assert scene.spheres.pic == (0,) * 9 and scene.antialias == 1 and scene.dtype == dtype
    np.testing.assert_array_equal(scene.lights.position, [[100, 500, 800]])
    np.testing.assert_array_equal(scene.lights.color, [[1, 1, 1]])
    c = scene.camera
    np.testing.assert_array_equal(
        [c.theta, c.phi, c.mu, c.distance, c.window], number("-.01 .01 500 800 512")
    )
    assert not scene.background.any() and len(scene.planes) == len(scene.textures) == 0
    assert scene.sky is None and scene.back_plane is None


LAYOUTS = {
    "a value on every line": SCENE.replace("0 0 500 800\n0\n", "0\n\n0\n500\n800\n0\n\n"),
    "the header on one line": SCENE.replace("0 0 500 800\n0\n1\n", "0 0 500 800 0 1\n"),
    "tabs and spaces": "\t" + SCENE.replace(" ", " \t  ").replace("\n", "  \t\n"),
    "Windows lines": SCENE.replace("\n", "\r\n"),
    "old Macintosh lines": SCENE.replace("\n", "\r"),
    "no newline at the end": SCENE.rstrip("\n"),
    "empty lines around": "\n \n\t\n" + SCENE.replace("\n", "\n\n") + "\n\n",
    "comments on lines of their own": "// a\n" + SCENE.replace("\n", "\n  //b // c 1 2 3\n"),
    "comments after values": SCENE.replace("\n", " // Lx, Ly, Lz\n"),
    "comments without a space": SCENE.replace("\n", "//1 2 3\n"),
    "a last comment without a newline": SCENE + "// the end",
    "a comment with one slash in it": SCENE.replace("\n", " // 1/2 of it\n"),
    "Latin-1 in a comment": (SCENE + "// Größe, 1°\n").encode("latin-1"),
    "UTF-8 in a comment": SCENE + "// Größe, 1°, 球\n",
    "a byte order mark": b"\xef\xbb\xbf" + SCENE.encode(),
    "no-break and typesetters' spaces": SCENE.replace(" ", "\u00a0").replace("3", "3\u2003\u3000"),
    "form feeds": SCENE.replace("\n", "\f\n"),
    "signs, points and exponents": SCENE.replace("500 800\n0", "+5.E+2 .8e3\n+0"),
    "white given": SCENE.replace("100 500 800", "100 500 800 1 1 1"),
    "the window given": SCENE + "window 512\n",
    "a black background given": SCENE + "background 0 0 0\n",
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layout_is_free(layout, tmp_path):
    assert_same(read(tmp_path, LAYOUTS[layout]), read(tmp_path, SCENE))


def test_every_number_of_a_row_is_read_into_its_place(tmp_path):
    text = "1 2 3 4\n1\n2\n5 6 7\n8 9 10 11 12 13\n1\n1 2 3 4 .1 .2 .3 .4 .5 .6"
    scene = read(tmp_path, f"{text} 7 .8 .9 0\n")
    c, s = scene.camera, scene.spheres
    assert [float(x) for x in (c.theta, c.phi, c.mu, c.distance)] == [1, 2, 3, 4]
    np.testing.assert_array_equal(scene.lights.position, [[5, 6, 7], [8, 9, 10]])
    np.testing.assert_array_equal(scene.lights.color, [[1, 1, 1], [11, 12, 13]])
    columns = (s.center, s.radius, s.color, s.ka, s.kd, s.ks, s.exponent, s.kgr, s.kt)
    row = np.concatenate([column.reshape(-1) for column in columns])
    assert row.tolist() == [1, 2, 3, 4, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 7, 0.8, 0.9]


def test_keywords_come_in_any_order_and_are_read_into_their_places(tmp_path):
    for name in ("one.exr", "two three.exr", "sky.exr"):
        st.write_image(tmp_path / name, np.full((2, 3, 3), len(name), np.float32))
    scene = read(
        tmp_path,
        SCENE.replace("0 0 0\n", "0 0 2\n") + "window 300\ntexture one.exr // pic 1\n"
        "plane 1 2 3 4 5 6 .1 .2 .3 .4 .5 .6 7 .8\nback_plane .1 .2 .3 .4 .5\n"
        'background .1 .2 .3\ntexture "two three.exr"\n'
        "plane 0 0 0 0 0 1 0 0 0 0 0 0 0 0 checker .9 .8 .7 60\nbackground_image sky.exr\n",
    )
    assert float(scene.camera.window) == 300 and scene.spheres.pic == (2,)
    assert [float(t.image[0, 0, 0]) for t in (*scene.textures, scene.sky)] == [7, 13, 7]
    assert scene.textures[1].image.shape == (2, 3, 3)
    np.testing.assert_array_equal(scene.background, [0.1, 0.2, 0.3])
    back, p = scene.back_plane, scene.planes
    assert [float(x) for x in (*back.color, back.ka, back.kd)] == [0.1, 0.2, 0.3, 0.4, 0.5]
    np.testing.assert_array_equal(p.point[0], [1, 2, 3])
    np.testing.assert_array_equal(p.normal[0], [4, 5, 6])
    np.testing.assert_array_equal(p.color[0], [0.1, 0.2, 0.3])
    row = (p.ka, p.kd, p.ks, p.exponent, p.kgr, p.checker_size)
    assert [float(x[0]) for x in row] == [0.4, 0.5, 0.6, 7, 0.8, 0]
    np.testing.assert_array_equal(p.checker_color[1], [0.9, 0.8, 0.7])
    assert float(p.checker_size[1]) == 60


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_coats_are_read_and_written_where_there_are_any(dtype, tmp_path):
    text = HEADER + LIGHT + f"3\n{SPHERE}\n{SPHERE} 1.35\n{SPHERE} 1\n{PLANE}\n{PLANE} ior 1.7\n"
    scene = read(
        tmp_path, text + f"{PLANE} ior 2 checker .9 .8 .7 60\n{PLANE} checker 1 1 1 9\n", dtype
    )
    np.testing.assert_array_equal(scene.spheres.ior, np.asarray([1, 1.35, 1], dtype))
    np.testing.assert_array_equal(scene.planes.ior, np.asarray([1, 1.7, 2, 1], dtype))
    np.testing.assert_array_equal(scene.planes.checker_size, np.asarray([0, 0, 60, 9], dtype))
    st.save_scene(tmp_path / "again.txt", scene)
    assert_same(st.load_scene(tmp_path / "again.txt", dtype), scene)
    written = (tmp_path / "again.txt").read_text()
    assert written.count("1.35") == 1 and written.count("ior") == 3
    plain = eqx.tree_at(lambda s: (s.spheres.ior, s.planes.ior), scene, replace_fn=np.ones_like)
    st.save_scene(tmp_path / "plain.txt", plain)
    assert "ior" not in (tmp_path / "plain.txt").read_text()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_world_without_lights_and_spheres_is_read(dtype, tmp_path):
    scene = read(tmp_path, f"{HEADER}0\n0\n", dtype)
    assert len(scene.lights) == len(scene.spheres) == 0 and scene.dtype == dtype


def test_the_lecture_s_limits_of_5_lights_and_20_spheres_are_gone(tmp_path):
    scene = read(tmp_path, HEADER + "60\n" + "1 2 3\n" * 60 + "3000\n" + f"{SPHERE}\n" * 3000)
    assert len(scene.lights) == 60 and len(scene.spheres) == 3000


def test_the_dtype_is_jax_s_default_unless_given(tmp_path):
    assert read(tmp_path, SCENE, dtype=None).dtype == np.float64
    with jax.enable_x64(False):
        assert read(tmp_path, SCENE, dtype=None).dtype == np.float32


# --- what must not --------------------------------------------------------------------------------


def row(place: int, word: str) -> str:
    """Returns the scene with one word of its sphere (from 1) replaced."""
    words = SPHERE.split()
    words[place - 1] = word
    return f"{HEADER}{LIGHT}1\n{' '.join(words)}\n"


PLANE = "plane 0 0 0 0 0 1 .5 .5 .5 .2 .8 0 1 0"

MISTAKES = [
    # the file as a whole
    ("", "1:1: expected a scene, starting with theta, got an empty file"),
    (" \n// only this\n", "3:1: expected a scene, starting with theta, got an empty file"),
    ("\x89PNG\r\n\x1a\n\0\0", "2:1: expected text, got binary data (byte 0x1a)"),
    ("0 0 500 800\n\0", "2:1: expected text, got binary data (byte 0x00)"),
    *((SCENE.encode(e), f"1:1: expected text in UTF-8, got {OTHER}") for e in WIDE),
    (
        SCENE.replace("1 2 3", "1 \u22122 3"),
        "6:3: expected cy, a number, got \u22122 with U+2212 (MINUS SIGN)",
    ),
    (
        SCENE.replace("500", "5\u200b00"),
        "1:6: expected mu, a number, got 5\\u200b00 with U+200B (ZERO WIDTH SPACE)",
    ),
    (
        "\u200b" + SCENE,
        "1:1: expected theta, a number, got \\u200b0 with U+200B (ZERO WIDTH SPACE)",
    ),
    (
        SCENE.replace(".9", "\uff0e9"),
        "6:11: expected R, a number, got \uff0e9 with U+FF0E (FULLWIDTH FULL STOP)",
    ),
    (
        SCENE.replace("800\n0\n1\n", "800\n0\n\u0661\n"),
        "3:1: expected numlights, a whole number from 0, got \u0661 with "
        "U+0661 (ARABIC-INDIC DIGIT ONE)",
    ),
    (
        SCENE.replace("40", "4\u041e"),
        "6:8: expected radius, a number, got 4\u041e with U+041E (CYRILLIC CAPITAL LETTER O)",
    ),
    (
        SCENE + "wind\u043ew 9\n",
        "7:5: expected the end of the file after 1 sphere, or one of texture, background, "
        f"background_image, back_plane, {LAST_KEYWORDS}, got wind\u043ew with "
        "U+043E (CYRILLIC SMALL LETTER O)",
    ),
    (
        SCENE.replace("1 2 3", "\x961 2 3").encode("latin-1"),
        "6:1: expected cx, a number, got \\x961 with U+0096 (a control character)",
    ),
    # the view
    ("theta 0 500 800", "1:1: expected theta, a number, got theta"),
    ("0 0 -1 800", "1:5: mu must be at least 0, got -1"),
    ("0 0 500 0", "1:9: distance must be greater than 0, got 0"),
    ("0 0 500 -800", "1:9: distance must be greater than 0, got -800"),
    ("0 0 500", "1:8: expected distance, a number, got the end of the file"),
    ("0, 0, 500, 800", "1:1: expected theta, a number, got 0,"),
    ("0 nan 500 800", "1:3: expected phi, a number, got nan"),
    ("0 0 inf 800", "1:5: expected mu, a number, got inf"),
    ("0 0 1e999 800", "1:5: mu must be finite in float64, got 1e999"),
    ("0 0 1_0 800", "1:5: expected mu, a number, got 1_0"),
    ("0 0 0x10 800", "1:5: expected mu, a number, got 0x10"),
    ("0 0 ٣ 800", "1:5: expected mu, a number, got ٣ with U+0663 (ARABIC-INDIC DIGIT THREE)"),
    ("0 0 5 / 800", "1:7: expected distance, a number, got /"),
    # antialias and counts
    ("0 0 500 800 2", "1:13: antialias must be 0 or 1, got 2"),
    ("0 0 500 800\n.5", "2:1: expected antialias, a whole number from 0, got .5"),
    ("0 0 500 800\n-1", "2:1: expected antialias, a whole number from 0, got -1"),
    (HEADER, "3:1: expected numlights, a whole number from 0, got the end of the file"),
    (HEADER + "one", "3:1: expected numlights, a whole number from 0, got one"),
    (HEADER + "-1", "3:1: expected numlights, a whole number from 0, got -1"),
    (HEADER + "1.5", "3:1: expected numlights, a whole number from 0, got 1.5"),
    (HEADER + "1 0 0 9", "3:3: expected the end of the line after numlights 1, got 0"),
    (HEADER + "1\n", "4:1: expected light 1 of 1, got the end of the file"),
    (HEADER + "2\n0 0 9\n", "5:1: expected light 2 of 2, got the end of the file"),
    # lights
    (HEADER + "1\n1 2\n0\n", "4:4: expected 3 or 6 columns for light 1 of 1, got 2"),
    (HEADER + "1\n1 2 3 1\n", "4:8: expected 3 or 6 columns for light 1 of 1, got 4"),
    (HEADER + "1\n1 2 3 1 1 // b\n", "4:10: expected 3 or 6 columns for light 1 of 1, got 5"),
    (
        HEADER + "1\n1 2 3 1 1 1 1\n",
        "4:13: expected the end of the line after light 1 of 1, got 1",
    ),
    (HEADER + "1\n1 x 3\n", "4:3: expected Ly, a number, got x"),
    (HEADER + "1\n1 2 3 1 -1 1\n", "4:9: LG must be at least 0, got -1"),
    (HEADER + "1\n1 2 3 1 1 nan\n", "4:11: expected LB, a number, got nan"),
    (HEADER + "1\n1 2 directional\n", "4:4: expected 3 or 6 columns for light 1 of 1, got 2"),
    (
        HEADER + "1\n1 2 3 directional far\n",
        "4:19: expected falloff or the end of the line, got far",
    ),
    (
        HEADER + "1\n1 2 3 directional directional\n",
        "4:19: expected falloff or the end of the line, got directional",
    ),
    (HEADER + "1\n1 2 3 falloff\n0", "5:1: expected a number after falloff, got 0"),
    (HEADER + "1\n1 2 3 falloff x\n", "4:15: expected DISTANCE, a number, got x"),
    (HEADER + "1\n1 2 3 1 1 1 falloff -2\n", "4:21: DISTANCE must be at least 0, got -2"),
    (
        HEADER + "1\n1 2 3 falloff 5 directional\n",
        "4:7: a directional light has no falloff",
    ),
    (
        HEADER + "1\n0 0 0 directional\n",
        "4:1: the direction Lx Ly Lz of a directional light must not be 0 0 0",
    ),
    # a count that does not match
    (
        HEADER + LIGHT + f"2\n{SPHERE}\n",
        "7:1: expected sphere 2 of 2, got the end of the file",
    ),
    (
        HEADER + LIGHT + f"2\n{SPHERE}\nwindow 9\n",
        "7:1: expected sphere 2 of 2, got window",
    ),
    (
        HEADER + LIGHT + f"1\n{SPHERE}\n{SPHERE}\n",
        "7:1: expected the end of the file after 1 sphere, or one of texture, background, "
        f"background_image, back_plane, {LAST_KEYWORDS}, got 1",
    ),
    (
        HEADER + f"2\n1 2 3\n1\n{SPHERE}\n",
        "5:2: expected 3 or 6 columns for light 2 of 2, got 1",
    ),
    (HEADER + LIGHT, "5:1: expected numspheres, a whole number from 0, got the end of the file"),
    (HEADER + LIGHT + "-3\n", "5:1: expected numspheres, a whole number from 0, got -3"),
    (
        HEADER + LIGHT + "999999999999999999999\n",
        "5:1: expected numspheres, a whole number from 0, got 999999999999999999999",
    ),
    (
        HEADER + LIGHT + "999999999999999999\n",
        "6:1: expected sphere 1 of 999999999999999999, got the end of the file",
    ),
    # spheres
    (
        SCENE.replace(" 0 0 0\n", " 0 0\n"),
        "6:36: expected 14 or 15 columns for sphere 1 of 1, got 13",
    ),
    (
        SCENE.replace(" 0 0 0\n", " 0 0 0 1 0\n"),
        "6:41: expected the end of the line after sphere 1 of 1, got 0",
    ),
    (SCENE.replace(" 0 0 0\n", " 0 0 0 .9\n"), "6:39: ior must be at least 1, got .9"),
    (SCENE.replace(" 0 0 0\n", " 0 0 0 nan\n"), "6:39: expected ior, a number, got nan"),
    (
        SCENE.replace(" 0 0 0\n", " 0 0 .5 1.5\n"),
        "6:37: expected pic, a whole number from 0, got .5",
    ),
    (SCENE + PLANE + " ior .9\n", "7:44: ior must be at least 1, got .9"),
    (SCENE + PLANE + " ior 1.5 checker 1 1 1 0\n", "7:62: size must be greater than 0, got 0"),
    (
        SCENE + PLANE + " iro 1.5\n",
        "7:40: expected ior or the end of the line, got iro",
    ),
    (
        SCENE + PLANE + " checker 1 1 1 9 ior 1.5\n",
        "7:40: expected ior or the end of the line, got checker",
    ),
    (
        SCENE + PLANE + " ior 1.5 chess 1 1 1 9\n",
        "7:48: expected checker or the end of the line, got chess",
    ),
    (SCENE.replace("  .2", "\n.2"), "6:18: expected 14 or 15 columns for sphere 1 of 1, got 7"),
    (row(1, "red"), "6:1: expected cx, a number, got red"),
    (row(2, "1e400"), "6:3: cy must be finite in float64, got 1e400"),
    (row(3, "-inf"), "6:5: expected cz, a number, got -inf"),
    (row(4, "-40"), "6:7: radius must be greater than 0, got -40"),
    (row(4, "0"), "6:7: radius must be greater than 0, got 0"),
    (row(5, "1.1"), "6:10: R must be in 0..1, got 1.1"),
    (row(6, "-.1"), "6:13: G must be in 0..1, got -.1"),
    (row(7, "255"), "6:16: B must be in 0..1, got 255"),
    (row(8, "-1e-9"), "6:18: ka must be in 0..1, got -1e-9"),
    (row(9, "1.0000001"), "6:21: kd must be in 0..1, got 1.0000001"),
    (row(10, "2"), "6:24: ks must be in 0..1, got 2"),
    (row(11, "-1"), "6:27: specExp must be at least 0, got -1"),
    (row(12, "2"), "6:29: kgr must be in 0..1, got 2"),
    (row(13, "-2"), "6:31: kt must be in 0..1, got -2"),
    (row(14, "1"), "6:33: pic must be in 0..0, the number of textures, got 1"),
    (row(14, "-1"), "6:33: expected pic, a whole number from 0, got -1"),
    (row(14, ".5"), "6:33: expected pic, a whole number from 0, got .5"),
    # keywords
    (
        SCENE + "fog 1\n",
        "7:1: expected the end of the file after 1 sphere, or one of texture, background, "
        f"background_image, back_plane, {LAST_KEYWORDS}, got fog",
    ),
    (SCENE + "window\n", "7:7: expected 1 column for window, got 0"),
    (SCENE + "window 0\n", "7:8: HEIGHT must be greater than 0, got 0"),
    (SCENE + "window 1 2\n", "7:10: expected the end of the line after window, got 2"),
    (SCENE + "window 1\nwindow 2\n", "8:1: window was given before, on line 7"),
    (SCENE + "look_at 1 2\n", "7:12: expected 3 columns for look_at, got 2"),
    (SCENE + "look_at 1 2 up\n", "7:13: expected Z, a number, got up"),
    (SCENE + "roll\n", "7:5: expected 1 column for roll, got 0"),
    (SCENE + "roll 0\nroll 1\n", "8:1: roll was given before, on line 7"),
    (SCENE + "principal_point 0 1e999\n", "7:19: Y must be finite in float64, got 1e999"),
    (SCENE + "pixel_aspect -1\n", "7:14: A must be greater than 0, got -1"),
    (
        SCENE + "orthographic 1\n",
        "7:14: expected the end of the line after orthographic, got 1",
    ),
    (SCENE + "background 0 0\n", "7:15: expected 3 columns for background, got 2"),
    (SCENE + "background 0 0 9\n", "7:16: B must be in 0..1, got 9"),
    (
        SCENE + "background 0 0 0\nbackground 1 1 1\n",
        "8:1: background was given before, on line 7",
    ),
    (SCENE + "back_plane 1 1 1 .2\n", "7:20: expected 5 columns for back_plane, got 4"),
    (SCENE + "back_plane 1 1 1 .2 2\n", "7:21: kd must be in 0..1, got 2"),
    (SCENE + PLANE[:-2] + "\n", "7:37: expected 14 or 16 or 19 or 21 columns for plane, got 13"),
    (
        SCENE + PLANE + " checker 1 1\n",
        "7:51: expected 14 or 16 or 19 or 21 columns for plane, got 17",
    ),
    (
        SCENE + PLANE + " chess 1 1 1 9\n",
        "7:40: expected checker or the end of the line, got chess",
    ),
    (SCENE + PLANE + " checker 1 1 1 0\n", "7:54: size must be greater than 0, got 0"),
    (SCENE + PLANE + " checker 1 1 2 9\n", "7:52: B must be in 0..1, got 2"),
    (
        SCENE + PLANE.replace("0 0 1", "0 0 0") + "\n",
        "7:13: the normal nx ny nz of a plane must not be 0 0 0",
    ),
    (SCENE + "texture\n", "7:8: expected 1 column for texture, got 0"),
    (SCENE + 'texture ""\n', '7:9: expected the name of a picture, got ""'),
    (SCENE + 'texture "a.png\n', '7:9: expected a closing quote, got "a.png'),
    (SCENE + "texture a b.png\n", "7:11: expected the end of the line after texture, got b.png"),
    (
        SCENE + "texture no.png\n",
        "7:9: expected a picture, got no.png: there is no such picture",
    ),
    (
        SCENE + "window 9\nbackground_image no.png\n",
        "8:18: expected a picture, got no.png: there is no such picture",
    ),
    (
        SCENE + "texture .\n",
        "7:9: expected a picture, got .: expected a picture, this is a folder",
    ),
    (
        SCENE + "texture scene.txt\n",
        "7:9: expected a picture, got scene.txt: cannot be read as a picture: ",
    ),
]


@pytest.mark.parametrize(("text", "message"), MISTAKES, ids=[m[:60] for _, m in MISTAKES])
def test_mistakes_are_reported_with_their_place(text, message, tmp_path):
    with pytest.raises(st.SceneError) as error:
        read(tmp_path, text)
    said = str(error.value)
    expected = f"{tmp_path / 'scene.txt'}:{message}"
    assert said.startswith(expected) if message.endswith(": ") else said == expected
    assert "\n" not in said


def test_lines_and_columns_are_counted_across_comments_tabs_and_windows_lines(tmp_path):
    with pytest.raises(st.SceneError, match=r"scene\.txt:3:4: expected theta, a number, got x$"):
        read(tmp_path, "\ufeff// ü\r\n\r\n \t x")


def test_a_number_too_large_for_float32_is_refused_there_only(tmp_path):
    assert float(read(tmp_path, row(1, "1e39")).spheres.center[0, 0]) == 1e39
    with pytest.raises(st.SceneError, match=r":6:1: cx must be finite in float32, got 1e39$"):
        read(tmp_path, row(1, "1e39"), np.float32)


@pytest.mark.parametrize(
    "text",
    [
        b"7" * 10_000_000,
        b"7 " * 5_000_000,
        b"7\n" * 5_000_000,
        (HEADER + "9999999\n" + "1 2 3\n").encode() + b"7 " * 5_000_000,
        SCENE.encode() + b"7" * 10_000_000,
        b'"' * 10_000_000,
        b"/ " * 5_000_000,
    ],
    ids=["one word", "one line", "lines", "a row", "after a scene", "quotes", "slashes"],
)
def test_ten_megabytes_are_refused_within_seconds_in_a_short_line(text, tmp_path):
    start = time.perf_counter()
    with pytest.raises(st.SceneError) as error:
        read(tmp_path, text)
    assert time.perf_counter() - start < 5
    assert len(str(error.value)) < len(str(tmp_path)) + 300


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(st.SceneError, match=r"no\.txt: cannot read the scene: No such file"):
        st.load_scene(tmp_path / "no.txt")
    with pytest.raises(st.SceneError, match="cannot read the scene: Is a directory"):
        st.load_scene(tmp_path)


def test_float64_needs_64_bit_jax(tmp_path):
    with (
        jax.enable_x64(False),
        pytest.raises(st.InputError, match="needs 64-bit JAX"),
    ):
        read(tmp_path, SCENE, np.float64)


@pytest.mark.parametrize("dtype", [np.float16, np.int32, "complex64"])
def test_other_dtypes_are_refused(dtype, tmp_path):
    with pytest.raises(st.InputError, match="must be float32 or float64, got"):
        read(tmp_path, SCENE, dtype)


# --- the lecture's rule ---------------------------------------------------------------------------


def warned(load) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load()
    assert all(issubclass(w.category, st.SceneWarning) for w in caught)
    return [str(w.message) for w in caught]


def test_the_nine_spheres_break_the_lecture_s_rule_once():
    rule = "7:32: ka + kd is 1.1, the lecture's rule is at most 1"
    assert warned(lambda: st.load_scene(NINE_SPHERES)) == [f"{NINE_SPHERES}:{rule}"]


def test_every_sphere_whose_ka_and_kd_exceed_1_is_warned_of(tmp_path):
    text = SCENE.replace(f"1\n{SPHERE}", "3\n" + "\n".join([SPHERE.replace(".7", ".9")] * 3))
    messages = warned(lambda: read(tmp_path, text))
    assert [m.split(":")[-3:-1] for m in messages] == [["6", "20"], ["7", "20"], ["8", "20"]]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("ka", [".1", ".2", ".3", ".35", ".7", ".9"])
def test_ka_and_kd_that_make_1_are_no_reason_to_warn(ka, dtype, tmp_path):
    text = SCENE.replace(".2 .7", f"{ka} {1 - float(ka):.2f}")
    assert warned(lambda: read(tmp_path, text, dtype)) == []


# --- writing --------------------------------------------------------------------------------------

NAMES = ("a.exr", "two words.exr", "sub/b.exr", "half/full.exr", "ü球.exr", "nb\u00a0sp.exr")


@pytest.fixture(scope="module")
def pictures(tmp_path_factory) -> list[st.Texture]:
    """Textures in float64, each in a file of its own."""
    folder = tmp_path_factory.mktemp("pictures")
    rng = np.random.default_rng(0)
    textures = []
    for name in NAMES:
        file = folder / name
        file.parent.mkdir(exist_ok=True)
        image = rng.uniform(0, 4, (2, 3, 3)).astype(np.float32)
        st.write_image(file, image)
        textures.append(st.Texture(image.astype(np.float64), str(file)))
    return textures


def any_scene(draw, dtype: type, pictures: list[st.Texture]) -> st.Scene:
    """Draws any scene that a file can hold."""
    bits = np.dtype(dtype).itemsize * 8
    least = float(np.finfo(dtype).smallest_subnormal)
    most = float(np.finfo(dtype).max)

    def numbers(low: float, high: float, *shape: int) -> np.ndarray:
        return draw(arrays(dtype, shape, elements=some.floats(low, high, width=bits)))

    def count() -> int:
        return draw(some.integers(0, 3))

    def material(rows: int) -> tuple[np.ndarray, ...]:
        ka, kd, ks, kgr = (numbers(0, 1, rows) for _ in range(4))
        return ka, kd, ks, numbers(0, most, rows), kgr

    textures = [
        st.Texture(t.image.astype(dtype), t.file)
        for t in draw(some.lists(some.sampled_from(pictures), max_size=3))
    ]
    n, m, p = count(), count(), count()
    spheres = st.Spheres(
        numbers(-most, most, n, 3),
        numbers(least, most, n),
        numbers(0, 1, n, 3),
        *material(n),
        numbers(0, 1, n),
        draw(some.lists(some.integers(0, len(textures)), min_size=n, max_size=n)),
        numbers(1, most, n),
    )
    checkered = draw(arrays(bool, p))
    normals = numbers(-most, most, p, 3)
    normals[~normals.any(axis=1)] = (0, 0, 1)
    planes = st.Planes(
        numbers(-most, most, p, 3),
        normals,
        numbers(0, 1, p, 3),
        *material(p),
        checker_color=np.where(checkered[:, None], numbers(0, 1, p, 3), dtype(0)),
        checker_size=np.where(checkered, numbers(least, most, p), dtype(0)),
        ior=draw(some.sampled_from([np.ones(p, dtype), numbers(1, most, p)])),
    )
    sky = draw(some.none() | some.sampled_from(pictures))
    back = numbers(0, 1, 5)
    maybe = lambda value: draw(some.sampled_from([None, value]))
    window = draw(some.sampled_from([np.full((), 512, dtype), numbers(least, most)]))
    return st.Scene(
        spheres,
        st.Lights(
            numbers(-most, most, m, 3),
            draw(some.sampled_from([np.ones((m, 3), dtype), numbers(0, most, m, 3)])),
        ),
        st.Camera(
            numbers(-most, most),
            numbers(-most, most),
            numbers(0, most),
            numbers(least, most),
            window,
            roll=maybe(numbers(-most, most)),
            look_at=maybe(numbers(-most, most, 3)),
            principal_point=maybe(numbers(-most, most, 2)),
            pixel_aspect=maybe(numbers(least, most)),
            orthographic=draw(some.booleans()),
        ),
        planes,
        textures=textures,
        background=draw(some.sampled_from([np.zeros(3, dtype), numbers(0, 1, 3)])),
        sky=sky and st.Texture(sky.image.astype(dtype), sky.file),
        back_plane=draw(some.sampled_from([None, st.BackPlane(back[:3], back[3], back[4])])),
        antialias=draw(some.integers(0, 1)),
    )


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@settings(max_examples=60, deadline=None, derandomize=True)
@given(data=some.data())
def test_writing_then_reading_keeps_every_bit(data, dtype, pictures, tmp_path_factory):
    scene = any_scene(data.draw, dtype, pictures)
    beside = Path(pictures[0].file).parent / "scene.txt"
    elsewhere = tmp_path_factory.getbasetemp() / "deep" / "er" / "scene.txt"
    elsewhere.parent.mkdir(parents=True, exist_ok=True)
    for file in (beside, elsewhere):
        st.save_scene(file, scene)
        assert_same(st.load_scene(file, dtype), scene)


def test_lines_of_the_camera(tmp_path):
    lines = "orthographic\nroll .5 // radians\nlook_at 1 2 3\n"
    camera = read(tmp_path, SCENE + lines + "principal_point .1 -.2\npixel_aspect 1.5\n").camera
    assert camera.orthographic and camera.roll == 0.5 and camera.pixel_aspect == 1.5
    assert camera.look_at.tolist() == [1, 2, 3] and camera.principal_point.tolist() == [0.1, -0.2]
    plain = read(tmp_path, SCENE).camera
    assert not plain.orthographic and len(jax.tree.leaves(plain)) == 5
    # what is set is written, also at its default
    scene = read(tmp_path, SCENE + "roll 0\n")
    st.save_scene(tmp_path / "out.txt", scene)
    assert (tmp_path / "out.txt").read_text().endswith(" 0\nroll 0.0\n")
    assert_same(st.load_scene(tmp_path / "out.txt", np.float64), scene)


def test_zeros_keep_their_sign(tmp_path):
    scene = st.Scene(
        st.Spheres([[-0.0, 0, -0.0]], [1.0], (-0.0, 0, 0), kd=-0.0),
        st.Lights([[0.0, -0.0, 9]], [[-0.0, 0, 0]]),
        st.Camera(-0.0, 0.0, -0.0),
        background=(0.0, -0.0, 0.0),
        back_plane=st.BackPlane((0.0, 0, -0.0), -0.0),
    )
    st.save_scene(tmp_path / "scene.txt", scene)
    assert_same(st.load_scene(tmp_path / "scene.txt"), scene)


def test_written_texts_read_well(tmp_path):
    scene = read(tmp_path, SCENE + "window 300\nbackground .1 .2 .3\n")
    st.save_scene(tmp_path / "out.txt", scene)
    assert (tmp_path / "out.txt").read_text() == (
        "0.0 0.0 500.0 800.0 // theta phi mu distance\n"
        "0 // antialias\n"
        "1 // numlights\n"
        "100.0 500.0 800.0\n"
        "1 // numspheres\n"
        "//cx cy cz radius R G B ka kd ks specExp kgr kt pic\n"
        "1.0 2.0 3.0 40.0 0.9 0.1 0.0 0.2 0.7 0.1 4.0 0.0 0.0 0\n"
        "background 0.1 0.2 0.3\n"
        "window 300.0\n"
    )


def test_lights_of_all_kinds_come_back(tmp_path):
    rows = (
        "5 6 7",
        "1 2 3 directional",
        "8 9 10 11 12 13 falloff 2.5",
        "0 0 1 .1 .2 .3 directional",
    )
    scene = read(tmp_path, "0 0 500 800\n0\n4\n" + "\n".join(rows) + "\n0\n")
    assert scene.lights.directional == (False, True, False, True)
    np.testing.assert_array_equal(scene.lights.falloff, [0, 0, 2.5, 0])
    np.testing.assert_array_equal(scene.lights.color[2:], [[11, 12, 13], [0.1, 0.2, 0.3]])
    np.testing.assert_array_equal(scene.lights.position[1], [1, 2, 3])
    st.save_scene(tmp_path / "out.txt", scene)
    written = (tmp_path / "out.txt").read_text().splitlines()[3:7]
    assert written[1:3] == [
        "1.0 2.0 3.0 directional",
        "8.0 9.0 10.0 11.0 12.0 13.0 falloff 2.5",
    ]
    assert_same(st.load_scene(tmp_path / "out.txt"), scene)


def test_textures_are_named_relative_to_the_scene(pictures):
    folder = Path(pictures[0].file).parent
    scene = st.Scene(
        st.Spheres(np.zeros((1, 3)), [1.0], pic=2), st.Lights([[0.0, 0, 9]]), textures=pictures[:2]
    )
    st.save_scene(folder / "sub" / "scene.txt", scene)
    lines = (folder / "sub" / "scene.txt").read_text().splitlines()
    assert lines[-2:] == ["texture ../a.exr", 'texture "../two words.exr"']


SPHERES = st.Spheres([[0.0, 0, 0], [1, 2, 3]], [1.0, 2.0], kd=0.5)
UNWRITABLE = {
    "a bright colour": (lambda s: s.spheres.color, [[0, 0, 1.5]] * 2, "B must be in 0..1, got 1.5"),
    "a negative light": (lambda s: s.lights.color, [[-1.0, 1, 1]], "LR must be at least 0"),
}


@pytest.mark.parametrize("mistake", UNWRITABLE)
def test_scenes_that_no_file_may_hold_are_not_written(mistake, tmp_path):
    where, value, message = UNWRITABLE[mistake]
    scene = st.Scene(SPHERES, st.Lights([[0.0, 0, 9]]))
    scene = eqx.tree_at(where, scene, np.asarray(value))
    file = tmp_path / "out.txt"
    file.write_text("kept")
    with pytest.raises(st.SceneError, match="cannot write a scene that could not be read") as error:
        st.save_scene(file, scene)
    assert message in str(error.value)
    assert file.read_text() == "kept" and list(tmp_path.iterdir()) == [file]


def test_a_texture_is_read_upright_by_its_profile_and_over_black(tmp_path):
    numbers = np.array([[[255, 0, 0, 255], [90, 90, 90, 0]]], np.uint8)
    write_raw(
        tmp_path / "a.png", numbers, alpha=3, oiio__UnassociatedAlpha=1, Orientation=6,
        ICCProfile=icc_profile(P3_D50),
    )  # fmt: skip
    (tmp_path / "scene.txt").write_text(SCENE + "texture a.png\nbackground_image a.png\n")
    with pytest.warns(st.PictureWarning) as caught:
        scene = st.load_scene(tmp_path / "scene.txt", np.float64)
    said = f"{tmp_path / 'a.png'}: 1 of 2 pixels are transparent, and read as over black"
    assert all(str(w.message).startswith(said) for w in caught)
    for texture in (*scene.textures, scene.sky):
        assert texture.image.shape == (2, 1, 3)
        expected = [[[1.22494, -0.04206, -0.01964]], [[0, 0, 0]]]
        np.testing.assert_allclose(texture.image, expected, rtol=0, atol=3e-4)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("", "a texture is in no file: write it with write_image and name that file"),
        ('a"b.png', "it has a quote or a control character"),
        ("a\nb.png", "it has a quote or a control character"),
        ("a\udcffb.png", "it has a quote or a control character"),
    ],
)
def test_textures_that_no_file_can_name_are_not_written(name, message, tmp_path):
    texture = st.Texture(np.ones((2, 2, 3)), name)
    scene = st.Scene(SPHERES, st.Lights([[0.0, 0, 9]]), textures=[texture])
    with pytest.raises(st.SceneError, match=message):
        st.save_scene(tmp_path / "out.txt", scene)
    assert not list(tmp_path.iterdir())


def test_there_must_be_a_folder_to_write_to(tmp_path):
    scene = st.Scene(SPHERES, st.Lights([[0.0, 0, 9]]))
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        st.save_scene(tmp_path / "no" / "out.txt", scene)
    with pytest.raises(IsADirectoryError, match="expected a file to write, this is a folder"):
        st.save_scene(tmp_path, scene)
    assert not list(tmp_path.iterdir())
