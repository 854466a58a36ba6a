"""Pictures: what is written is read again, what cannot be is refused, no file is half written."""

import dataclasses
import os
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
from helpers.picture_files import decode, png, write_raw

import spheretrace_jax as st
from spheretrace_jax.files import image_reader, images
from spheretrace_jax.files.atomic import replacing, write_text
from spheretrace_jax.files.images import check_writable, to_srgb

ENDINGS = (".exr", ".hdr", ".png", ".ppm", ".tif", ".tiff", ".jpg", ".jpeg")
STEEPEST = 2.275  # slope of sRGB's curve, from coded to linear, at 1


def noise(height: int = 5, width: int = 7, most: float = 1.0) -> np.ndarray:
    rng = np.random.default_rng(height * width)
    return rng.uniform(0, most, (height, width, 3)).astype(np.float32)


def read_raw(file: Path) -> np.ndarray:
    source = oiio.ImageInput.open(str(file))
    numbers = source.read_image(source.spec().format)
    source.close()
    return numbers


# --- written, then read ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ending", "bits", "error"),
    [  # half a step of the file's numbers, seen through the curve where it is steepest
        (".exr", None, 0),
        (".exr", 32, 0),
        (".exr", 16, 2**-12),
        (".png", None, 0.5 / 255 * STEEPEST),
        (".png", 8, 0.5 / 255 * STEEPEST),
        (".png", 16, 0.5 / 65535 * STEEPEST),
        (".ppm", 8, 0.5 / 255 * STEEPEST),
        (".ppm", 16, 0.5 / 65535 * STEEPEST),
        (".tif", 8, 0.5 / 255 * STEEPEST),
        (".tiff", 16, 0.5 / 65535 * STEEPEST),
        (".tif", 32, 0),
        (".hdr", None, 2**-8),
    ],
)
def test_a_picture_is_read_as_it_was_written(ending, bits, error, tmp_path):
    file = tmp_path / f"a{ending}"
    image = noise()
    st.write_image(file, image, bits=bits)
    found = st.read_image(file)
    assert found.dtype == np.float32 and found.shape == image.shape
    exact = error == 0 and ending == ".exr"
    assert np.abs(found - image).max() <= (0 if exact else error + 2e-6)


@pytest.mark.parametrize("ending", [".jpg", ".jpeg"])
def test_jpeg_keeps_smooth_pictures_to_a_few_steps(ending, tmp_path):
    ramp = np.linspace(0, 1, 32, dtype=np.float32)
    image = np.stack([*np.meshgrid(ramp, ramp), np.full((32, 32), 0.5, np.float32)], axis=-1)
    st.write_image(tmp_path / f"a{ending}", image)
    found = st.read_image(tmp_path / f"a{ending}")
    assert np.abs(to_srgb(found) - to_srgb(image)).max() < 8 / 255


@pytest.mark.parametrize("ending", [".exr", ".hdr"])
def test_floating_files_hold_numbers_beyond_1(ending, tmp_path):
    image = noise(most=1000.0)
    st.write_image(tmp_path / f"a{ending}", image)
    np.testing.assert_allclose(
        st.read_image(tmp_path / f"a{ending}"), image, rtol=0, atol=1024 * 2**-8
    )


@pytest.mark.parametrize("ending", [".png", ".ppm", ".tif", ".jpg"])
def test_integer_files_clip_to_0_and_1(ending, tmp_path):
    image = np.full((8, 8, 3), 1.7, np.float32)
    image[4:] = -0.3
    st.write_image(tmp_path / f"a{ending}", image)
    found = read_raw(tmp_path / f"a{ending}")
    assert (found[:4] == 255).all() and (found[4:] == 0).all()


def test_what_jax_rendered_is_written_as_it_is(tmp_path):
    scene = st.Scene(st.Spheres([[0.0, 0, 0]], [100.0]), st.Lights([[0.0, 0, 900]]))
    picture = st.render(scene, width=6, height=4)
    st.write_image(tmp_path / "a.exr", picture)
    np.testing.assert_array_equal(
        st.read_image(tmp_path / "a.exr"), np.asarray(picture).astype(np.float32)
    )


