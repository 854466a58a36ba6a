"""Pictures as cameras and other programs write them: upright, whole, the right layer."""

import os
import struct
import subprocess
import sys
import zlib

import numpy as np
import pytest
from helpers.picture_files import (
    chunk,
    decode,
    flat_png,
    png,
    write_deep,
    write_parts,
    write_raw,
)
from PIL import Image, ImageOps

import spheretrace_jax as st
from spheretrace_jax.files.png import read_png


def refused(file, **arguments) -> str:
    with pytest.raises(st.PictureError) as error:
        st.read_image(file, **arguments)
    said = str(error.value)
    assert said.startswith(f"{file}: ") and "\n" not in said
    return said.removeprefix(f"{file}: ")


def warned(file, **arguments) -> tuple[np.ndarray, list[str]]:
    """Reads a picture. **Returns:** the picture, and the warnings after the file's name."""
    with pytest.warns() as caught:
        image = st.read_image(file, **arguments)
    assert all(w.category is st.PictureWarning for w in caught)
    said = [str(w.message) for w in caught]
    assert all(line.startswith(f"{file}: ") and "\n" not in line for line in said)
    return image, [line.removeprefix(f"{file}: ") for line in said]


# --- orientation ----------------------------------------------------------------------------------

# What is right when it is shown, as the file has it: Exif 2.32, 4.6.4, Orientation.
UPRIGHT = np.array([[[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[1, 1, 0], [0, 1, 1], [1, 0, 1]]], np.uint8)
STORED = {
    1: lambda p: p,
    2: lambda p: p[:, ::-1],
    3: lambda p: p[::-1, ::-1],
    4: lambda p: p[::-1],
    5: lambda p: p.swapaxes(0, 1),
    6: lambda p: np.rot90(p, 1),  # the camera was turned: rows run down the picture
    7: lambda p: p.swapaxes(0, 1)[::-1, ::-1],
    8: lambda p: np.rot90(p, -1),
}


@pytest.mark.parametrize("orientation", STORED)
@pytest.mark.parametrize("ending", [".png", ".tif", ".exr", ".jpg"])
def test_pictures_are_read_upright(ending, orientation, tmp_path):
    file = tmp_path / f"a{ending}"
    big = UPRIGHT.repeat(16, 0).repeat(16, 1)  # which JPEG keeps
    stored = np.ascontiguousarray(STORED[orientation](big))
    numbers = stored.astype(np.float32) if ending == ".exr" else stored * np.uint8(255)
    write_raw(file, numbers, Orientation=orientation)
    found = st.read_image(file)
    assert found.shape == big.shape
    np.testing.assert_allclose(found[8::16, 8::16], UPRIGHT, rtol=0, atol=0.02)


@pytest.mark.parametrize("ending", [".png", ".webp", ".jpg", ".tif"])
def test_pillow_agrees_which_way_is_up(ending, tmp_path):
    stored = Image.fromarray((UPRIGHT * np.uint8(255)).repeat(16, 0).repeat(16, 1))
    for orientation in range(1, 9):
        exif = Image.Exif()
        exif[274] = orientation
        stored.save(tmp_path / f"a{ending}", exif=exif)
        theirs = np.asarray(ImageOps.exif_transpose(Image.open(tmp_path / f"a{ending}")))
        ours = st.read_image(tmp_path / f"a{ending}", "linear")
        np.testing.assert_allclose(ours * 255, theirs, rtol=0, atol=4)


def test_the_order_of_rows_of_a_radiance_file_is_known(tmp_path):
    body = b"".join(bytes([16 * k, 64, 64, 129]) for k in range(6))
    expected = {"-Y 2 +X 3": [[0, 1, 2], [3, 4, 5]], "+Y 2 +X 3": [[3, 4, 5], [0, 1, 2]],
                "-Y 2 -X 3": [[2, 1, 0], [5, 4, 3]]}  # fmt: skip
    for line, rows in expected.items():
        head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n{line}\n"
        (tmp_path / "a.hdr").write_bytes(head.encode() + body)
        red = st.read_image(tmp_path / "a.hdr")[..., 0]
        np.testing.assert_allclose(red * 8, rows, rtol=0, atol=0.1)


# --- windows --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "window",
    [(2, 1, 8, 6), (0, 0, 8, 6), (-1, -2, 3, 3), (5, 4, 8, 6), (-2, 3, 8, 6), (9, 9, 8, 6)],
)
def test_the_display_window_is_read(window, tmp_path):
    x, y, width, height = window
    data = np.random.default_rng(0).uniform(0, 1, (4, 5, 3)).astype(np.float32)
    write_raw(tmp_path / "a.exr", data, window=window)
    expected = np.zeros((height, width, 3), np.float32)
    for row in range(4):
        for column in range(5):
            if 0 <= row + y < height and 0 <= column + x < width:
                expected[row + y, column + x] = data[row, column]
    np.testing.assert_array_equal(st.read_image(tmp_path / "a.exr"), expected)


