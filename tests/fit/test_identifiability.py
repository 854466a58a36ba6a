"""Identifiability of scenes that are made so that what their pictures determine is known."""

import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import spheretrace_jax as st

SIZE = dict(width=32, height=24)
LIGHTS = [[100.0, 200, 400], [-200, 50, 300]]
BEHIND = [[100.0, 200, -4000], [0, 0, -3000]]
SIDE = [[-400.0, 0, 40], [-500, 0, 60]]  # from here sphere 2 is in the shadow of sphere 1
FAR_AWAY = [1e4, 0, 0]
RED, GREEN = [0.8, 0.3, 0.2], [0.2, 0.7, 0.4]


def scene(dtype=np.float64, camera=(-np.pi / 2, 0.1), planes=None, background=0.0, **changes):
    """Makes sphere 1 on the left, 2 on the right, 3 small above, and two lights above all.

    **Arguments:** `changes`: of the spheres, `lights` and `light_color`.
    """
    parts = (
        dict(
            center=[[-40.0, 0, 0], [45, 10, 0], [0, 45, 60]],
            radius=[35.0, 30, 15],
            color=[RED, GREEN, [0.5, 0.5, 0.9]],
            ka=[0.2, 0.15, 0.3],
            kd=[0.6, 0.7, 0.5],
            ks=[0.4, 0.2, 0.5],
            exponent=[5.0, 10, 3],
            lights=LIGHTS,
            light_color=[[0.5, 0.6, 0.3], [0.4, 0.2, 0.5]],
        )
        | changes
    )
    lights = st.Lights(parts.pop("lights"), parts.pop("light_color"))
    planes = None if planes is None else st.Planes(*planes)
    background = np.broadcast_to(background, 3)
    eye = st.Camera(*camera, 500.0, 800.0, 200.0)
    return st.Scene(st.Spheres(**parts), lights, eye, planes, (), background).astype(dtype)


def found(truth, free, target=None, **options) -> st.Fit:
    """Returns the fit that starts, and stays, at the scene of its picture."""
    target = st.render(truth, bounces=0, **SIZE) if target is None else target
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*set antialias to 1")
        return st.fit(truth, target, free=free, bounces=0, max_steps=0, **options)


def check(fit: st.Fit, nullity: int, words: set[str]) -> None:
    known = fit.identifiability
    assert set(known.undetermined) == words
    assert known.free - known.rank == nullity
    assert known.free == ravel_pytree(fit.values)[0].size


def without(row: int, value, name: str):
    """Returns the default numbers of a name, with another for one sphere."""
    numbers = np.array(getattr(scene().spheres, name))
    numbers[row] = value
    return {name: numbers}


HIDDEN = without(1, [-56, 20, -199], "center") | without(1, 20, "radius")  # by sphere 1


def scales(*spheres: int, of: str = "ka and kd") -> set[str]:
    return {f"sphere {i}: the scale of color against {of} is not determined" for i in spheres}


LOOKS = ("color", "ka", "kd", "ks", "exponent", "light_position")
ALL_OF_IT = "color, exponent, ka, kd and ks not determined"

