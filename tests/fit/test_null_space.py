"""Reasons for the null space: exchanges of products, motions with the eye, several pictures."""

import numpy as np
import pytest
from helpers.identifiability import (
    BEHIND,
    FAR_AWAY,
    HIDDEN,
    LIGHTS,
    SIZE,
    channels,
    check,
    fit_at,
    scales,
    scene,
)

import spheretrace_jax as st

PRODUCTS = ("color", "ka", "kd", "ks", "light_color", "exposure")
BACKGROUND = (0.1, 0.2, 0.3)  # where it is seen, it tells the exposure
WALL = dict(center=[[-40, 0, 0], [45, 10, 0], [0, 0, -1100]], radius=[35, 30, 1000])
AGAINST_WEIGHTS = "the lights' color against the spheres' ka, kd and ks is not determined"
SHARE = "lights 1 and 2 are at one place: how they share their color is not determined"


PRODUCTS_CASES = {
    "a background": ({}, 4, scales(1, 2, 3) | {AGAINST_WEIGHTS}),
    "a wall": (
        WALL,
        7,
        scales(1, 2, 3) | channels("the exposure", "the lights' color") | {AGAINST_WEIGHTS},
    ),
    "a background without red": (
        dict(background=(0, 0.2, 0.3)),
        5,
        scales(1, 2, 3) | channels("the exposure", "the lights' color", "red") | {AGAINST_WEIGHTS},
    ),
    # the scales of light in all channels and of ka and kd say the same
    "matte": (
        dict(ks=0.0),
        6,
        scales(1, 2, 3) | channels("the lights' color", "the spheres' color"),
    ),
    "matte before a wall": (
        WALL | dict(ks=0.0),
        9,
        scales(1, 2, 3)
        | channels("the exposure", "the lights' color")
        | channels("the exposure", "the spheres' color"),
    ),
    "matte before a background without red": (
        dict(ks=0.0, background=(0, 0.2, 0.3)),
        7,
        scales(1, 2, 3)
        | channels("the exposure", "the lights' color", "red")
        | channels("the exposure", "the spheres' color", "red")
        | channels("the lights' color", "the spheres' color", "green blue"),
    ),
    "two lights at one place": (
        dict(lights=[LIGHTS[0]] * 2),
        7,
        scales(1, 2, 3) | {AGAINST_WEIGHTS, SHARE},
    ),
    # its colour shows in the ambient light
    "a light from behind": (
        dict(lights=[LIGHTS[0], BEHIND[1]]),
        5,
        scales(1, 2, 3)
        | {
            AGAINST_WEIGHTS,
            "light 2 reaches nothing that is seen: its color against the spheres' ka is not "
            "determined",
        },
    ),
    "lit from behind": (
        dict(lights=BEHIND),
        15,
        {
            f"no light reaches what is seen of sphere {i}: kd and ks not determined"
            for i in (1, 2, 3)
        }
        | scales(1, 2, 3, of="ka")
        | channels("the lights' color", "the spheres' color")
        | {
            "lights 1 and 2 reach nothing that is seen: how they share their color is not "
            "determined"
        },
    ),
    "matte and nowhere green": (
        dict(ks=0.0, color=[[0.5, 0, 0], [0.2, 0, 0.4], [0.1, 0, 0]]),
        7,
        {f"light {i} does not show: color in green not determined" for i in (1, 2)}
        | scales(1, 2, 3)
        | channels("the lights' color", "the spheres' color", "red blue"),
    ),
    "nothing but a background without blue": (
        dict(center=[[1e4, 0, 0], [2e4, 0, 0], [3e4, 0, 0]], background=(0.1, 0.2, 0)),
        25,
        {f"sphere {i} is not visible: color, ka, kd and ks not determined" for i in (1, 2, 3)}
        | {f"light {i} reaches nothing that is seen: color not determined" for i in (1, 2)}
        | {"the blue exposure is not determined"},
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", PRODUCTS_CASES)
def test_products(case):
    changes, nullity, words = PRODUCTS_CASES[case]
    truth = scene(**(dict(background=BACKGROUND) | changes))
    check(fit_at(truth, PRODUCTS), nullity, words)


GEOMETRY = ("center", "radius", "light_position", "theta", "phi", "mu")
SCALE = "the scale of the world is not determined"
WORLD = {f"the camera's {name} against the world is not determined" for name in GEOMETRY[3:]}
SMALL = {
    name: np.asarray(getattr(scene().spheres, name))[:2]
    for name in ("center", "radius", "color", "ka", "kd", "ks", "exponent")
} | dict(lights=LIGHTS[:1], light_color=[[0.5, 0.6, 0.3]])
AWAY = [0.0, 0, 2000], [0.0, 0, 1]  # behind the eye and the lights
FLOOR = [0.0, 0, -80], [0.0, 0, 1]
SLOPE = [0.0, 0, -80], [0.1, 0.2, 1]
STEP = [0.0, -60, 0], [0.0, 1, 0]

WORLD_CASES = {
    "no plane in sight": ((AWAY, AWAY), {}, 4, WORLD | {SCALE}),
    # as seen from where the camera's axis meets it
    "a plane across the pole": (
        (FLOOR, AWAY),
        {},
        2,
        {SCALE, "the camera's theta against the world is not determined"},
    ),
    "an oblique plane": ((SLOPE, AWAY), {}, 1, {SCALE}),
    "two planes": ((FLOOR, STEP), {}, 0, set()),
    # theta's derivative is not 0 but a rounding error
    "all on the axis of the poles": (
        (AWAY, AWAY),
        dict(center=[[0, 0, 0], FAR_AWAY], lights=[[0.0, 0, 900]]),
        8,
        {
            "sphere 2 is not visible: center and radius not determined",
            "the camera's theta is not determined",
            "the camera's phi against the world is not determined",
            "the camera's mu against the world is not determined",
            SCALE,
        },
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", WORLD_CASES)
def test_motion_with_eye(case):
    planes, changes, nullity, words = WORLD_CASES[case]
    planes = [list(x) for x in zip(*planes, strict=True)]
    check(fit_at(scene(planes=planes, **(SMALL | changes)), GEOMETRY), nullity, words)


@pytest.mark.slow
def test_motion_with_eye_antialiased():
    truth = scene(**SMALL | dict(center=[[-40, 0, 0], [0, 20, 70]], ks=0.0)).with_antialias(1)
    check(fit_at(truth, GEOMETRY), 4, WORLD | {SCALE})


SEVERAL = ("kd", "ks", "light_color", "exposure")


def two_pictures(second_camera=(-np.pi / 2, 0.1), **changes) -> list[st.Scene]:
    """Makes a scene of two lights, and one of another light; colours and ka are known."""
    other = dict(lights=[[-100.0, 300, 300]], light_color=[[0.7, 0.8, 0.9]])
    first = dict(background=BACKGROUND) | changes
    return [scene(**first), scene(camera=second_camera, **(first | other))]


PICTURES_CASES = {
    "plain": (two_pictures(), (), 0, set()),
    "one background clipped": (
        two_pictures(),
        (1,),
        3,
        channels("the exposure", "the lights' color", of=" of picture 2"),
    ),
    "both backgrounds clipped": (
        two_pictures(),
        (0, 1),
        6,
        channels("the exposure", "the lights' color", of=" of picture 1")
        | channels("the exposure", "the lights' color", of=" of picture 2"),
    ),
    "two lights at one place": (
        two_pictures(lights=[LIGHTS[0]] * 2),
        (),
        3,
        {SHARE.replace(" are", " of picture 1 are")},
    ),
    "a light from behind": (two_pictures(lights=[LIGHTS[0], BEHIND[1]]), (), 0, set()),
    "no ambient light": (
        two_pictures(ka=0.0),
        (),
        1,
        {"the lights' color against the spheres' kd and ks is not determined"},
    ),
    "a light from behind, no ambient light": (
        two_pictures(lights=[LIGHTS[0], BEHIND[1]], ka=0.0),
        (),
        4,
        {
            "the lights' color against the spheres' kd and ks is not determined",
            "light 2 of picture 1 reaches nothing that is seen: color not determined",
        },
    ),
    "a sphere in one of them only": (
        two_pictures((-np.pi / 2, 0.4), **HIDDEN),
        (),
        0,
        set(),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", PICTURES_CASES)
def test_several_pictures(case):
    truth, clipped, nullity, words = PICTURES_CASES[case]
    target = [np.array(st.render(s, bounces=0, **SIZE)) for s in truth]
    assert all(picture.max() < 1 for picture in target)
    for k in clipped:
        target[k][(target[k] == BACKGROUND).all(axis=-1)] = 1
    fit = fit_at(truth, SEVERAL, target, own=("light_color",))
    check(fit, nullity, words)
    spread = fit.uncertainty.standard_deviations
    assert spread["light_color"].shape == (2, 2, 3) and spread["exposure"].shape == (2, 3)
    assert (np.isnan(spread["light_color"]) == [[[False]] * 2, [[False], [True]]]).all()
