"""The colours of files: what their numbers mean is what they say."""

import struct

import numpy as np
import pytest
from helpers.picture_files import (
    ADOBE_D50,
    P3_D50,
    PROPHOTO_D50,
    SRGB_CURVE,
    SRGB_D50,
    chunk,
    decode,
    flat_png,
    gamma_curve,
    icc_profile,
    parametric_curve,
    png,
    table_curve,
    write_raw,
)
from PIL import Image

import spheretrace_jax as st
from spheretrace_jax.files.color_spaces import PRIMARIES, to_rec709
from spheretrace_jax.files.icc_profile import linear_profile, read_profile

# Matrices to linear Rec. 709 as published: Display P3 and Rec. 2020 (ITU-R BT.2407, CSS Color 4),
# ACEScg and ACES2065-1 (the ACES and Nuke documentation; whites adapted by Bradford).
PUBLISHED = {
    "p3d65": [[1.22494, -0.22494, 0], [-0.04206, 1.04206, 0], [-0.01964, -0.07864, 1.09828]],
    "rec2020": [[1.66049, -0.58764, -0.07285], [-0.12455, 1.13290, -0.00835],
                [-0.01815, -0.10058, 1.11873]],
    "adobergb": [[1.39836, -0.39836, 0], [0, 1, 0], [0, -0.04293, 1.04293]],
    "ap1": [[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055],
            [-0.02400, -0.12897, 1.15297]],
    "ap0": [[2.52169, -1.13413, -0.38756], [-0.27648, 1.37272, -0.09624],
            [-0.01538, -0.15298, 1.16835]],
    "rec709": np.eye(3),
    "ciexyzd65": [[3.24097, -1.53738, -0.49861], [-0.96924, 1.87597, 0.04156],
                  [0.05563, -0.20398, 1.05697]],
}  # fmt: skip

COLORS = np.array([[[200, 60, 30], [20, 180, 90]], [[90, 90, 90], [255, 255, 255]]], np.uint8)


@pytest.mark.parametrize("name", PUBLISHED)
def test_matrices_are_the_published_ones(name):
    np.testing.assert_allclose(to_rec709(PRIMARIES[name]), PUBLISHED[name], rtol=0, atol=3e-4)


def said_of(file, *colorspace) -> str:
    with pytest.raises(st.PictureError) as error:
        st.read_image(file, *colorspace)
    assert str(error.value).startswith(f"{file}: ") and str(error.value).isprintable()
    assert len(str(error.value)) < 1000
    return str(error.value)


# --- PNG ------------------------------------------------------------------------------------------

GAMA = lambda gamma: chunk(b"gAMA", struct.pack(">I", round(1e5 / gamma)))
CICP = lambda *numbers: chunk(b"cICP", bytes(numbers))
SRGB_CHUNK = chunk(b"sRGB", b"\0")
CODED = 29491 / 65535  # of 16 bits


@pytest.mark.parametrize(
    ("before", "linear"),
    [
        (b"", decode(CODED)),
        (GAMA(1), CODED),
        (GAMA(2.2), CODED**2.2),
        (GAMA(1.8), CODED**1.8),
        (GAMA(3), CODED**3),
        (SRGB_CHUNK, decode(CODED)),
        (GAMA(1) + SRGB_CHUNK, decode(CODED)),  # gAMA is for those who do not know sRGB
        (CICP(1, 13, 0, 1) + GAMA(1), decode(CODED)),
        (CICP(1, 8, 0, 1), CODED),
        (CICP(9, 8, 0, 1), CODED),
        (CICP(1, 4, 0, 1), CODED**2.2),
        (CICP(9, 1, 0, 1), ((CODED + 0.099) / 1.099) ** (1 / 0.45)),
        (CICP(2, 2, 0, 1), decode(CODED)),
    ],
)
def test_a_png_is_decoded_by_its_chunks(before, linear, tmp_path):
    (tmp_path / "a.png").write_bytes(flat_png(29491, before, depth=16))
    found = st.read_image(tmp_path / "a.png")
    # OpenImageIO reports a gamma of 1 / 0.33333 as 3.00003
    np.testing.assert_allclose(found, np.full((2, 3, 3), linear), rtol=0, atol=2e-5)
    np.testing.assert_allclose(st.read_image(tmp_path / "a.png", "linear"), CODED, atol=1e-6)


