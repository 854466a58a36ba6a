"""Lights from spots on mirroring and glossy balls whose lights are known."""

import numpy as np
import pytest
from helpers.mirror_ball import mirror_picture

import spheretrace_jax as st
from spheretrace_jax.calibration.ball_pixels import ball_pixels
from spheretrace_jax.calibration.camera import Intrinsics
from spheretrace_jax.calibration.conic import outline_of_ball
from spheretrace_jax.calibration.highlights import brightest_spot, chrome_spots
from spheretrace_jax.calibration.lambert import lambert_light

SIZE = (120, 130)
CAMERAS = [Intrinsics(np.inf, 64.0, 61.0), Intrinsics(150.0, 64.0, 61.0)]


def ball_before(camera):
    if camera.orthographic:
        return outline_of_ball((3.3, -2.2, 0.0), 50.0, camera)
    return outline_of_ball((0.4, -0.3, 3.0), 1.0, camera)


def unit(*vector):
    return np.array(vector) / np.linalg.norm(vector)


def glossy_picture(outline, light, exponent, highlight="phong"):
    """Draws a glossy ball: Lambert's cosine and Phong's or the halfway highlight."""
    pixels = ball_pixels(outline, SIZE)
    n, v = pixels.normals, pixels.views
    cosine = np.maximum(n @ light, 0)
    mirrored = 2 * (n * v).sum(1, keepdims=True) * n - v
    lobe = np.maximum(mirrored @ light, 0)
    if highlight == "blinn":
        half = light + v
        lobe = np.maximum((n * half).sum(1) / np.linalg.norm(half, axis=1), 0)
    picture = np.zeros(SIZE)
    picture[pixels.mask] = 0.3 * cosine + np.where(cosine > 0, 0.6 * lobe**exponent, 0)
    return picture


def degrees(a, b):
    return np.degrees(np.arccos(np.clip(a @ b, -1, 1)))


@pytest.mark.parametrize("camera", CAMERAS)
def test_several_lights_on_a_chrome_ball(camera):
    outline = ball_before(camera)
    lights = [unit(0.3, -0.5, -1), unit(-1, 0.2, -0.6), unit(0.8, 0.6, 0.1)]
    sizes, brightness = [0.15, 0.12, 0.2], [20.0, 8.0, 4.0]
    picture = mirror_picture(outline, SIZE, lights, sizes, brightness)
    picture += 0.002 * np.random.default_rng(0).normal(size=SIZE)
    for clip in (np.inf, 1.0):
        spots = chrome_spots(np.minimum(picture, clip), outline, 2 if clip == np.inf else 3)
        assert all(spot.saturated == (clip == 1) for spot in spots) or clip == np.inf
        for spot in spots:
            errors = [degrees(spot.direction, light) for light in lights]
            best = int(np.argmin(errors))
            assert errors[best] < 0.4 and errors[best] < 4 * np.degrees(spot.std)
            true = 2 * np.pi * (1 - np.cos(sizes[best]))
            assert spot.solid_angle == pytest.approx(true, rel=0.35)
        assert spots == sorted(spots, key=lambda spot: -spot.brightness)
    np.testing.assert_array_equal(
        [int(np.argmax([s.direction @ light for light in lights])) for s in spots], [2, 0, 1]
    )


def test_intervals_of_chrome_spots():
    outline, random, inside = ball_before(CAMERAS[1]), np.random.default_rng(1), []
    for _ in range(12):
        light = unit(*random.normal(size=2) * 0.5, -1)
        picture = np.minimum(mirror_picture(outline, SIZE, [light], [0.08], [30.0]), 1)
        spot = chrome_spots(picture, outline, 1)[0]
        away = spot.direction - light
        assert degrees(spot.direction, light) < 0.6
        variances, axes = np.linalg.eigh(spot.covariance)
        inside += list(np.abs(axes.T @ away)[1:] < 1.96 * np.sqrt(variances[1:]))
    assert np.mean(inside) >= 0.85