@pytest.mark.parametrize("ending", ENDINGS)
def test_row_0_is_the_top_and_column_0_the_left(ending, tmp_path):
    image = np.zeros((16, 24, 3), np.float32)
    image[:8, :8] = (1, 0, 0)
    image[:8, 16:] = (0, 1, 0)
    image[8:, :8] = (0, 0, 1)
    st.write_image(tmp_path / f"a{ending}", image)
    found = st.read_image(tmp_path / f"a{ending}")
    corners = found[[4, 4, 12, 12], [4, 20, 4, 20]]
    np.testing.assert_allclose(corners, [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]], atol=0.02)


def test_the_first_bytes_of_a_ppm_are_its_top_row(tmp_path):
    image = np.zeros((2, 1, 3), np.float32)
    image[0] = 1
    st.write_image(tmp_path / "a.ppm", image)
    assert (tmp_path / "a.ppm").read_bytes().endswith(b"\xff\xff\xff\0\0\0")


def test_endings_may_be_in_capitals(tmp_path):
    for ending in (".PNG", ".Exr"):
        st.write_image(tmp_path / f"a{ending}", noise())
        assert st.read_image(tmp_path / f"a{ending}").shape == (5, 7, 3)


# --- colours --------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_coded_numbers_are_decoded_by_the_formula_of_srgb(dtype, tmp_path):
    most = np.iinfo(dtype).max
    numbers = np.arange(0, most + 1, max(1, most // 255)).astype(dtype)
    write_raw(tmp_path / "a.png", np.repeat(numbers[None, :, None], 3, axis=2))
    found = st.read_image(tmp_path / "a.png")
    exact = np.repeat(decode(numbers / most)[None, :, None], 3, axis=2)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-6)
    assert found.max() <= 1


@pytest.mark.parametrize("bits", [8, 16])
def test_linear_numbers_are_coded_by_the_formula_of_srgb(bits, tmp_path):
    most = 2**bits - 1
    numbers = np.linspace(0, most, 300).round()
    image = np.repeat(decode(numbers / most).astype(np.float32)[None, :, None], 3, axis=2)
    st.write_image(tmp_path / "a.png", image, bits=bits)
    off = np.abs(read_raw(tmp_path / "a.png") - numbers[None, :, None]).max()
    assert off <= (0 if bits == 8 else 1)


@pytest.mark.parametrize("ending", [".exr", ".hdr", ".png", ".ppm", ".tif"])
@pytest.mark.parametrize("colorspace", ["auto", "linear", "srgb"])
def test_colorspace_says_how_the_file_s_numbers_are_coded(colorspace, ending, tmp_path):
    file = tmp_path / f"a{ending}"
    st.write_image(file, np.full((3, 4, 3), decode(0.5), np.float32), colorspace=colorspace)
    linear = colorspace == "linear" or (colorspace == "auto" and ending in (".exr", ".hdr"))
    stored = st.read_image(file, "linear")  # the file's numbers as they are
    np.testing.assert_allclose(stored, decode(0.5) if linear else 0.5, rtol=0, atol=1 / 255)
    np.testing.assert_allclose(st.read_image(file, colorspace), decode(0.5), rtol=0, atol=1 / 255)


def test_what_ocio_says_in_the_environment_changes_no_colour(tmp_path):
    write_raw(tmp_path / "a.png", np.full((2, 2, 3), 100, np.uint8))
    program = "import spheretrace_jax as st; print(float(st.read_image('a.png')[0, 0, 0]))"
    result = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        env=os.environ | {"OCIO": "nowhere.ocio", "JAX_PLATFORMS": "cpu"},
        capture_output=True,
        text=True,
    )
    assert abs(float(result.stdout) - decode(100 / 255)) < 1e-6, result.stderr


def test_pictures_for_showing_are_coded(tmp_path):
    image = noise()
    np.testing.assert_allclose(decode(to_srgb(image)), image, rtol=0, atol=2e-6)