LOOKS_CASES = {
    "scales": ({}, 3, scales(1, 2, 3)),
    "outside the view": (
        without(1, FAR_AWAY, "center"),
        9,
        {f"sphere 2 is not visible: {ALL_OF_IT}"} | scales(1, 3),
    ),
    "behind another sphere": (
        HIDDEN,
        9,
        {f"sphere 2 is not visible: {ALL_OF_IT}"} | scales(1, 3),
    ),
    "in shadow": (
        dict(lights=SIDE) | without(1, 20, "radius") | without(1, [45, 0, 0], "center"),
        6,
        {"no light reaches what is seen of sphere 2: exponent, kd and ks not determined"}
        | scales(1, 3)
        | scales(2, of="ka"),
    ),
    "lit from behind": (
        dict(lights=BEHIND),
        18,
        {f"light {i} reaches nothing that is seen: position not determined" for i in (1, 2)}
        | {
            f"no light reaches what is seen of sphere {i}: exponent, kd and ks not determined"
            for i in (1, 2, 3)
        }
        | scales(1, 2, 3, of="ka"),
    ),
    "no ks": (
        without(0, 0, "ks"),
        4,
        {"sphere 1 has ks 0: exponent not determined"} | scales(1, 2, 3),
    ),
    "black": (
        without(0, 0, "color"),
        4,
        {"sphere 1 is black: ka and kd not determined"} | scales(2, 3),
    ),
    "no ka nor kd": (
        without(0, 0, "ka") | without(0, 0, "kd"),
        5,
        {"sphere 1 has ka and kd 0: color not determined"} | scales(2, 3),
    ),
    "black without ka, kd and ks": (
        without(0, 0, "color") | without(0, 0, "ka") | without(0, 0, "kd") | without(0, 0, "ks"),
        8,
        {
            "sphere 1 is black: ka and kd not determined",
            "sphere 1 has ka and kd 0: color not determined",
            "sphere 1 has ks 0: exponent not determined",
        }
        | scales(2, 3),
    ),
    "a highlight smaller than a pixel": (
        without(0, 1e6, "exponent"),
        5,
        {"no highlight is seen on sphere 1: exponent and ks not determined"} | scales(1, 2, 3),
    ),
    "a light from behind": (
        dict(lights=[LIGHTS[0], BEHIND[1]]),
        6,
        {"light 2 reaches nothing that is seen: position not determined"} | scales(1, 2, 3),
    ),
    # the picture tells one light's shift from the other's by its colour
    "two lights at one place": (dict(lights=[LIGHTS[0]] * 2), 3, scales(1, 2, 3)),
    "two lights of one colour at one place": (
        dict(lights=[LIGHTS[0]] * 2, light_color=[[0.4, 0.6, 0.2], [0.2, 0.3, 0.1]]),
        6,
        {"lights 1 and 2 are at one place: how they part is not determined"} | scales(1, 2, 3),
    ),
    "nothing": (
        dict(center=[[1e4, 0, 0], [2e4, 0, 0], [3e4, 0, 0]]),
        27,
        {f"sphere {i} is not visible: {ALL_OF_IT}" for i in (1, 2, 3)}
        | {f"light {i} reaches nothing that is seen: position not determined" for i in (1, 2)},
    ),
}


@pytest.mark.parametrize("case", LOOKS_CASES)
def test_looks(case):
    changes, nullity, words = LOOKS_CASES[case]
    check(found(scene(**changes), LOOKS), nullity, words)


def test_masked_spheres():
    left = np.arange(SIZE["width"]) < 16
    mask = np.broadcast_to(left, (SIZE["height"], SIZE["width"]))
    words = {f"sphere 2 is not visible where the target counts: {ALL_OF_IT}"}
    check(found(scene(), LOOKS, mask=mask), 9, words | scales(1, 3))
    # the three numbers of one more pixel tell three of its seven
    mask = mask.copy()
    mask[10, 24] = True
    known = found(scene(), LOOKS, mask=mask).identifiability
    assert known.free - known.rank == 6
    others = set(known.undetermined) - scales(1, 2, 3)
    assert len(known.undetermined) - len(others) == 3 and others
    for sentence in others:
        parts = sentence.removeprefix("a combination of ").split(", ")
        assert all(part.startswith("sphere 2's ") for part in parts)


SHADES = ("color", "kd", "ks", "exponent", "light_position")  # ka says how bright a colour is

