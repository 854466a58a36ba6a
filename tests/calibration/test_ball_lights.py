"""Lights of photographs of balls: those of another renderer, and drawn ones with a known truth."""

import re
from pathlib import Path

import numpy as np
import pytest
from helpers.mirror_ball import mirror_picture

import spheretrace_jax as st
from spheretrace_jax.calibration.ball_pixels import ball_pixels
from spheretrace_jax.calibration.camera import Intrinsics, flip_frame
from spheretrace_jax.calibration.conic import outline_of_ball
from spheretrace_jax.calibration.lambert import lambert_light
from spheretrace_jax.calibration.light_files import read_lights

FOLDER = Path(__file__).parents[2] / "data" / "ball"
FOCAL = 420.0
SIZE = (90, 100)
OUTLINE = outline_of_ball((0.2, -0.1, 5.0), 1.0, Intrinsics(180.0, 50.0, 45.0))


def degrees(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def photographs():
    """Reads the shipped photographs, and what they show."""
    truth = read_lights(FOLDER / "lights.csv")
    files = [next(FOLDER.glob(f"{light['name']}.*g")) for light in truth]
    pictures = [st.read_image(f, "linear" if f.suffix == ".png" else "srgb") for f in files]
    return [np.asarray(p) for p in pictures], truth


def drawn(
    toward, distance=np.inf, exponent=40, ambient=0.05, noise=2e-3, falloff=True, shine=0.3, seed=0
):
    """Draws a ball by Lambert's law and a halfway highlight. `toward`: in the camera's frame."""
    toward = np.asarray(toward) / np.linalg.norm(toward)
    pixels = ball_pixels(OUTLINE, SIZE)
    N, V = pixels.normals, pixels.views
    to_light = toward - N / distance
    r = np.linalg.norm(to_light, axis=1)
    L = to_light / r[:, None]
    H = (L + V) / np.linalg.norm(L + V, axis=1)[:, None]
    cosine = (N * L).sum(1)
    lit = np.where(cosine > 0, r**-2 if falloff else 1, 0)
    diffuse = lit * cosine
    highlight = shine * lit * np.maximum((N * H).sum(1), 0) ** exponent
    picture = np.zeros((*SIZE, 3))
    color = np.array([0.6, 0.4, 0.3])
    picture[pixels.mask] = ambient + diffuse[:, None] * color + highlight[:, None]
    noise = np.random.default_rng(seed).normal(scale=noise, size=picture.shape)
    return picture + noise, flip_frame(toward)


def test_photographs_of_another_renderer():
    pictures, truth = photographs()
    names = [light["name"] for light in truth]
    found = st.lights(pictures, focal=FOCAL, names=names)
    for light, true in zip(found, truth, strict=True):
        error = degrees(light.direction, true["direction"])
        assert error < min(0.6, light.error), light
        assert light.least_distance < true["distance"] < light.most_distance, light
        assert light.grade == "good" and light.unexplained < 0.05
        if true["distance"] < 20:
            assert light.distance == pytest.approx(true["distance"], rel=0.1)
    assert found[3].at_infinity and found[3].least_distance > 20
    assert "at infinity, at least" in str(found[3])
    # all show one lamp and one ball
    colors = np.stack([light.color / light.color.sum() for light in found])
    np.testing.assert_allclose(colors, np.broadcast_to(colors[0], colors.shape), atol=0.01)
    assert found.directions.shape == (4, 3)
    shown = found.picture(0)
    inside = np.isfinite(shown)
    assert np.abs(shown - pictures[0])[inside].mean() < 0.01
    shared = st.lights(pictures, focal=FOCAL, names=names, shared=True)
    for light, true in zip(shared, truth, strict=True):
        assert degrees(light.direction, true["direction"]) < 0.6


@pytest.mark.parametrize("distance", [4.0, np.inf])
def test_light_with_fall_off(distance):
    picture, truth = drawn((0.5, -0.3, -0.8), distance)
    light = st.lights(picture, OUTLINE)[0]
    assert degrees(light.direction, truth) < min(0.3, light.error)
    assert light.least_distance < distance <= light.most_distance
    if distance < 10:
        assert light.distance == pytest.approx(distance, rel=0.05)
    else:
        assert light.at_infinity and light.least_distance > 15
    np.testing.assert_allclose(light.color, [0.6, 0.4, 0.3], rtol=0.03)
    np.testing.assert_allclose(light.ambient, 0.05, atol=0.01)
    assert (light.color_error < 0.1 * light.color).all()


def test_light_without_fall_off_is_the_lectures():
    picture, truth = drawn((0.5, -0.3, -0.8), 3.0, falloff=False)
    light = st.lights(picture, OUTLINE)[0]
    assert degrees(light.direction, truth) < 0.3
    assert light.distance == pytest.approx(3.0, rel=0.05)
    assert light.found is not None and not light.found.fit.model.falloff


def test_matt_ball_is_as_good_as_least_squares():
    picture, truth = drawn((-0.6, 0.2, -0.7), noise=0.01, shine=0.0)
    light = st.lights(picture, OUTLINE)[0]
    pixels = ball_pixels(OUTLINE, SIZE, margin=1.5)
    plain = lambert_light(picture, pixels.normals, pixels.mask, ambient=True)
    off = degrees(light.direction, truth)
    assert off < light.error and off < degrees(flip_frame(plain.direction), truth) + 0.3


def test_errors_hold():
    inside, stated = [], []
    for seed in range(12):
        toward = np.random.default_rng(seed).normal(size=3)
        toward[2] = -abs(toward[2]) - 0.5
        picture, truth = drawn(toward, noise=0.01, seed=seed)
        light = st.lights(picture, OUTLINE)[0]
        inside.append(degrees(light.direction, truth) < light.error)
        stated.append(light.error)
    assert np.mean(inside) > 0.8 and np.median(stated) < 2


def test_saturated_and_masked_numbers_do_not_count():
    picture, truth = drawn((0.4, -0.5, -0.9), exponent=60)
    clipped = np.minimum(picture, 0.5)
    light = st.lights(clipped, OUTLINE, brightest=0.5)[0]
    assert degrees(light.direction, truth) < min(1.0, light.error)
    wrong = picture.copy()
    wrong[:40, :50] = 0.9
    mask = np.ones(SIZE, bool)
    mask[:40, :50] = False
    light = st.lights(wrong, OUTLINE, mask=mask, darkest=-1)[0]
    assert degrees(light.direction, truth) < min(0.5, light.error)
    assert any("do not count" in remark for remark in light.remarks)


def test_units_and_kinds_of_pictures():
    picture, _ = drawn((0.5, -0.3, -0.8), 4.0)
    mask = np.zeros(SIZE, bool)
    mask[ball_pixels(OUTLINE, SIZE).mask] = True
    by = {
        "outline": st.lights(picture, OUTLINE)[0],
        "radius": st.lights(picture, OUTLINE, radius=2.5, albedo=(2.0, 1.0, 1.0))[0],
        "bright": st.lights(picture * 1e6, OUTLINE)[0],
        "mask": st.lights(picture, mask, focal=180.0)[0],
    }
    with pytest.warns(st.PictureWarning, match="0..65535 are taken as linear"):
        whole = np.round(np.clip(picture, 0, 1) * 65535).astype(np.uint16)
        by["whole"] = st.lights(whole, OUTLINE)[0]
    for name, light in by.items():
        assert degrees(light.direction, by["outline"].direction) < 0.3, name
    assert by["radius"].distance == pytest.approx(2.5 * by["outline"].distance, rel=1e-3)
    np.testing.assert_allclose(by["radius"].color[0], by["outline"].color[0] / 2, rtol=1e-3)
    np.testing.assert_allclose(by["bright"].color, by["outline"].color * 1e6, rtol=1e-3)


def test_scene_shows_the_photograph():
    picture, _ = drawn((0.5, -0.3, -0.8), 4.0, ambient=0.0)
    found = st.lights(picture, OUTLINE)
    scene = found.scene(0)
    shown = np.asarray(st.render(scene, width=SIZE[1], height=SIZE[0], highlight="blinn"))
    inside = ball_pixels(OUTLINE, SIZE, margin=1.5).mask
    assert np.abs(shown - picture)[inside].mean() < 0.02
    assert np.abs(shown - picture)[inside].max() < 0.1


def test_chrome_ball():
    toward = np.array([0.5, -0.3, -0.8]) / np.linalg.norm([0.5, -0.3, -0.8])
    picture = mirror_picture(OUTLINE, SIZE, [toward], [0.12], [1.0])
    picture = np.repeat(picture[..., None], 3, axis=2)
    light = st.lights(picture, OUTLINE, chrome=True)[0]
    assert degrees(light.direction, flip_frame(toward)) < max(0.5, light.error)
    assert light.at_infinity and "mirror" in str(light)
    with pytest.raises(st.InputError, match="expected 2 bright spots on the ball, found 1"):
        st.lights(picture, OUTLINE, chrome=True, count=2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"ball": "round"}, "ball: expected auto, a mask or .x, y, radius., got 'round'"),
        ({"ball": np.ones((5, 5))}, "expected a mask of 100 x 90 pixels, got 5 x 5"),
        ({"mask": np.ones((7, 8), bool)}, "expected a mask of 100 x 90 pixels, got shape .7, 8."),
        ({"ball": [OUTLINE, OUTLINE]}, "ball: expected 1, one for each picture, got 2"),
        ({"names": ["a", "b"]}, "names: expected 1, one for each picture, got 2"),
        ({"albedo": (1, 0, 1)}, "albedo: expected three numbers above 0"),
        ({"radius": 0}, "radius: expected a length above 0, got 0"),
        ({"brightest": -1.0}, "expected 50 pixels of the ball that are not saturated or masked"),
        ({"focal": -3}, "focal: expected a positive length in pixels, got -3"),
        ({"ball": (50, 45, -3)}, "radius: expected a positive number of pixels, got -3"),
    ],
)
def test_what_is_wrong_is_said(arguments, message):
    picture, _ = drawn((0.5, -0.3, -0.8))
    with pytest.raises(st.InputError, match=message):
        st.lights(picture, **({"ball": (50.0, 45.0, 37.0)} | arguments))


