"""Pictures on the command line: layers, masks, alpha, and smaller ones."""

from pathlib import Path

import numpy as np
import pytest
from helpers.commands import spheretrace, workplace
from helpers.picture_files import write_parts, write_raw

import spheretrace_jax as st
from spheretrace_jax.files.images import to_srgb

FIT = ("fit", "scene.txt", "target.png", "-o", "fitted.txt", "--free", "kd")
WHITE = np.full((24, 32, 3), 255, np.uint8)


@pytest.fixture(scope="module", autouse=True)
def folder():
    """Enters a folder with a scene, its picture with alpha, and masks; half of each is left out."""
    with workplace() as path:
        picture = np.asarray(st.render(st.load_scene("scene.txt"), width=32, height=24))
        coded = np.clip(to_srgb(picture) * 255, 0, 255).round().astype(np.uint8)
        left = np.arange(32) < 16
        alpha = np.broadcast_to(np.where(left, 0, 255).astype(np.uint8)[:, None], (24, 32, 1))
        spoiled = np.where(left[:, None], np.uint8(130), coded)
        write_raw(
            path / "target.png", np.concatenate([spoiled, alpha], -1), alpha=3,
            oiio__UnassociatedAlpha=1,
        )  # fmt: skip
        mask = np.where(left[:, None], np.uint8(0), WHITE)
        write_raw(path / "mask.jpg", mask, compression="jpeg:60")
        write_raw(path / "grey.png", WHITE // 2)
        write_raw(path / "black.png", WHITE * 0)
        write_raw(path / "rgb.png", coded)
        write_parts(
            path / "views.exr",
            (np.zeros_like(picture, np.float32), {"oiio:subimagename": "left"}),
            (picture.astype(np.float32), {"oiio:subimagename": "right"}),
        )
        yield path


@pytest.mark.parametrize(
    ("mask", "said"), [("alpha", "target.png (alpha)"), ("mask.jpg", "mask.jpg")]
)
def test_a_mask_says_how_many_pixels_count(mask, said):
    status, out, err = spheretrace(*FIT, "--mask", mask)
    assert (status, out.splitlines()[0]) == (0, f"{said}: 384 of 768 pixels count")
    assert "1152 numbers left out" in out
    # alpha that is the mask is not named beside
    assert err.count("\n") == (0 if mask == "alpha" else 1)
    found, truth = (st.load_scene(name) for name in ("fitted.txt", "scene.txt"))
    np.testing.assert_allclose(found.spheres.kd, truth.spheres.kd, rtol=0, atol=0.01)


def test_alpha_that_is_not_the_mask_is_named():
    status, _, err = spheretrace(*FIT)
    assert status == 1 and err == (
        "spheretrace: warning: target.png: 384 of 768 pixels are transparent, and read as over "
        "black; a fit can leave them out (read_mask, fit --mask alpha)\n"
    )


@pytest.mark.parametrize(
    ("target", "mask", "said"),
    [
        ("rgb.png", "alpha", "rgb.png: has no alpha channel that could be the mask"),
        ("rgb.png", "grey.png", "grey.png: expected a mask, white where the picture counts and "
         "black elsewhere, got only greys from 0.5 to 0.5"),
        ("rgb.png", "black.png", "black.png: no pixel of the mask counts: expected some as bright "
         "as half"),
        ("rgb.png", "no.png", "no.png: there is no such picture"),
    ],
)  # fmt: skip
def test_what_is_no_mask_is_named(target, mask, said):
    Path("fitted.txt").unlink(missing_ok=True)
    words = ("fit", "scene.txt", target, "-o", "fitted.txt", "--free", "kd", "--mask", mask)
    assert spheretrace(*words) == (2, "", f"spheretrace: {said}\n")
    assert not Path("fitted.txt").exists()


def test_a_layer_of_the_target_is_named():
    words = ("fit", "scene.txt", "views.exr", "-o", "fitted.txt", "--free", "kd")
    status, _, err = spheretrace(*words)
    said = (
        "views.exr: of the layers 'left', 'right' read 'left': layer= (fit --layer) names another"
    )
    assert (status, err) == (1, f"spheretrace: warning: {said}\n")
    status, _, err = spheretrace(*words, "--layer", "right")
    assert (status, err) == (0, "")
    status, _, err = spheretrace(*words, "--layer", "middle")
    said = "views.exr: there is no layer 'middle', only 'left', 'right'"
    assert (status, err) == (2, f"spheretrace: {said}\n")


def test_the_tolerance_decides_the_exit_status():
    picture = np.asarray(st.render(st.load_scene("scene.txt"), width=32, height=24))
    st.write_image("wrong.exr", picture * np.linspace(0.9, 1.1, 32)[None, :, None])
    words = ("fit", "scene.txt", "wrong.exr", "-o", "fitted.txt", "--free", "kd", "--tolerance")
    status, out, _ = spheretrace(*words, "0.5")
    assert status == 0 and "converged, good: explains 99." in out
    status, out, _ = spheretrace(*words, "0.002")
    assert status == 1 and "does NOT explain picture" in out
    status, _, err = spheretrace(*words, "0")
    assert status == 2 and "tolerance must be above 0 and at most 1, got 0" in err


def test_noise_is_a_number_or_photo():
    words = ("fit", "scene.txt", "rgb.png", "-o", "fitted.txt", "--free", "kd", "--noise")
    status, out, err = spheretrace(*words, "film")
    said = "spheretrace: --noise must be a number or photo, got film\n"
    assert (status, out, err) == (2, "", said)
    status, out, err = spheretrace(*words, "photo")
    assert err == "" and "noise of variance " in out


SMALLER = ("fit", "scene.txt", "rgb.png", "-o", "fitted.txt", "--free", "kd", "--samples", "2")


@pytest.mark.slow
def test_a_smaller_picture_is_fitted():
    status, out, err = spheretrace(*SMALLER, "--shrink", "2", "--report", "report")
    assert (status, err) == (0, ""), out
    found, truth = (st.load_scene(name) for name in ("fitted.txt", "scene.txt"))
    np.testing.assert_allclose(found.spheres.kd, truth.spheres.kd, rtol=0, atol=0.01)
    assert Path("report/comparison.png").is_file()


def test_a_picture_that_cannot_be_so_much_smaller_is_named():
    for shrink, said in (
        ("5", "shrink must divide width and height of 32 x 24 pixels, such as 2, 4, 8; got 5"),
        ("0", "--shrink must be at least 1, got 0"),
    ):
        assert spheretrace(*SMALLER, "--shrink", shrink) == (2, "", f"spheretrace: {said}\n")
