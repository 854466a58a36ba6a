"""Fits in stiff valleys and to hopeless targets.

Three spheres and one or two lights, 48 x 48 pixels, float64, single rays. Free by default: color,
ka, kd, ks, which start 10 % off, and the lights' positions, some degrees off and a fifth too far.
"Right" is an error of at most 1e-7 in the lights' directions and inverse distances, and in those of
ka color, kd color and ks whose standard deviation is below 1e-3.
"""

import equinox as eqx
import numpy as np
from helpers.scenes import three_apart as scene

import spheretrace_jax as st
from extremes.case import Case, case
from spheretrace_jax.fit.fit import DEFAULT_FREE
from spheretrace_jax.fit.model.products import PRODUCTS

SIZE = dict(width=48, height=48)
LIGHT = [900.0, -400, 700]
IN_FRONT = [[-90.0, 60, 0], [10, -10, 40], [110, -110, 180]]
RIGHT = "converges and is right"


def wrong_start(truth: st.Scene, exponent: bool = False) -> st.Scene:
    """Returns a start whose free parameters are all wrong."""
    s = truth.spheres
    turn = np.array([[0.995, -0.1, 0], [0.1, 0.995, 0], [0, 0, 1]])
    materials = lambda x: (x.spheres.color, x.spheres.ka, x.spheres.kd, x.spheres.ks)
    wrong = [x * 0.9 for x in (s.color, s.ka, s.kd, s.ks)]
    start = eqx.tree_at(materials, truth, wrong)
    start = eqx.tree_at(lambda x: x.lights.position, start, truth.lights.position @ turn * 1.2)
    if exponent:
        start = eqx.tree_at(lambda x: x.spheres.exponent, start, s.exponent * 1.3)
    return start


def fitted(truth: st.Scene, target=None, exponent: bool = False) -> st.Fit:
    """Fits a scene's picture, or another target, from a wrong start."""
    target = np.asarray(st.render(truth, bounces=0, **SIZE)) if target is None else target
    free = (*DEFAULT_FREE, *(["exponent"] * exponent))
    return st.fit(wrong_start(truth, exponent), target, free=free, bounces=0)


def product_error(found: st.Fit, truth: st.Scene) -> tuple[float, float]:
    """Returns the largest error of the products that the fit calls known, and their fraction."""
    worst, known = 0.0, []
    for product in PRODUCTS.values():
        is_known = found.uncertainty.of(product) < 1e-3
        error = np.abs(np.asarray(product(found.scene) - product(truth)))
        worst = max(worst, float(np.max(error, where=is_known, initial=0)))
        known.append(is_known.reshape(-1))
    return worst, float(np.concatenate(known).mean())


def light_error(found: st.Fit, truth: st.Scene) -> float:
    """Returns the largest error of direction and inverse distance, which far lights determine."""
    worst = 0.0
    for x, y in zip(found.scene.lights.position, truth.lights.position, strict=True):
        lengths = np.linalg.norm(x), np.linalg.norm(y)
        direction = np.abs(np.asarray(x) / lengths[0] - np.asarray(y) / lengths[1]).max()
        worst = max(worst, float(direction), abs(100 / lengths[0] - 100 / lengths[1]))
    return worst


def comes_back(tried: str, truth: st.Scene, exponent: bool = False, slow: bool = False) -> Case:
    """Makes a case of a stiff valley along which the fit recovers the scene."""

    def check() -> str:
        found = fitted(truth, exponent=exponent)
        (error, known), light = product_error(found, truth), light_error(found, truth)
        assert found.trust.ok, found.trust.verdict
        assert known >= 0.6, f"only {known:.0%} of the products are known"
        assert error <= 1e-7 and light <= 1e-7, f"off by {error:.1e}, the light by {light:.1e}"
        return f"{found.steps} steps; products to {error:.0e}, light to {light:.0e}"

    return Case(tried, RIGHT, check, slow=slow)


FAINT = [[1e-6, 2e-6, 1e-6], [0.2, 0.7, 0.4], [0.5, 0.5, 0.9]]