# --- what other programs write --------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_alpha_is_over_black_and_multiplied_after_decoding(dtype, tmp_path):
    most = np.iinfo(dtype).max
    fraction = np.array([[[1.0, 0.8, 0.2, 1.0], [1.0, 0.8, 0.2, 0.4], [1.0, 0.8, 0.2, 0.0]]])
    numbers = (fraction * most).round().astype(dtype)
    write_raw(tmp_path / "a.png", numbers, alpha=3, oiio__UnassociatedAlpha=1)
    stored = numbers / most
    np.testing.assert_allclose(
        st.read_image(tmp_path / "a.png"),
        decode(stored[..., :3]) * stored[..., 3:],
        rtol=0,
        atol=1e-6,
    )


def test_an_exr_with_alpha_is_multiplied_already(tmp_path):
    numbers = np.array([[[0.5, 0.4, 0.1, 0.5], [0.2, 0.1, 0.0, 0.25]]], np.float32)
    write_raw(tmp_path / "a.exr", numbers, alpha=3)
    np.testing.assert_array_equal(st.read_image(tmp_path / "a.exr"), numbers[..., :3])


@pytest.mark.parametrize(
    ("ending", "dtype"), [(".png", np.uint8), (".png", np.uint16), (".tif", np.uint8)]
)
def test_one_channel_is_grey(ending, dtype, tmp_path):
    numbers = np.linspace(0, np.iinfo(dtype).max, 12).astype(dtype).reshape(3, 4, 1)
    write_raw(tmp_path / f"a{ending}", numbers)
    expected = np.repeat(decode(numbers / np.iinfo(dtype).max), 3, axis=-1)
    found = st.read_image(tmp_path / f"a{ending}")
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


def test_grey_with_alpha_is_grey_over_black(tmp_path):
    numbers = np.array([[[200, 255], [200, 51], [90, 0]]], np.uint8)
    write_raw(tmp_path / "a.png", numbers, alpha=1, oiio__UnassociatedAlpha=1)
    grey = decode(numbers[..., :1] / 255) * (numbers[..., 1:] / 255)
    found = st.read_image(tmp_path / "a.png")
    np.testing.assert_allclose(found, np.repeat(grey, 3, axis=-1), rtol=0, atol=1e-6)


def test_channels_after_the_third_that_are_no_alpha_are_left_out(tmp_path):
    numbers = np.random.default_rng(0).uniform(0, 1, (3, 4, 5)).astype(np.float32)
    write_raw(tmp_path / "a.exr", numbers)
    np.testing.assert_array_equal(st.read_image(tmp_path / "a.exr"), numbers[..., :3])


def test_black_and_white_of_one_bit_are_read(tmp_path):
    (tmp_path / "a.pbm").write_text("P1\n3 2\n0 1 0\n1 0 1\n")
    grey = st.read_image(tmp_path / "a.pbm")[..., 0]
    np.testing.assert_allclose(grey, [[1, 0, 1], [0, 1, 0]], rtol=0, atol=1e-6)


# --- metadata -------------------------------------------------------------------------------------

TEXT = "-.01 .01 500 800 // θ φ\n1\n0\n0\n"


def attributes(file: Path) -> dict:
    source = oiio.ImageInput.open(str(file))
    found = {a.name: a.value for a in source.spec().extra_attribs}
    source.close()
    return found


@pytest.mark.parametrize("ending", [".exr", ".png", ".tif", ".jpg"])
def test_pictures_hold_the_scene_the_version_and_the_colour_space(ending, tmp_path):
    for colorspace in ("linear", "srgb"):
        file = tmp_path / f"{colorspace}{ending}"
        st.write_image(file, noise(), scene=TEXT, colorspace=colorspace)
        found = attributes(file)
        assert found["ImageDescription"] == TEXT
        assert found["Software"] == f"spheretrace_jax {st.__version__}"
        if ending == ".exr":
            assert found["oiio:ColorSpace"].startswith("lin" if colorspace == "linear" else "srgb")


def test_a_picture_without_a_scene_has_no_description(tmp_path):
    st.write_image(tmp_path / "a.exr", noise())
    assert "ImageDescription" not in attributes(tmp_path / "a.exr")