def test_a_display_window_that_is_too_large_is_refused(tmp_path):
    write_raw(tmp_path / "a.exr", np.ones((4, 5, 3), np.float32), window=(0, 0, 60_000, 60_000))
    assert "expected a picture of at most" in refused(tmp_path / "a.exr")


def test_the_offset_of_a_png_is_no_window(tmp_path):
    offset = chunk(b"oFFs", struct.pack(">iiB", 5, 3, 0))
    (tmp_path / "a.png").write_bytes(flat_png(100, offset))
    assert st.read_image(tmp_path / "a.png").shape == (2, 3, 3)


# --- layers ---------------------------------------------------------------------------------------

NUMBERS = np.random.default_rng(1).uniform(0, 1, (2, 3, 9)).astype(np.float32)


def test_the_colours_of_a_layer_are_found_by_their_names(tmp_path):
    names = ("A", "beauty.R", "beauty.G", "beauty.B")
    numbers = NUMBERS[..., :4].copy()
    numbers[..., 0] = 1
    write_raw(tmp_path / "a.exr", numbers, names=names)
    np.testing.assert_array_equal(st.read_image(tmp_path / "a.exr"), numbers[..., 1:])
    for layer in ("beauty",):
        found = st.read_image(tmp_path / "a.exr", layer=layer)
        np.testing.assert_array_equal(found, numbers[..., 1:])
    assert refused(tmp_path / "a.exr", layer="spec") == "there is no layer 'spec', only 'beauty'"


@pytest.mark.parametrize(
    ("names", "taken", "others"),
    [
        (("R", "G", "B", "spec.R", "spec.G", "spec.B"), "", "'', 'spec'"),
        (("ao.R", "ao.G", "ao.B", "v.Combined.R", "v.Combined.G", "v.Combined.B"), "v.Combined",
         "'ao', 'v.Combined'"),
        (("left.R", "left.G", "left.B", "right.R", "right.G", "right.B"), "left",
         "'left', 'right'"),
        (("b.red", "b.green", "b.blue", "a.r", "a.g", "a.b"), None, "'a', 'b'"),
        (("Y", "n.Y", "d.Z", "q.G", "N.X", "N.Y", "N.Z"), None, "'', 'n'"),
    ],
)  # fmt: skip
def test_where_several_layers_could_be_meant_it_says_which(names, taken, others, tmp_path):
    file = tmp_path / "a.exr"
    write_raw(file, NUMBERS[..., :6], names=names)
    image, (said,) = warned(file)
    assert said.startswith(f"of the layers {others} read '") and "layer= (fit --layer)" in said
    if taken is not None:
        assert f"read {taken!r}: " in said
        np.testing.assert_array_equal(st.read_image(file, layer=taken), image)
    if names[0] in ("R", "left.R"):
        np.testing.assert_array_equal(image, NUMBERS[..., :3])
        other = "spec" if names[0] == "R" else "right"
        np.testing.assert_array_equal(st.read_image(file, layer=other), NUMBERS[..., 3:6])