VALLEYS = [
    comes_back("highlights of a pixel: exponents 10,000, 1000, 300",
        scene(LIGHT, exponent=[1e4, 1e3, 300])),
    comes_back("exponents of 0.01", scene(LIGHT, exponent=0.01)),
    comes_back("a colour of 1e-6", scene(LIGHT, color=FAINT)),
    comes_back("a light at 1e5 radii", scene([1e7, -4e6, 7e6])),
    comes_back("a light at 1e6 radii", scene([1e8, -4e7, 7e7])),
    comes_back("a light at 1e12 radii", scene([1e14, -4e13, 7e13])),
    comes_back("a light that grazes a sphere, 10 from it", scene([-90.0, 60, 90])),
    comes_back("ks of 1e-6", scene(LIGHT, ks=1e-6)),
    comes_back("spheres in one another's shadow", scene([300.0, -300, 600], center=IN_FRONT)),
    comes_back("wide highlights of unknown exponents 1, 3, 2",
        scene(LIGHT, exponent=[1.0, 3, 2]), exponent=True, slow=True),
    comes_back("two lights 5 degrees apart", scene(LIGHT, [850.0, -480, 720]), slow=True),
    comes_back("two lights half a degree apart", scene(LIGHT, [895.0, -408, 702]), slow=True),
    comes_back("two lights 0.001 degrees apart",
        scene(LIGHT, [900.01, -399.99, 700.01]), slow=True),
]  # fmt: skip


def says(tried: str, truth: st.Scene, *words: str) -> Case:
    """Makes a case of undetermined parameters, which the fit names; the others are right."""

    def check() -> str:
        found = fitted(truth)
        (error, known), said = product_error(found, truth), str(found.trust).splitlines()
        assert found.trust.ok, found.trust.verdict
        assert error <= 1e-7, f"known products are off by {error:.1e}"
        for sentence in words:
            assert sentence in said, f"{sentence!r} is not in {said}"
        return f"{known:.0%} of the products are known, to {error:.0e}; says: {'; '.join(words)}"

    return Case(
        tried, "what the fit calls known is right, and it names what is not determined", check
    )


ALL_OF_IT = "color, ka, kd and ks not determined"
BLACK = [[0.0, 0, 0], *FAINT[1:]]
NO_LIGHT = "no light reaches what is seen of"

HIDDEN = [
    says("a sphere in the full shadow of another",
        scene([300.0, -300, 600], center=[[-90.0, 60, 0], [-170, 140, -160], [110, -110, 180]]),
        f"{NO_LIGHT} sphere 2: kd and ks not determined"),
    says("a light behind everything", scene([300.0, -300, -60000]),
        *(f"{NO_LIGHT} sphere {i}: kd and ks not determined" for i in (1, 2, 3)),
        "light 1 reaches nothing that is seen: position not determined"),
    says("a sphere outside the picture",
        scene(LIGHT, center=[[-90.0, 60, 0], [1e5, 0, 0], [10, -90, -40]]),
        f"sphere 2 is not visible: {ALL_OF_IT}"),
    says("a sphere behind another",
        scene(LIGHT, center=[[-90.0, 60, 0], [-90, 60, -100], [10, -90, -40]],
            radius=[80.0, 10, 90]),
        f"sphere 2 is not visible: {ALL_OF_IT}"),
    says("a sphere inside another",
        scene(LIGHT, center=[[-90.0, 60, 0], [-90, 60, 0], [10, -90, -40]], radius=[80.0, 79, 90]),
        f"sphere 2 is not visible: {ALL_OF_IT}"),
    says("a sphere of 1e-3 pixels",
        scene(LIGHT, radius=[80.0, 0.01, 90]), f"sphere 2 is not visible: {ALL_OF_IT}"),
    says("a colour of 0", scene(LIGHT, color=BLACK),
        "sphere 1 is black: ka and kd not determined"),
    says("colours and ks of 0", scene(LIGHT, color=np.zeros((3, 3)), ks=0.0),
        *(f"sphere {i} is black: ka and kd not determined" for i in (1, 2, 3)),
        "light 1 does not show: position not determined"),
    says("highlights smaller than a pixel: exponents of 1e6", scene(LIGHT, exponent=1e6),
        *(f"no highlight is seen on sphere {i}: ks not determined" for i in (1, 2, 3))),
]  # fmt: skip