def test_the_error_of_the_ball_enters():
    light = unit(0.3, -0.5, -1)
    outline = ball_before(CAMERAS[0])
    picture = np.minimum(mirror_picture(outline, SIZE, [light], [0.1], [30.0]), 1)
    unsure = type(outline)(outline.center, outline.radius, 0.25 * np.eye(3), outline.intrinsics)
    exact, wide = (chrome_spots(picture, o, 1)[0] for o in (outline, unsure))
    # half a pixel of 50 turns the normal by 0.01 and more, the mirror direction by twice that
    assert exact.std < 0.005 and 0.02 < wide.std < 0.04


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize(("highlight", "clip"), [("phong", np.inf), ("phong", 0.6), ("blinn", 0.6)])
def test_the_highlight_of_a_glossy_ball(camera, highlight, clip):
    outline, light = ball_before(camera), unit(0.4, -0.5, -1)
    exponent = 60 if highlight == "phong" else 240
    picture = np.minimum(glossy_picture(outline, light, exponent, highlight), clip)
    spot = brightest_spot(picture, outline)
    assert spot.saturated == (clip < 1)
    assert degrees(spot.direction, light) < 0.8


def test_near_lights_and_the_direction_from_the_centre():
    outline = ball_before(CAMERAS[1])
    picture = glossy_picture(outline, unit(0.4, -0.5, -1), 60)
    spot = brightest_spot(picture, outline)
    assert (spot.from_center() == spot.direction).all()
    for distance in (1.5, 4.0, 1e6):
        light = distance * spot.from_center(distance)
        assert np.linalg.norm(light) == pytest.approx(distance)
        np.testing.assert_allclose(unit(*(light - spot.normal)), spot.direction, atol=1e-9)
        turn = np.radians(degrees(spot.from_center(distance), spot.direction))
        assert turn <= np.arcsin(1 / distance) + 1e-9
    with pytest.raises(st.InputError, match="distance: expected more than 1 radius"):
        spot.from_center(0.5)


def test_pictures_without_spots():
    outline = ball_before(CAMERAS[0])
    with pytest.raises(st.InputError, match="the ball shows no spot"):
        brightest_spot(np.zeros(SIZE), outline)
    picture = mirror_picture(outline, SIZE, [unit(0.3, -0.5, -1)], [0.1], [30.0])
    with pytest.raises(st.InputError, match="expected 3 bright spots on the ball, found 1"):
        chrome_spots(picture, outline, 3)
    outside = outline_of_ball((900.0, 0.0, 0.0), 20.0, CAMERAS[0])
    with pytest.raises(st.InputError, match="does not show the ball"):
        brightest_spot(picture, outside)


@pytest.mark.parametrize("ambient", [0.0, 0.1])
def test_lambert(ambient):
    outline, light = ball_before(CAMERAS[1]), unit(0.6, -0.5, -0.7)
    pixels = ball_pixels(outline, SIZE, margin=1.0)
    color = np.array([0.8, 0.5, 0.3])
    picture = np.zeros((*SIZE, 3))
    picture[pixels.mask] = np.maximum(pixels.normals @ light, 0)[:, None] * color + ambient
    exact = lambert_light(picture, pixels.normals, pixels.mask, ambient=ambient > 0)
    np.testing.assert_allclose(exact.direction, light, atol=1e-9)
    np.testing.assert_allclose(exact.color, color)
    np.testing.assert_allclose(exact.ambient, ambient, atol=1e-9)
    assert ((pixels.normals[exact.lit] @ light) > 0).all() and exact.residual < 1e-9
    random, errors, stds = np.random.default_rng(0), [], []
    for _ in range(12):
        noisy = picture + 0.05 * random.normal(size=picture.shape)
        found = lambert_light(noisy, pixels.normals, pixels.mask, ambient=ambient > 0)
        errors.append(np.radians(degrees(found.direction, light)))
        stds.append(np.sqrt(np.trace(found.covariance)))
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) / np.mean(stds) < 1.6
    clipped = lambert_light(np.minimum(picture, 0.5), pixels.normals, pixels.mask, level=0.5,
                            ambient=ambient > 0)  # fmt: skip
    np.testing.assert_allclose(clipped.direction, light, atol=1e-9)
    with pytest.raises(st.InputError, match="do not tell a direction"):
        lambert_light(0 * picture, pixels.normals, pixels.mask)
    with pytest.raises(st.InputError, match="normals: expected one for each"):
        lambert_light(picture, pixels.normals[1:], pixels.mask)
