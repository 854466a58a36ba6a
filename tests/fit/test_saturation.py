"""Saturation: levels at which a channel is clipped, and flat areas that are not."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import nine_spheres

import spheretrace_jax as st
from spheretrace_jax.fit.model.saturation import plateaus, saturated
from spheretrace_jax.fit.model.target import make_target

PLAIN = dict(bounces=0)
DOUBLE = np.dtype(np.float64)
COLORS = np.random.default_rng(0).uniform(0.3, 0.9, (9, 3))


def scene(**changes) -> st.Scene:
    """Returns nine coloured spheres, with some parameters changed."""
    nine = nine_spheres((100.0, 500, 800))
    nine = eqx.tree_at(lambda s: s.spheres.color, nine, jnp.asarray(COLORS))
    for name, value in changes.items():
        owner = (lambda s: s) if name == "background" else (lambda s: s.spheres)
        nine = eqx.tree_at(lambda s, n=name, o=owner: getattr(o(s), n), nine, jnp.asarray(value))
    return nine


def drawn(shown: st.Scene, size: int = 64, antialias: int = 0) -> np.ndarray:
    return np.asarray(
        st.render(shown.with_antialias(antialias), width=size, height=size, **PLAIN), np.float64
    )


def coded(picture: np.ndarray, most: int, bits: int = 8) -> np.ndarray:
    """Returns the linear numbers of a file in sRGB, of a camera that saturates at a level."""
    whole, x = 2**bits - 1, np.clip(picture, 0, 1)
    srgb = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    levels = np.minimum(np.round(srgb * whole), most) / whole
    return np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)


def left_out(picture: np.ndarray) -> np.ndarray:
    return saturated(picture, np.full(picture.shape, True))


@pytest.fixture(scope="module", params=[(40, 1), (64, 0), (200, 0)], ids=str)
def bright(request) -> np.ndarray:
    picture = drawn(scene(), *request.param)
    return 1.5 * picture / picture.max(axis=(0, 1))


@pytest.mark.parametrize("noise", [0, 0.01])
@pytest.mark.parametrize(
    "camera",
    [
        lambda x: np.minimum(x, 0.9),
        lambda x: np.minimum(x, [0.9, 0.7, 0.8]),
        lambda x: np.minimum(4 * x, 3.7),
        lambda x: np.minimum(x, 0.9).astype(np.float32),
        lambda x: coded(x, 250),
        lambda x: coded(x, 240),
        lambda x: coded(x, 65000, bits=16),
        lambda x: coded(x, 255),
    ],
    ids=["0.9", "by channel", "3.7", "float32", "250", "240", "65000 of 65535", "255"],
)
def test_clipped_channels(bright, camera, noise):
    picture = camera(bright + noise * np.random.default_rng(0).standard_normal(bright.shape))
    top = picture >= picture.max(axis=(0, 1)) * (1 - 1e-6)
    np.testing.assert_array_equal(left_out(picture), top)
    assert top.sum() > 90


def test_one_clipped_channel(bright):
    picture = np.minimum(bright, [0.8, 9, 9])
    np.testing.assert_array_equal(left_out(picture)[..., 0], picture[..., 0] == 0.8)
    assert not left_out(picture)[..., 1:].any()


DARK = dict(ka=np.full(9, 0.1), kd=np.full(9, 0.5), ks=np.full(9, 0.1))
ONE = np.arange(9) == 4


@pytest.mark.parametrize("camera", [lambda x: x, lambda x: coded(x, 255)], ids=["float", "8 bits"])
@pytest.mark.parametrize(
    ("size", "antialias"),
    [
        (24, 0),
        (64, 0),
        (200, 0),
        *(pytest.param(s, 1, marks=pytest.mark.slow) for s in (24, 64, 200)),
    ],
)
@pytest.mark.parametrize(
    "changes",
    [
        DARK,
        DARK | dict(ks=np.full(9, 0.3), exponent=np.full(9, 2.0)),
        DARK | dict(ka=np.where(ONE, 0.95, 0.1), kd=np.where(ONE, 0, 0.3)),
        DARK | dict(background=[0.9, 0.95, 0.99]),
        DARK | dict(background=[0.8, 0.8, 0.8]),
    ],
    ids=["shaded", "wide highlights", "flat sphere", "sky", "grey sky"],
)
def test_whole_channels(changes, size, antialias, camera):
    picture = drawn(scene(**changes), size, antialias)
    assert picture.max() < 0.995 and not left_out(camera(picture)).any()


def test_plateaus_of_flat_areas():
    """Checks that what is not left out is known, so that it can be asked about."""
    picture = drawn(scene(**DARK, background=[0.6, 0.65, 0.7]))
    tops = plateaus(picture, np.full(picture.shape, True))
    assert [(t.channel, t.level) for t in tops] == [(0, 0.6), (1, 0.65), (2, 0.7)]


def test_highlight_of_exactly_1():
    """Checks that a highlight that just reaches 1 loses no more than its top."""
    picture = drawn(scene(), 64, 1)
    picture = picture / picture.max()
    assert left_out(picture).sum() <= 2
    assert not left_out(1.7 * picture).any()


def test_brightest():
    picture = drawn(scene())
    picture = 0.99 * picture / picture.max()
    counted = lambda x: np.asarray(make_target(picture, DOUBLE, brightest=x).weight) > 0
    np.testing.assert_array_equal(counted(0.5), picture < 0.5)
    levels = np.array([0.3, 0.5, 0.7])
    np.testing.assert_array_equal(counted(levels), picture < levels)
    np.testing.assert_array_equal(counted((0.3, np.inf, 0.7))[..., 1], True)
    # six digits are enough to name a level
    level = np.sort(picture[..., 0].ravel())[-30]
    assert not counted(float(f"{level:.6g}"))[picture == level].any()
    white = np.minimum(2 * picture, 1)
    assert make_target(white, DOUBLE, brightest=np.inf).counted == white.size
    assert make_target(white, DOUBLE).counted == np.count_nonzero(white < 1) < white.size


@pytest.mark.parametrize("brightest", [np.nan, (0.5, 0.5), (0.5, 0.5, np.nan), "white"])
def test_bad_brightest(brightest):
    with pytest.raises(st.InputError, match="brightest must be one number or one for each channel"):
        make_target(np.full((4, 4, 3), 0.5), DOUBLE, brightest=brightest)


def test_nothing_below_brightest():
    with pytest.raises(st.PictureError, match="every number of the target is clipped"):
        make_target(np.full((4, 4, 3), 0.5), DOUBLE, brightest=0.5)


TRUTH = st.Scene(
    st.Spheres(
        [[-60.0, 0, 0], [70, 20, 10], [0, 60, 60]], [60.0, 50, 30],
        [[0.8, 0.3, 0.2], [0.2, 0.6, 0.9], [0.5, 0.7, 0.3]], 0.2, 0.6, 0.3, exponent=12.0,
    ),
    st.Lights([[200.0, 300, 500]], [[2.0, 2, 2]]),
    st.Camera(theta=-1.2, phi=0.5),
)  # fmt: skip


def errors(found: st.Fit) -> tuple[float, float]:
    """Returns the largest error of kd color, and the light's in degrees."""
    kd_color = lambda s: np.asarray(s.spheres.kd[:, None] * s.spheres.color)
    light, true = (np.asarray(s.lights.position[0]) for s in (found.scene, TRUTH))
    cosine = light @ true / np.linalg.norm(light) / np.linalg.norm(true)
    error = np.abs(kd_color(found.scene) - kd_color(TRUTH)).max()
    return float(error), float(np.degrees(np.arccos(min(cosine, 1))))