def test_other_channels_beside_the_colours_are_no_layers(tmp_path):
    names = ("R", "G", "B", "Z", "N.X", "N.Z", "uv.U", "id.R")
    write_raw(tmp_path / "a.exr", NUMBERS[..., :8], names=names)
    np.testing.assert_array_equal(st.read_image(tmp_path / "a.exr"), NUMBERS[..., :3])


@pytest.mark.parametrize("names", [("R", "G"), ("Z",), ("X", "Y2", "Z"), ("u.R", "v.G", "w.B")])
def test_channels_that_make_no_picture_are_named(names, tmp_path):
    write_raw(tmp_path / "a.exr", NUMBERS[..., : len(names)], names=names)
    said = refused(tmp_path / "a.exr")
    assert said.startswith("expected a picture of red, green and blue, or grey, got the channels ")
    assert all(name in said for name in names)


def test_brightness_and_colour_apart_are_refused(tmp_path):
    write_raw(tmp_path / "a.exr", NUMBERS[..., :3], names=("Y", "RY", "BY"))
    assert "got the channels" in refused(tmp_path / "a.exr")


def test_brightness_alone_is_grey(tmp_path):
    write_raw(tmp_path / "a.exr", NUMBERS[..., :1], names=("Y",))
    grey = np.repeat(NUMBERS[..., :1], 3, axis=-1)
    np.testing.assert_array_equal(st.read_image(tmp_path / "a.exr"), grey)


def test_two_views_are_named(tmp_path):
    file, views = tmp_path / "a.exr", (NUMBERS[..., :3], NUMBERS[..., 3:6])
    parts = [{"oiio:subimagename": name, "view": name} for name in ("left", "right")]
    write_parts(file, *zip(views, parts, strict=True))
    image, (said,) = warned(file)
    assert said == "of the layers 'left', 'right' read 'left': layer= (fit --layer) names another"
    np.testing.assert_array_equal(image, views[0])
    for name, view in zip(("left", "right"), views, strict=True):
        np.testing.assert_array_equal(st.read_image(file, layer=name), view)
    np.testing.assert_array_equal(st.read_image(file, layer="2"), views[1])
    assert "no layer 'up', only 'left', 'right'" in refused(file, layer="up")


def test_layers_of_the_same_name_in_two_parts_are_told_apart(tmp_path):
    file, names = tmp_path / "a.exr", ("beauty.R", "beauty.G", "beauty.B")
    parts = [{"oiio:subimagename": name, "names": names} for name in ("left", "right")]
    write_parts(file, (NUMBERS[..., :3], parts[0]), (NUMBERS[..., 3:6], parts[1]))
    _, (said,) = warned(file)
    assert said.startswith("of the layers 'left.beauty', 'right.beauty' read 'left.beauty'")
    found = st.read_image(file, layer="right.beauty")
    np.testing.assert_array_equal(found, NUMBERS[..., 3:6])


def test_a_part_without_colours_is_no_layer(tmp_path):
    parts = [{"oiio:subimagename": "depth", "names": ("Z",)}, {"oiio:subimagename": "rgba"}]
    write_parts(tmp_path / "a.exr", (NUMBERS[..., :1], parts[0]), (NUMBERS[..., 3:6], parts[1]))
    np.testing.assert_array_equal(st.read_image(tmp_path / "a.exr"), NUMBERS[..., 3:6])


def test_pages_are_named_by_number(tmp_path):
    pages = [np.full((2, 3, 3), value, np.uint8) for value in (10, 100, 200)]
    write_parts(tmp_path / "a.tif", *((page, {}) for page in pages))
    image, (said,) = warned(tmp_path / "a.tif")
    assert said.startswith("of the layers '1', '2', '3' read '1'")
    np.testing.assert_allclose(image, decode(10 / 255), rtol=0, atol=1e-6)
    third = st.read_image(tmp_path / "a.tif", layer="3")
    np.testing.assert_allclose(third, decode(200 / 255), rtol=0, atol=1e-6)