@pytest.mark.parametrize("ending", ENDINGS)
def test_long_scenes_are_held_whole_or_not_at_all(ending, tmp_path):
    text = TEXT * 10_000  # of which libjpeg would end the program, and TIFF cut off a part
    st.write_image(tmp_path / f"a{ending}", noise(), scene=text)
    held = ending in (".exr", ".png")
    assert attributes(tmp_path / f"a{ending}").get("ImageDescription") == (text if held else None)
    assert st.read_image(tmp_path / f"a{ending}").shape == (5, 7, 3)


# --- what cannot be read --------------------------------------------------------------------------


def refused(file: Path, colorspace="auto") -> str:
    """Returns the error message of a file after its name."""
    with pytest.raises(st.PictureError) as error:
        st.read_image(file, colorspace)
    said = str(error.value)
    assert said.startswith(f"{file}: ") and "\n" not in said
    return said.removeprefix(f"{file}: ")


def test_missing_files_and_folders_are_refused(tmp_path):
    assert refused(tmp_path / "no.png") == "there is no such picture"
    assert refused(tmp_path / "no" / "no.png") == "there is no such picture"
    assert refused(tmp_path) == "expected a picture, this is a folder"


@pytest.mark.parametrize("ending", [*ENDINGS, ".txt", ""])
@pytest.mark.parametrize(
    "content", [b"", b"1 2 3\n", bytes(range(256)) * 9], ids=["0", "text", "b"]
)
def test_what_is_no_picture_is_refused(content, ending, tmp_path, capfd):
    file = tmp_path / f"a{ending}"
    file.write_bytes(content)
    assert refused(file).startswith("cannot be read as a picture: ")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("part", [0.02, 0.5, 0.9])
@pytest.mark.parametrize("ending", [".exr", ".hdr", ".png", ".ppm", ".jpg", ".tif"])
def test_pictures_that_were_cut_off_are_refused(ending, part, tmp_path, capfd):
    file = tmp_path / f"a{ending}"
    st.write_image(file, noise(32, 32))
    content = file.read_bytes()
    file.write_bytes(content[: int(len(content) * part)])
    assert refused(file).startswith("cannot be read as a picture: ")
    assert capfd.readouterr() == ("", ""), "libraries must not speak for themselves"


@pytest.mark.parametrize(
    "content",
    [
        png(40_000, 40_000),
        png(40_000, 40_000, b"\0" * 1_000_000),
        png(2**31 - 1, 2**31 - 1),
        png(0, 5),
        b"P6\n40000 40000\n255\n",
        b"P6\n9999999999 9999999999\n255\n" + b"\0" * 10_000,
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 40000 +X 40000\n",
    ],
    ids=["PNG", "PNG with data", "largest PNG", "no PNG", "PPM", "PPM with data", "HDR"],
)
def test_headers_that_promise_too_much_are_refused(content, tmp_path, capfd):
    ending = {b"P": ".ppm", b"#": ".hdr"}.get(content[:1], ".png")
    (tmp_path / f"a{ending}").write_bytes(content)
    assert refused(tmp_path / f"a{ending}")
    assert capfd.readouterr() == ("", "")


def test_pictures_with_too_many_pixels_are_refused(tmp_path, monkeypatch):
    st.write_image(tmp_path / "a.png", noise())
    monkeypatch.setattr(image_reader, "MOST_PIXELS", 34)
    assert refused(tmp_path / "a.png") == "expected a picture of at most 34 pixels, got 7 x 5 x 1"
    monkeypatch.setattr(image_reader, "MOST_PIXELS", 35)
    assert st.read_image(tmp_path / "a.png").shape == (5, 7, 3)


def test_a_gif_is_refused(tmp_path):
    (tmp_path / "a.png").write_bytes(b"GIF89a" + struct.pack("<HH", 32_000, 32_000) + b"\0" * 99)
    assert refused(tmp_path / "a.png") == "cannot be read as a picture: GIF files are not read"


def test_names_that_are_no_utf_8_are_refused(tmp_path):
    file = tmp_path / "\udcff.png"
    for use in (lambda: st.write_image(file, noise()), lambda: st.read_image(file)):
        with pytest.raises(
            st.PictureError, match=r"udcff\.png: the name of a picture must be UTF-8$"
        ):
            use()