def test_balls_without_light():
    even = np.random.default_rng(0).normal(scale=1e-3, size=(*SIZE, 3))
    even[ball_pixels(OUTLINE, SIZE).mask] += 0.05
    light = st.lights(even, OUTLINE)[0]
    assert light.grade == "not to be used" and light.error > 15
    with pytest.raises(st.InputError, match="photo 1: the ball is black, no light shows"):
        st.lights(np.zeros((*SIZE, 3)), OUTLINE)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "wrong", "word"), [("side.png", "srgb", "linear"), ("far.jpg", "linear", "sRGB")]
)
def test_numbers_of_another_colour_space_are_named(name, wrong, word):
    right = "linear" if wrong == "srgb" else "srgb"
    picture = lambda space: np.asarray(st.read_image(FOLDER / name, space), float)
    bent = st.lights(picture(wrong), focal=FOCAL)[0]
    assert any(f"taken as {word}" in remark for remark in bent.remarks), bent
    straight = st.lights(picture(right), focal=FOCAL)[0]
    assert not straight.remarks and straight.unexplained < bent.unexplained / 2


@pytest.mark.slow
def test_the_documented_blocks_run(monkeypatch):
    page = (FOLDER.parents[1] / "docs" / "photographs.md").read_text(encoding="utf-8")
    monkeypatch.chdir(FOLDER.parents[1])
    for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL):
        exec(compile(block, "photographs.md", "exec"), {})