def test_a_png_of_other_primaries_is_converted(tmp_path):
    d65 = (31270, 32900)
    primaries = {"p3d65": (68000, 32000, 26500, 69000, 15000, 6000),
                 "rec709": (64000, 33000, 30000, 60000, 15000, 6000)}  # fmt: skip
    row = b"\0" + COLORS[0].tobytes()
    for name, numbers in primaries.items():
        before = GAMA(2.2) + chunk(b"cHRM", struct.pack(">8I", *d65, *numbers))
        (tmp_path / "a.png").write_bytes(png(2, 1, row, before))
        expected = (COLORS[:1] / 255) ** 2.2 @ np.transpose(PUBLISHED[name])
        found = st.read_image(tmp_path / "a.png")
        np.testing.assert_allclose(found, expected, rtol=0, atol=3e-4)


@pytest.mark.parametrize(
    ("before", "said"),
    [
        (CICP(9, 16, 0, 1), "their curve is number PQ (16) of H.273"),
        (CICP(9, 18, 0, 1), "their curve is number HLG (18) of H.273"),
        (CICP(4, 13, 0, 1), "their primaries are number 4 of H.273"),
        (CICP(1, 13, 0, 0), "they are of the narrow range of video"),
    ],
)
def test_codes_of_video_that_are_not_known_are_named(before, said, tmp_path):
    (tmp_path / "a.png").write_bytes(flat_png(100, before))
    assert said in said_of(tmp_path / "a.png")
    np.testing.assert_allclose(st.read_image(tmp_path / "a.png", "srgb"), decode(100 / 255), 1e-5)


# --- profiles -------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", [".png", ".tif", ".jpg", ".webp"])
@pytest.mark.parametrize(
    ("name", "columns", "curve", "decoded"),
    [
        ("p3d65", P3_D50, SRGB_CURVE, decode),
        ("adobergb", ADOBE_D50, gamma_curve(563 / 256), lambda x: x ** (563 / 256)),
        ("rec709", SRGB_D50, SRGB_CURVE, decode),
        ("rec709", SRGB_D50, table_curve(decode(np.linspace(0, 1, 1024))), decode),
        ("rec709", SRGB_D50, b"curv" + bytes(8), lambda x: x),
    ],
    ids=["Display P3", "Adobe RGB", "sRGB", "sRGB, a table", "linear"],
)
def test_colours_are_converted_by_the_profile(name, columns, curve, decoded, ending, tmp_path):
    file = tmp_path / f"a{ending}"
    flat = np.zeros((16, 16, 3), np.uint8) + COLORS[0, 0]  # which JPEG keeps
    lossless = {".jpg": "jpeg:100", ".webp": "lossless"}.get(ending, "zip")
    more = {"jpeg__subsampling": "4:4:4"} if ending == ".jpg" else {}
    write_raw(file, flat, ICCProfile=icc_profile(columns, curve), compression=lossless, **more)
    coded = st.read_image(file, "linear")
    np.testing.assert_allclose(coded * 255, flat, rtol=0, atol=1.01 if ending == ".jpg" else 1e-3)
    expected = decoded(coded) @ np.transpose(PUBLISHED[name])
    exact = 2e-6 if name == "rec709" else 3e-4  # profiles of sRGB are read as sRGB itself
    np.testing.assert_allclose(st.read_image(file), expected, rtol=0, atol=exact)


def test_white_and_greys_stay_what_they_are_in_every_profile(tmp_path):
    grey = np.repeat(np.arange(0, 256, 5, dtype=np.uint8)[None, :, None], 3, axis=2)
    for columns in (P3_D50, ADOBE_D50, PROPHOTO_D50):
        profile = icc_profile(columns, gamma_curve(460 / 256))
        write_raw(tmp_path / "a.png", grey, ICCProfile=profile)
        found = st.read_image(tmp_path / "a.png")
        np.testing.assert_allclose(found, (grey / 255) ** (460 / 256), rtol=0, atol=2e-6)


def test_saturation_that_a_conversion_hides_is_named(tmp_path, recwarn):
    """A saturated channel of wide primaries is at least 1 after conversion, but others may be."""
    numbers = np.array([[[255, 255, 255], [90, 80, 70], [254, 10, 10]]], np.uint8)
    write_raw(tmp_path / "a.png", numbers, ICCProfile=icc_profile(P3_D50))
    with pytest.warns(st.PictureWarning, match="1 pixels are saturated, which its colours"):
        found = st.read_image(tmp_path / "a.png")
    assert (found[0, 0] >= 0.999).all() and not (found[0, 1] >= 0.999).any()
    for quiet in (numbers[:, :2], numbers[:, 1:]):  # known as clipped; nothing is saturated
        write_raw(tmp_path / "a.png", np.ascontiguousarray(quiet), ICCProfile=icc_profile(P3_D50))
        recwarn.clear()
        st.read_image(tmp_path / "a.png")
        assert not recwarn.list