def test_a_name_that_is_too_long_is_of_no_picture(tmp_path):
    assert refused(tmp_path / ("x" * 300)) == "there is no such picture"


@pytest.mark.parametrize("dtype", [np.uint8, bool, complex])
def test_pictures_of_other_numbers_are_not_written(dtype, tmp_path):
    with pytest.raises(st.PictureError, match=r"a\.png: expected linear floating numbers, got "):
        st.write_image(tmp_path / "a.png", np.ones((2, 2, 3), dtype))


@pytest.mark.slow
def test_black_pictures_in_few_bytes_are_read(tmp_path):
    """Reads the files with the most pixels per byte."""
    black = np.zeros((2048, 2048, 1), np.uint8)
    write_raw(tmp_path / "a.png", black)
    write_raw(tmp_path / "a.jpg", black, jpeg__progressive=1, compression="jpeg:1")
    write_raw(tmp_path / "a.tif", black, oiio__BitsPerSample=1, compression="ccittfax4")
    for name in ("a.png", "a.jpg", "a.tif"):
        assert st.read_image(tmp_path / name).shape == (2048, 2048, 3)


def test_unknown_colour_spaces_are_refused(tmp_path):
    st.write_image(tmp_path / "a.png", noise())
    message = "colorspace must be one of auto, linear, srgb, got 'rgb'"
    # the checks behind the types, which a caller without beartype reaches
    with pytest.raises(st.InputError, match=message):
        images._check_colorspace.__wrapped__("rgb")


# --- what cannot be written -----------------------------------------------------------------------


@pytest.mark.parametrize(
    "shape", [(5, 7), (5, 7, 1), (5, 7, 4), (3, 5, 7), (0, 7, 3), (5, 0, 3), (1, 5, 7, 3)]
)
def test_other_shapes_than_those_of_pictures_are_refused(shape, tmp_path):
    with pytest.raises(st.PictureError) as error:
        st.write_image(tmp_path / "a.png", np.zeros(shape, np.float32))
    expected = f"expected a picture of shape (height, width, 3), got {shape}"
    assert str(error.value) == f"{tmp_path / 'a.png'}: {expected}"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("write", [lambda f: st.write_image(f, noise()), check_writable])
@pytest.mark.parametrize("name", ["a.gif", "a.txt", "a", "a.png.gz", "png"])
def test_unknown_endings_are_refused(name, write, tmp_path):
    with pytest.raises(st.PictureError, match="expected a picture file") as error:
        write(tmp_path / name)
    assert str(error.value).endswith(f"got {Path(name).suffix!r}")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("ending", "bits", "message"),
    [
        (".png", 32, ".png files have 8 or 16 bits, got 32"),
        (".png", 0, ".png files have 8 or 16 bits, got 0"),
        (".ppm", 32, ".ppm files have 8 or 16 bits, got 32"),
        (".tif", 64, ".tif files have 8 or 16 or 32 bits, got 64"),
        (".jpg", 16, ".jpg files have 8 bits, got 16"),
        (".exr", 8, ".exr files have 32 or 16 bits, got 8"),
        (".hdr", 16, ".hdr files have 32 bits, got 16"),
    ],
)
def test_bits_that_a_format_has_not_are_refused(ending, bits, message, tmp_path):
    for write in (
        lambda f: st.write_image(f, noise(), bits=bits),
        lambda f: check_writable(f, bits),
    ):
        with pytest.raises(st.PictureError) as error:
            write(tmp_path / f"a{ending}")
        assert str(error.value) == f"{tmp_path / f'a{ending}'}: {message}"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("write", [lambda f: st.write_image(f, noise()), check_writable])