@pytest.mark.slow
def test_fit_of_a_saturated_camera():
    """A camera that saturates at 250 of 255, which nothing says."""
    picture = drawn(TRUTH)
    target = coded(picture, 250)
    clipped = picture > 0.96
    assert clipped.sum() > 250
    start = eqx.tree_at(lambda s: s.spheres.kd, TRUTH, jnp.full(3, 0.4))
    found = st.fit(start, target, **PLAIN)
    assert found.trust.ok and found.left_out == np.count_nonzero(target == target.max())
    assert errors(found)[0] < 0.01 and errors(found)[1] < 0.1
    assert "saturated: red at 0.955973 (" in found.trust.verdict
    assert "NOTE" not in found.trust.verdict
    given = st.fit(start, target, brightest=0.955973, **PLAIN)
    assert given.left_out == found.left_out and errors(given) == errors(found)
    naive = st.fit(start, target, brightest=np.inf, **PLAIN)
    assert naive.left_out == 0 and errors(naive)[0] > 0.1 and errors(naive)[1] > 1
    assert "saturated" not in naive.trust.verdict


@pytest.mark.slow
def test_fit_of_a_flat_area():
    """Checks that a bright background counts and is asked about, unless the user said more."""
    truth = eqx.tree_at(lambda s: s.background, TRUTH, jnp.full(3, 0.8))
    truth = eqx.tree_at(lambda s: s.lights.color, truth, jnp.full((1, 3), 0.8))
    found = st.fit(truth, drawn(truth), free=("kd",), **PLAIN)
    assert found.left_out == 0 and found.trust.ok
    assert "NOTE many numbers stand at the top of red at 0.8 (" in found.trust.verdict
    said = st.fit(truth, drawn(truth), free=("kd",), brightest=np.inf, **PLAIN)
    assert "NOTE" not in said.trust.verdict and said.left_out == 0