@pytest.mark.parametrize(
    ("curve", "decoded"),
    [
        (parametric_curve(0, 2.2), lambda x: x**2.2),
        (parametric_curve(1, 2.0, 1.25, -0.25), lambda x: np.maximum(1.25 * x - 0.25, 0) ** 2),
        (parametric_curve(2, 2.0, 1.0, -0.25, 0.125),
         lambda x: np.maximum(x - 0.25, 0) ** 2 + 0.125),
        (parametric_curve(3, 2.0, 1.0, 0.0, 0.25, 0.25),
         lambda x: np.where(x >= 0.25, x**2, x / 4)),
        (parametric_curve(4, 2.0, 0.5, 0.25, 0.25, 0.25, 0.125, 0.0625),
         lambda x: np.where(x >= 0.25, (x / 2 + 0.25) ** 2 + 0.125, x / 4 + 0.0625)),
        (table_curve(np.array([0, 0.5, 0.75, 1.0])),
         lambda x: np.interp(x, [0, 1 / 3, 2 / 3, 1], [0, 0.5, 0.75, 1.0])),
    ],
)  # fmt: skip
def test_every_kind_of_curve_is_the_specification_s(curve, decoded):
    curves, matrix = read_profile(icc_profile(SRGB_D50, curve))
    x = np.linspace(0, 1, 101)
    for found in curves:
        np.testing.assert_allclose(found(x), decoded(x), rtol=0, atol=3e-5)
    np.testing.assert_allclose(matrix, np.eye(3), rtol=0, atol=3e-4)


def test_a_grey_profile_is_a_curve(tmp_path):
    profile = icc_profile(space=b"GRAY", tags={b"kTRC": gamma_curve(2.2)})
    grey = np.array([[[10], [100], [200]]], np.uint8)
    write_raw(tmp_path / "a.png", grey, ICCProfile=profile)
    expected = np.repeat((grey / 255) ** (round(2.2 * 256) / 256), 3, axis=-1)
    np.testing.assert_allclose(st.read_image(tmp_path / "a.png"), expected, rtol=0, atol=1e-6)


def test_profiles_that_cannot_be_used_are_named(tmp_path):
    video = b"cicp\0\0\0\0" + bytes([9, 16, 0, 1])
    cases = {
        "'Coated' is one of tables for CMYK colours": icc_profile(
            name="Coated", space=b"CMYK", tags={b"A2B0": b"mft2" + bytes(60)}
        ),
        "'v4' is one of tables for RGB colours": icc_profile(name="v4", tags={b"A2B0": b"mAB "}),
        "has a curve that makes no sense": icc_profile(curve=b"curv" + bytes(3)),
        "has colours that make no sense": icc_profile(((1, 1, 1),) * 3, name="long" * 999),
        "is of high dynamic range": icc_profile(tags={b"cicp": video}),
        r"is one of tables for \x00\nB colours": icc_profile(space=b"\0\nB "),
    }
    for said, profile in cases.items():
        write_raw(tmp_path / "a.tif", COLORS, ICCProfile=profile)
        message = said_of(tmp_path / "a.tif")
        assert "its ICC profile" in message and said in message and "colorspace=" in message
        np.testing.assert_allclose(
            st.read_image(tmp_path / "a.tif", "srgb"), decode(COLORS / 255), rtol=0, atol=1e-6
        )


@pytest.mark.parametrize("case", range(200))
def test_broken_profiles_are_read_or_refused(case):
    rng = np.random.default_rng(case)
    broken = bytearray(icc_profile())
    for _ in range(rng.integers(1, 6)):
        broken[rng.integers(len(broken))] = rng.integers(256)
    try:
        read_profile(bytes(broken[: rng.integers(len(broken)) if case % 3 == 0 else None]))
    except ValueError as error:
        assert str(error)


def test_the_linear_profile_is_read_as_linear():
    curves, matrix = read_profile(linear_profile())
    assert curves[0](0.3) == 0.3
    np.testing.assert_allclose(matrix, np.eye(3), rtol=0, atol=1e-4)