SHADES_CASES = {
    "plain": ({}, 0, set()),
    "a light far away": (dict(lights=[LIGHTS[0], [-2e5, -1e5, 1e6]]), 0, set()),
    "lights far away": (dict(lights=[[4e5, 3e5, 9e5], [-2e5, -1e5, 1e6]]), 0, set()),
    "lights a degree apart": (dict(lights=[LIGHTS[0], [105, 194, 400]]), 0, set()),
    "in part in shadow": (without(2, [-30, 10, 60], "center"), 0, set()),
    "colours at their bounds": (
        dict(color=[[1, 0, 0], [0, 1, 0], [0, 0, 1]], ka=1.0, kd=1.0, ks=1.0),
        0,
        set(),
    ),
    "hardly any highlight": (without(0, 1e-3, "ks"), 0, set()),
    "hardly any light": (dict(light_color=[[1e-3, 0, 0], [1e-3, 2e-3, 1e-3]]), 0, set()),
    "no kd": (without(0, 0, "kd"), 0, set()),
    "no ka": (without(0, 0, "ka"), 1, scales(1, of="kd")),
    "no ka anywhere": (dict(ka=0.0), 3, scales(1, 2, 3, of="kd")),
    "black": (without(0, 0, "color"), 1, {"sphere 1 is black: kd not determined"}),
    "outside the view": (
        without(2, FAR_AWAY, "center"),
        6,
        {"sphere 3 is not visible: color, exponent, kd and ks not determined"},
    ),
    "a light from behind": (
        dict(lights=[BEHIND[0], LIGHTS[1]]),
        3,
        {"light 1 reaches nothing that is seen: position not determined"},
    ),
}


@pytest.mark.parametrize("double", [True, False], ids=["float64", "float32"])
@pytest.mark.parametrize("case", SHADES_CASES)
def test_shades(case, double):
    changes, nullity, words = SHADES_CASES[case]
    with jax.enable_x64(double):
        truth = scene(np.float64 if double else np.float32, **changes)
        check(found(truth, SHADES), nullity, words)


def test_after_a_fit():
    truth = scene(ka=[0.0, 0.2, 0.3])
    start = scene(
        ka=[0.0, 0.2, 0.3], color=0.5 * np.ones(3), kd=0.5, ks=0.5, exponent=5.0,
        lights=[[200.0, 100, 500], [-250, 0, 500]],
    )  # fmt: skip
    target = st.render(truth, bounces=0, **SIZE)
    fit = st.fit(start, target, free=SHADES, bounces=0)
    assert fit.converged and fit.cost < 1e-15
    check(fit, 1, scales(1, of="kd"))


def test_weak_is_not_undetermined():
    one_far = scene(lights=[LIGHTS[0], [-2e5, -1e5, 1e6]])
    for truth, noise, weak in (
        (scene(), 0.001, []),
        (one_far, 0.001, ["light 2: distance undetermined, direction known to 0.0"]),
        (scene(), 10, ["light 1's position is lost", "light 2's position is lost"]),
    ):
        fit = found(truth, SHADES, noise=noise)
        check(fit, 0, set())
        lights = [w for w in fit.identifiability.weak if w.startswith("light")]
        assert len(lights) == len(weak)
        assert all(word.startswith(start) for word, start in zip(lights, weak, strict=True))
        others = {w for w in fit.identifiability.weak if not w.startswith("light")}
        assert ("sphere 1's color is lost in the noise" in others) == (noise == 10)


def shown(s: st.Scene) -> jax.Array:
    """Returns what a picture determines of the spheres and the lights, flat."""
    s, lights = s.spheres, s.lights.position
    products = s.ka[:, None] * s.color, s.kd[:, None] * s.color
    return jnp.concatenate([x.reshape(-1) for x in (*products, s.ks, s.exponent, lights)])


