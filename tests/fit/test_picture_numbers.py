"""Pictures and masks of other numbers: scaled with a word, or refused."""

import warnings

import numpy as np
import pytest

import spheretrace_jax as st
from spheretrace_jax.fit.model.picture_numbers import linear_numbers, yes_or_no
from spheretrace_jax.fit.model.target import make_target

LEVELS = np.arange(4 * 5 * 3).reshape(4, 5, 3) * 4 + 3  # up to 239


@pytest.mark.parametrize(
    ("image", "white"),
    [
        (LEVELS.astype(np.uint8), 255),
        (LEVELS.astype(np.uint16), 65535),
        (LEVELS.astype(np.float32), 255),
        (LEVELS * 1.0 * 250, 65535),
        (LEVELS / 239 * 252, 255),
    ],
)
def test_numbers_of_files(image, white):
    found, said = linear_numbers(image)
    np.testing.assert_allclose(found, image / white, rtol=1e-6)
    assert said and f"divided by {white}" in said
    with pytest.warns(st.PictureWarning, match=f"over 0..{white} are taken as linear"):
        target = make_target(image, np.dtype(np.float64), brightest=np.inf)
    np.testing.assert_allclose(target.image, image / white, rtol=1e-6)


@pytest.mark.parametrize(
    "image",
    [
        LEVELS / 255,
        LEVELS / 10,
        LEVELS * 1e300,
        -1.0 * LEVELS,
        np.full((4, 5, 3), 7.0),
        LEVELS * 0.5,
    ],
)
def test_linear_numbers_stay(image):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found, said = linear_numbers(image)
    np.testing.assert_array_equal(found, image)
    assert said is None


@pytest.mark.parametrize("shape", [(4, 5), (4, 5, 1)])
def test_grey(shape):
    grey = np.linspace(0, 0.9, 20).reshape(shape)
    found, said = linear_numbers(grey)
    assert found.shape == (4, 5, 3) and said and "grey" in said
    for c in range(3):
        np.testing.assert_array_equal(found[..., c], grey.reshape(4, 5))


@pytest.mark.parametrize("shape", [(4, 5, 4), (4, 5, 2), (0, 5), (4,), (1, 4, 5, 3)])
def test_other_shapes(shape):
    with pytest.raises(st.PictureError, match=r"must have shape \(height, width, 3\), or"):
        linear_numbers(np.zeros(shape))


@pytest.mark.parametrize("dtype", [int, bool, complex, np.int8])
def test_other_types(dtype):
    with pytest.raises(st.PictureError, match="uint8 or uint16, got"):
        linear_numbers(np.zeros((4, 5, 3), dtype))


@pytest.mark.parametrize(
    "mask",
    [
        [[True, False, True]],
        [[255, 0, 255]],
        np.array([[255, 0, 128]], np.uint8),
        [[1, 0, 1]],
        [[0.9, 0.0, 1.0]],
        [[255.0, 0, 200]],
    ],
)
def test_masks(mask):
    assert yes_or_no(np.asarray(mask)).tolist() == [[True, False, True]]


@pytest.mark.parametrize("mask", [[[-1, 0]], [[0, 256]], [[0.5, 3.2]], [[np.nan, 1]]])
def test_bad_masks(mask):
    with pytest.raises(st.InputError, match="the mask must hold yes and no"):
        yes_or_no(np.asarray(mask))