# --- other formats --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "attribute"),
    [
        ("ap0", PRIMARIES["ap0"]),
        ("p3d65", PRIMARIES["p3d65"]),
        ("ciexyzd65", (1.0, 0, 0, 1, 0, 0, 1 / 3, 1 / 3)),
    ],
)
def test_an_exr_of_other_primaries_is_converted(name, attribute, tmp_path):
    color = np.random.default_rng(0).uniform(0, 2, (2, 3, 3)).astype(np.float32)
    write_raw(tmp_path / "a.exr", color, chromaticities=tuple(map(float, attribute)))
    expected = color @ np.transpose(PUBLISHED[name])
    np.testing.assert_allclose(st.read_image(tmp_path / "a.exr"), expected, rtol=0, atol=2e-3)
    np.testing.assert_array_equal(st.read_image(tmp_path / "a.exr", "linear"), color)


def test_an_exr_says_its_space_by_name(tmp_path):
    color = np.full((2, 3, 3), 0.5, np.float32)
    spaces = {
        "srgb_rec709_scene": decode(0.5), "lin_ap1_scene": 0.5, "g22_adobergb_scene": 0.5**2.2,
        "srgb_p3d65_display": decode(0.5), "unknown": 0.5, "data": 0.5,
    }  # fmt: skip
    for name, expected in spaces.items():
        write_raw(tmp_path / "a.exr", color, oiio__ColorSpace=name)
        np.testing.assert_allclose(st.read_image(tmp_path / "a.exr"), expected, rtol=0, atol=1e-5)


def test_spaces_that_are_not_known_are_named(tmp_path):
    write_raw(tmp_path / "a.dpx", COLORS, oiio__ColorSpace="KodakLog")
    assert "they are coded as KodakLog" in said_of(tmp_path / "a.dpx")


@pytest.mark.parametrize("ending", [".tif", ".pfm", ".exr", ".hdr", ".fits"])
def test_floating_numbers_are_linear(ending, tmp_path):
    write_raw(tmp_path / f"a{ending}", np.full((9, 9, 3), 0.25, np.float32))
    np.testing.assert_allclose(st.read_image(tmp_path / f"a{ending}"), 0.25, rtol=0, atol=1e-3)


@pytest.mark.parametrize("ending", [".tif", ".ppm", ".bmp", ".tga", ".png", ".sgi"])
def test_integers_are_srgb(ending, tmp_path):
    write_raw(tmp_path / f"a{ending}", COLORS)
    np.testing.assert_allclose(
        st.read_image(tmp_path / f"a{ending}"), decode(COLORS / 255), rtol=0, atol=1e-6
    )


RADIANCE = bytes([128, 64, 32, 129]) * 6  # 1, 0.5, 0.25


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("EXPOSURE=2.0", (0.5, 0.25, 0.125)),
        ("GAMMA=2.2", (1, 0.5**2.2, 0.25**2.2)),
        (
            "PRIMARIES=.68 .32 .265 .69 .15 .06 .3127 .3290",
            PUBLISHED["p3d65"] @ np.array([1, 0.5, 0.25]),
        ),
        ("VIEW=-vtv", (1, 0.5, 0.25)),
    ],
)
def test_the_header_of_a_radiance_file_counts(line, expected, tmp_path):
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n{line}\n\n-Y 2 +X 3\n"
    (tmp_path / "a.hdr").write_bytes(head.encode() + RADIANCE)
    np.testing.assert_allclose(st.read_image(tmp_path / "a.hdr")[0, 0], expected, rtol=0, atol=1e-3)


def test_a_radiance_file_of_xyz_is_refused(tmp_path):
    (tmp_path / "a.hdr").write_bytes(
        b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 2 +X 3\n" + RADIANCE
    )
    assert "cannot be read" in said_of(tmp_path / "a.hdr")


def test_colours_of_printers_are_refused(tmp_path):
    picture = Image.fromarray(COLORS.repeat(8, 0).repeat(8, 1))
    for name, mode in (("a.jpg", "CMYK"), ("a.tif", "CMYK"), ("b.tif", "LAB")):
        picture.convert(mode).save(tmp_path / name)
        message = said_of(tmp_path / name)
        assert "CMYK" in message or "Lab" in message or "CIELAB" in message, message


def test_a_camera_that_does_not_say_which_colours_is_named(tmp_path):
    write_raw(tmp_path / "a.jpg", np.full((16, 16, 3), 100, np.uint8), Exif__ColorSpace=0xFFFF)
    with pytest.warns(st.PictureWarning, match="its colours are not sRGB, but not which"):
        st.read_image(tmp_path / "a.jpg")