TRUTH = scene(LIGHT)
SHAPE = (SIZE["height"], SIZE["width"], 3)


def picture() -> np.ndarray:
    return np.asarray(st.render(TRUTH, bounces=0, **SIZE))


def noise() -> np.ndarray:
    return np.random.default_rng(0).standard_normal(SHAPE)


def not_explained(tried: str, target, verdict: str, slow: bool = False) -> Case:
    """Makes a case of a target that no parameters explain."""

    def check() -> str:
        found = fitted(TRUTH, target())
        assert not found.trust.ok and verdict in found.trust.verdict, found.trust.verdict
        return found.trust.verdict

    return Case(tried, "is not trusted, and says why", check, slow=slow)


def refused(tried: str, target, message: str) -> Case:
    """Makes a case of an invalid target."""

    def check() -> str:
        try:
            fitted(TRUTH, target())
        except st.InputError as error:
            assert message in str(error), error
            return f"{type(error).__name__}: {error}"
        raise AssertionError("no error")

    return Case(tried, "is refused in one line", check)


def with_nan() -> np.ndarray:
    target = picture().copy()
    target[3, 4, 1] = np.nan
    return target


NOT, NOTHING = "does NOT explain picture", "NO more of the picture than it would of noise"
TARGETS = [
    not_explained("a target that is 0.5 everywhere", lambda: np.full(SHAPE, 0.5), NOT),
    not_explained("a target 50 times too bright", lambda: 50 * picture(), NOT, slow=True),
    not_explained("a target of 1e-30", lambda: 1e-30 * picture(), NOT),
    not_explained("a target of 1e300", lambda: np.full(SHAPE, 1e300), "NOT converged"),
    not_explained("a negative target", lambda: -picture(), NOT),
    not_explained("a target upside down", lambda: picture()[::-1], NOT),
    not_explained("a target of noise in 0..1", lambda: np.random.default_rng(0).random(SHAPE), NOT),
    not_explained("a target of normal noise", noise, NOTHING),
    not_explained("a picture in noise of 10", lambda: picture() + 10 * noise(), NOTHING),
    refused("a target that is 1 everywhere", lambda: np.ones(SHAPE), "is clipped"),
    refused("a target of nan", lambda: np.full(SHAPE, np.nan), "6912 numbers that are nan or inf"),
    refused("a target with one nan", with_nan, "1 numbers that are nan or inf"),
    refused("a target of inf", lambda: np.full(SHAPE, np.inf), "6912 numbers that are nan or inf"),
    refused("a target with alpha", lambda: np.zeros((48, 48, 4)), "(height, width, 3)"),
    refused("a target without rows", lambda: np.zeros((0, 48, 3)), "(height, width, 3)"),
    refused("a target of integers", lambda: np.zeros(SHAPE, int), "uint8 or uint16, got int64"),
]  # fmt: skip


@case(
    "a target that is 0 everywhere",
    "the scene becomes black, and the fit names what is not determined",
)
def black_target() -> str:
    found = fitted(TRUTH, np.zeros(SHAPE))
    assert found.trust.ok, found.trust.verdict
    left = float(np.abs(np.asarray(st.render(found.scene, bounces=0, **SIZE))).max())
    assert left <= 1e-9
    known = found.identifiability
    assert known.rank < known.free and known.undetermined
    return f"black to {left:.0e}; says: {'; '.join(known.undetermined)}"


@case("a picture cut to its left half", "is not trusted, and says why", slow=True)
def half_target() -> str:
    found = fitted(TRUTH, picture()[:, :24])
    assert not found.trust.ok and NOT in found.trust.verdict, found.trust.verdict
    return found.trust.verdict