def test_small_copies_are_not_the_picture(tmp_path):
    small, large = np.full((3, 4, 3), 10, np.uint8), np.full((6, 8, 3), 200, np.uint8)
    parts = ((small, {"tiff:subfiletype": 1}), (large, {}))
    write_parts(tmp_path / "a.tif", *parts)
    image = st.read_image(tmp_path / "a.tif")
    assert image.shape == (6, 8, 3)
    write_parts(tmp_path / "a.tif", parts[0])
    assert refused(tmp_path / "a.tif").endswith("as raw files of cameras have it")


@pytest.mark.parametrize("ending", [".webp", ".png"])
def test_an_animation_says_that_it_is_one(ending, tmp_path):
    first, *more = (Image.new("RGB", (9, 7), color) for color in ("black", "white", "black"))
    first.save(tmp_path / f"a{ending}", save_all=True, append_images=more, lossless=True)
    image, (said,) = warned(tmp_path / f"a{ending}")
    assert image.shape == (7, 9, 3) and image.max() < 0.01
    expected = "of its 3 frames read the first" if ending == ".png" else "of the layers '1', '2', "
    assert said.startswith(expected)


def test_a_deep_picture_is_refused(tmp_path):
    write_deep(tmp_path / "a.exr")
    assert refused(tmp_path / "a.exr").startswith("it is a deep picture")


# --- content, alpha, pixels -----------------------------------------------------------------------


@pytest.mark.parametrize("ending", [".png", ".exr", ".hdr", ".jpg", ".tif", ".txt", ""])
@pytest.mark.parametrize("content", [".exr", ".png", ".jpg", ".tif", ".hdr", ".pfm", ".bmp"])
def test_the_content_decides_and_not_the_ending(content, ending, tmp_path):
    floating = content in (".exr", ".hdr", ".pfm")
    numbers = np.full((16, 16, 3), 0.25 if floating else 100, np.float32 if floating else np.uint8)
    write_raw(tmp_path / f"a{content}", numbers)
    file = tmp_path / f"b{ending}"
    (tmp_path / f"a{content}").rename(file)
    expected = 0.25 if floating else decode(100 / 255)
    np.testing.assert_allclose(st.read_image(file), expected, rtol=0, atol=2e-3)


@pytest.mark.parametrize("ending", [".png", ".webp", ".tga", ".bmp", ".tif", ".dds"])
def test_transparent_pixels_are_read_over_black_and_named(ending, tmp_path):
    numbers = np.array([[[200, 100, 50, 255], [200, 100, 50, 128], [200, 100, 50, 0]]], np.uint8)
    numbers = numbers.repeat(4, 0)
    more = {"lossless": True, "exact": True} if ending == ".webp" else {}
    more |= {"tiffinfo": {338: 2}} if ending == ".tif" else {}
    Image.fromarray(numbers).save(tmp_path / f"a{ending}", **more)
    image, (said,) = warned(tmp_path / f"a{ending}")
    expected = decode(numbers[..., :3] / 255) * (numbers[..., 3:] / 255)
    np.testing.assert_allclose(image, expected, rtol=0, atol=1e-6)
    assert said.startswith("8 of 12 pixels are transparent, and read as over black")


def test_colours_that_were_multiplied_before_they_were_coded_are_divided_first(tmp_path):
    numbers = np.array([[[100, 50, 25, 128], [0, 0, 0, 0], [200, 100, 50, 255]]], np.uint8)
    write_raw(tmp_path / "a.tif", numbers, alpha=3)
    image, _ = warned(tmp_path / "a.tif")
    alpha = numbers[..., 3:] / 255
    expected = decode(numbers[..., :3] / 255 / np.maximum(alpha, 1e-9)) * alpha
    np.testing.assert_allclose(image, expected, rtol=0, atol=1e-6)