def test_there_must_be_a_place_for_the_file(write, tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        write(tmp_path / "no" / "a.png")
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(IsADirectoryError, match="expected a file to write, this is a folder"):
        write(tmp_path / "folder.png")
    os.mkfifo(tmp_path / "pipe.png")
    with pytest.raises(OSError, match="expected a file to write, this is a device or a pipe"):
        write(tmp_path / "pipe.png")
    assert sorted(f.name for f in tmp_path.iterdir()) == ["folder.png", "pipe.png"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_protected_folder_is_named_as_such(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(PermissionError, match="cannot be written to"):
        check_writable(tmp_path / "a.png")


# --- whole or not at all --------------------------------------------------------------------------


def test_a_failure_keeps_the_old_file_and_leaves_no_other(tmp_path):
    file = tmp_path / "a.txt"
    file.write_text("old")
    with pytest.raises(ZeroDivisionError), replacing(file) as temporary:
        temporary.write_text("half of the new")
        _ = 1 / 0
    assert file.read_text() == "old" and list(tmp_path.iterdir()) == [file]


def test_an_interrupt_keeps_the_old_file_and_leaves_no_other(tmp_path):
    file = tmp_path / "a.txt"
    file.write_text("old")
    with pytest.raises(KeyboardInterrupt), replacing(file) as temporary:
        temporary.write_text("half of the new")
        raise KeyboardInterrupt
    assert file.read_text() == "old" and list(tmp_path.iterdir()) == [file]


def test_success_replaces_the_old_file_and_leaves_no_other(tmp_path):
    file = tmp_path / ("long name " * 20 + ".txt")
    file.write_text("old")
    write_text(file, "new")
    assert file.read_text() == "new" and list(tmp_path.iterdir()) == [file]


def test_files_are_readable_by_whom_the_umask_allows(tmp_path):
    before = os.umask(0o027)
    try:
        write_text(tmp_path / "a.txt", "")
    finally:
        os.umask(before)
    assert (tmp_path / "a.txt").stat().st_mode & 0o777 == 0o640


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "there").mkdir()
    link, file = tmp_path / "link.txt", tmp_path / "there" / "file.txt"
    link.symlink_to(file)
    write_text(link, "new")
    assert link.is_symlink() and file.read_text() == "new"
    assert list(file.parent.iterdir()) == [file]


def test_a_picture_that_the_library_refuses_keeps_the_old_one(tmp_path, monkeypatch):
    file = tmp_path / "a.png"
    st.write_image(file, noise())
    before = file.read_bytes()
    changed = dataclasses.replace(images.PICTURE_FORMATS[".png"], attributes={"oiio:dummy": 1})
    monkeypatch.setitem(images.PICTURE_FORMATS, ".png", changed)
    monkeypatch.setattr(oiio.ImageOutput, "write_image", lambda *_: False)
    with pytest.raises(st.PictureError, match=r"a\.png: cannot be written: "):
        st.write_image(file, noise(6, 6))
    assert file.read_bytes() == before and list(tmp_path.iterdir()) == [file]


FULL_DISK = """
import os, resource, numpy as np, spheretrace_jax as st
image = np.random.default_rng(0).uniform(0, 1, (64, 64, 3))
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
for name in sorted(os.listdir()):
    try:
        st.write_image(name, image) if name != "scene.txt" else st.save_scene(
            name, st.Scene(st.Spheres(np.zeros((200, 3)), np.ones(200)), st.Lights([[0.0, 0, 9]]))
        )
    except OSError as error:
        print(error)
"""


def test_a_full_disk_is_reported_and_keeps_every_old_file(tmp_path):
    pytest.importorskip("resource")
    names = sorted([*(f"a{ending}" for ending in ENDINGS), "scene.txt"])
    for name in names:
        (tmp_path / name).write_text("old")
    result = subprocess.run(
        [sys.executable, "-c", FULL_DISK],
        cwd=tmp_path,
        env=os.environ | {"JAX_PLATFORMS": "cpu"},
        capture_output=True,
        text=True,
    )
    expected = [f"[Errno 27] File too large: '{name}'" for name in names]
    assert result.stdout.splitlines() == expected, result.stderr
    assert sorted(f.name for f in tmp_path.iterdir()) == names
    assert {f.read_text() for f in tmp_path.iterdir()} == {"old"}


# --- masks ----------------------------------------------------------------------------------------


def test_a_mask_counts_from_half_on(tmp_path):
    values = np.array([[0, 1, 60, 127, 128, 200, 255]], np.uint8)
    write_raw(tmp_path / "a.png", values[..., None])
    assert st.read_mask(tmp_path / "a.png").tolist() == [[False] * 4 + [True] * 3]
    red = np.zeros((1, 7, 3), np.uint8)
    red[..., 0] = values
    write_raw(tmp_path / "a.png", red)
    assert st.read_mask(tmp_path / "a.png").tolist() == [[False] * 4 + [True] * 3]


def test_black_that_jpeg_made_grey_does_not_count(tmp_path):
    mask = np.zeros((48, 60, 3), np.uint8)
    mask[13:35, 21:43] = 255
    write_raw(tmp_path / "a.jpg", mask, compression="jpeg:50")
    assert (read_raw(tmp_path / "a.jpg")[mask == 0] > 0).sum() > 100
    np.testing.assert_array_equal(st.read_mask(tmp_path / "a.jpg"), mask[..., 0] > 0)


def test_alpha_is_a_mask_where_it_is_asked_for(tmp_path):
    numbers = np.full((1, 4, 4), 90, np.uint8)
    numbers[0, :, 3] = (0, 127, 128, 255)
    write_raw(tmp_path / "a.png", numbers, alpha=3, oiio__UnassociatedAlpha=1)
    assert st.read_mask(tmp_path / "a.png", alpha=True).tolist() == [[False, False, True, True]]
    write_raw(tmp_path / "b.png", numbers[..., :3])
    with pytest.raises(st.PictureError, match="has no alpha channel that could be the mask"):
        st.read_mask(tmp_path / "b.png", alpha=True)


def test_what_is_no_mask_is_named(tmp_path):
    write_raw(tmp_path / "a.png", np.linspace(60, 200, 35).astype(np.uint8).reshape(5, 7, 1))
    with pytest.raises(st.PictureError, match=r"got only greys from 0\.24 to 0\.78$"):
        st.read_mask(tmp_path / "a.png")
    write_raw(tmp_path / "a.png", np.linspace(0, 100, 35).astype(np.uint8).reshape(5, 7, 1))
    with pytest.raises(st.PictureError, match="no pixel of the mask counts"):
        st.read_mask(tmp_path / "a.png")
    write_raw(tmp_path / "a.png", np.linspace(0, 255, 35).astype(np.uint8).reshape(5, 7, 1))
    with pytest.warns(st.PictureWarning, match=r"black and white, \d\d% of its pixels are grey"):
        st.read_mask(tmp_path / "a.png")


# --- the file says how its numbers are coded ------------------------------------------------------


@pytest.mark.parametrize("colorspace", ["auto", "linear", "srgb"])
@pytest.mark.parametrize(
    ("ending", "bits"),
    [(".exr", 32), (".exr", 16), (".png", 8), (".png", 16), (".tif", 8), (".tif", 16),
     (".tif", 32), (".jpg", 8)],
)  # fmt: skip
def test_what_was_written_is_read_as_the_same_linear_numbers(ending, bits, colorspace, tmp_path):
    image = np.zeros((16, 16, 3), np.float32) + np.array([0.2, 0.5, 0.9], np.float32)
    st.write_image(tmp_path / f"a{ending}", image, colorspace=colorspace, bits=bits)
    steps = {8: 2.5 / 255 if ending == ".jpg" else 0.6 / 255, 16: 1e-3, 32: 2e-6}
    error = np.abs(st.read_image(tmp_path / f"a{ending}") - image).max()
    assert error <= steps[bits] * STEEPEST


def test_a_tiff_of_32_bits_holds_linear_numbers_beyond_1(tmp_path):
    image = noise(most=100.0) - 1
    st.write_image(tmp_path / "a.tif", image, bits=32)
    np.testing.assert_array_equal(read_raw(tmp_path / "a.tif"), image)
    np.testing.assert_array_equal(st.read_image(tmp_path / "a.tif"), image)


def test_what_a_format_cannot_say_is_named(tmp_path):
    for name, colorspace in (("a.ppm", "linear"), ("a.hdr", "srgb")):
        with pytest.warns(st.PictureWarning, match=f"cannot say .* with colorspace='{colorspace}'"):
            st.write_image(tmp_path / name, noise(), colorspace=colorspace)