def test_uncertainty_of_products():
    truth = scene()
    noise = 0.01
    fit = found(truth, LOOKS, noise=noise)
    spread = fit.uncertainty.standard_deviations
    for name in ("color", "ka", "kd"):
        assert np.isinf(spread[name]).all()
    for name in ("ks", "exponent", "light_position"):
        assert np.isfinite(spread[name]).all() and (spread[name] > 0).all()

    # the same from the whole Jacobian of the picture
    places = lambda s: [
        *(getattr(s.spheres, name) for name in LOOKS[:-1]),
        s.lights.position,
    ]
    flat, unravel = ravel_pytree(places(truth))
    at = lambda flat: eqx.tree_at(places, truth, unravel(flat))
    needs = st.needs(truth, free=LOOKS)
    picture = lambda flat: st.render(at(flat), bounces=0, needs=needs, **SIZE).reshape(-1)
    jacobian = np.asarray(jax.jacfwd(picture)(flat))
    slope = np.asarray(jax.jacfwd(lambda flat: shown(at(flat)))(flat))
    unit = np.linalg.norm(jacobian, axis=0)
    # lengths of lights and of colours differ so much that pinv would take one for rounding
    half = noise * slope / unit @ np.linalg.pinv(jacobian / unit, rcond=1e-10)
    np.testing.assert_allclose(fit.uncertainty.of(shown), np.linalg.norm(half, axis=1), rtol=1e-8)
    found_covariance = slope @ fit.uncertainty.covariance @ slope.T
    size = np.linalg.norm(half, axis=1)
    apart = (found_covariance - half @ half.T) / np.outer(size, size)
    assert np.abs(apart).max() < 1e-8


def test_uncertainty_counts_remaining_step():
    truth = scene()
    target = st.render(truth, bounces=0, **SIZE)
    start = eqx.tree_at(lambda s: s.spheres.ks, truth, truth.spheres.ks + 0.05)
    fit = found(start, ("ks",), target, noise=1e-6)  # linear: one step would do
    spread = fit.uncertainty.standard_deviations["ks"]
    np.testing.assert_allclose(spread, 0.05, rtol=1e-3)


PRODUCTS = ("color", "ka", "kd", "ks", "light_color", "exposure")
BACKGROUND = (0.1, 0.2, 0.3)  # where it is seen, it tells the exposure
WALL = dict(center=[[-40, 0, 0], [45, 10, 0], [0, 0, -1100]], radius=[35, 30, 1000])
AGAINST_WEIGHTS = "the lights' color against the spheres' ka, kd and ks is not determined"
SHARE = "lights 1 and 2 are at one place: how they share their color is not determined"


def channels(up: str, down: str, names: str = "red green blue", of: str = "") -> set[str]:
    return {f"{up} against {down} is not determined in {c}{of}" for c in names.split()}


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


@pytest.mark.parametrize("case", PRODUCTS_CASES)
def test_products(case):
    changes, nullity, words = PRODUCTS_CASES[case]
    truth = scene(**(dict(background=BACKGROUND) | changes))
    check(found(truth, PRODUCTS), nullity, words)


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


@pytest.mark.parametrize("case", WORLD_CASES)
def test_motion_with_eye(case):
    planes, changes, nullity, words = WORLD_CASES[case]
    planes = [list(x) for x in zip(*planes, strict=True)]
    check(found(scene(planes=planes, **(SMALL | changes)), GEOMETRY), nullity, words)


@pytest.mark.slow
def test_motion_with_eye_antialiased():
    truth = scene(**SMALL | dict(center=[[-40, 0, 0], [0, 20, 70]], ks=0.0)).with_antialias(1)
    check(found(truth, GEOMETRY), 4, WORLD | {SCALE})


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


@pytest.mark.parametrize("case", PICTURES_CASES)
def test_several_pictures(case):
    truth, clipped, nullity, words = PICTURES_CASES[case]
    target = [np.array(st.render(s, bounces=0, **SIZE)) for s in truth]
    assert all(picture.max() < 1 for picture in target)
    for k in clipped:
        target[k][(target[k] == BACKGROUND).all(axis=-1)] = 1
    fit = found(truth, SEVERAL, target, own=("light_color",))
    check(fit, nullity, words)
    spread = fit.uncertainty.standard_deviations
    assert spread["light_color"].shape == (2, 2, 3) and spread["exposure"].shape == (2, 3)
    assert (np.isnan(spread["light_color"]) == [[[False]] * 2, [[False], [True]]]).all()