def test_opaque_pictures_are_read_without_a_word(tmp_path, recwarn):
    numbers = np.full((2, 3, 4), 255, np.uint8)
    write_raw(tmp_path / "a.png", numbers, alpha=3, oiio__UnassociatedAlpha=1)
    st.read_image(tmp_path / "a.png")
    assert not recwarn.list


def test_pixels_that_are_no_squares_are_named(tmp_path):
    write_raw(tmp_path / "a.exr", NUMBERS[..., :3], PixelAspectRatio=2.0)
    _, (said,) = warned(tmp_path / "a.exr")
    assert said == "its pixels are 2 times as wide as high: read as squares"


@pytest.mark.parametrize("depth", [1, 2, 4, 8, 16])
@pytest.mark.parametrize("interlaced", [0, 1])
def test_greys_of_every_depth_are_read(depth, interlaced, tmp_path):
    row = b"\0" + bytes([0b11100100] * ((4 * depth + 7) // 8))
    # of 4 x 1 pixels the passes hold the columns 0, then 2, then 1 and 3: one row each
    rows = row if not interlaced else b"".join(b"\0" + bytes(-(-n * depth // 8)) for n in (1, 1, 2))
    file = tmp_path / "a.png"
    file.write_bytes(png(4, 1, rows, depth=depth, color=0, interlaced=interlaced))
    read_png(file).check_pixels()
    assert st.read_image(file).shape == (1, 4, 3)


def test_numbers_beside_the_finite_stay_what_they_are(tmp_path):
    numbers = np.array([[[np.nan, np.inf, -np.inf, 0.5]]], np.float32)
    write_raw(tmp_path / "a.exr", numbers, alpha=3)
    image, _ = warned(tmp_path / "a.exr")
    np.testing.assert_array_equal(image, numbers[..., :3])


# --- libraries do not speak -----------------------------------------------------------------------

ROW = b"\0" + bytes(9)


@pytest.mark.parametrize(
    "content",
    [
        png(3, 2, b"\x09" + bytes(9) + ROW),
        png(3, 2, ROW),
        png(3, 2, ROW * 2, chunk(b"ABCD", b"")),
        png(3, 2, ROW * 2, chunk(b"a\0cd", b"")),
        png(3, 2, ROW * 2)[:50],
        png(3, 2, b"").replace(zlib.compress(b""), bytes(8)),
        flat_png(1).replace(b"IDAT", b"tEXt"),
        flat_png(1)[:8] + flat_png(1)[33:],
        png(3, 2, b"\0\0" * 2, color=3),
        png(3, 2, ROW * 2, depth=4),
        png(1_000_001, 1, ROW),
        flat_png(1)[:-14] + b"??" + flat_png(1)[-12:],
    ],
)
def test_broken_png_files_are_refused_without_a_word_of_libpng(content, tmp_path, capfd):
    (tmp_path / "a.png").write_bytes(content)
    assert refused(tmp_path / "a.png")
    assert capfd.readouterr() == ("", "")


THREADS = """
import os, sys, threading
import spheretrace_jax as st

before = os.fstat(2)
read = lambda: [st.read_image("good.png") for _ in range(30)]
threads = [threading.Thread(target=read) for _ in range(4)]
for thread in threads:
    thread.start()
while any(thread.is_alive() for thread in threads):
    assert os.path.samestat(os.fstat(2), before)
assert os.path.samestat(os.fstat(2), before)
print("still here", file=sys.stderr)
"""


def test_threads_leave_standard_error_alone(tmp_path):
    (tmp_path / "good.png").write_bytes(flat_png(100))
    done = subprocess.run(
        [sys.executable, "-c", THREADS], cwd=tmp_path, capture_output=True, text=True,
        env=os.environ | {"JAX_PLATFORMS": "cpu"},
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "still here\n")
