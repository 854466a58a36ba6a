"""Identifiability of scenes that are made so that what their pictures determine is known."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.identifiability import (
    BEHIND,
    FAR_AWAY,
    HIDDEN,
    LIGHTS,
    SIDE,
    SIZE,
    check,
    fit_at,
    scales,
    scene,
    without,
)
from jax.flatten_util import ravel_pytree

import spheretrace_jax as st

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


@pytest.mark.slow
@pytest.mark.parametrize("case", LOOKS_CASES)
def test_looks(case):
    changes, nullity, words = LOOKS_CASES[case]
    check(fit_at(scene(**changes), LOOKS), nullity, words)


def test_masked_spheres():
    left = np.arange(SIZE["width"]) < 16
    mask = np.broadcast_to(left, (SIZE["height"], SIZE["width"]))
    words = {f"sphere 2 is not visible where the target counts: {ALL_OF_IT}"}
    check(fit_at(scene(), LOOKS, mask=mask), 9, words | scales(1, 3))
    # the three numbers of one more pixel tell three of its seven
    mask = mask.copy()
    mask[10, 24] = True
    known = fit_at(scene(), LOOKS, mask=mask).identifiability
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


@pytest.mark.parametrize(
    "double",
    [pytest.param(True, id="float64"), pytest.param(False, id="float32", marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("case", SHADES_CASES)
def test_shades(case, double):
    changes, nullity, words = SHADES_CASES[case]
    with jax.enable_x64(double):
        truth = scene(np.float64 if double else np.float32, **changes)
        check(fit_at(truth, SHADES), nullity, words)


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
        (one_far, 0.001, ["light 2 is at infinity: its distance does not show, but is at least"]),
        (scene(), 10, ["light 1's position is lost", "light 2's position is lost"]),
    ):
        fit = fit_at(truth, SHADES, noise=noise)
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
    fit = fit_at(truth, LOOKS, noise=noise)
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
    fit = fit_at(start, ("ks",), target, noise=1e-6)  # linear: one step would do
    spread = fit.uncertainty.standard_deviations["ks"]
    np.testing.assert_allclose(spread, 0.05, rtol=1e-3)
