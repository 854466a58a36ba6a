"""Layers as channels of EXR files, written by Python and by the command line."""

import warnings

import jax.numpy as jnp
import numpy as np
import OpenImageIO as oiio
import pytest
from helpers.commands import TEXT, spheretrace

import spheretrace_jax as st

PICTURE = np.random.default_rng(0).uniform(0, 2, (4, 5, 3)).astype(np.float32)


def _layers(height: int = 4, width: int = 5) -> st.Layers:
    random = np.random.default_rng(1)
    number = lambda *shape: random.uniform(0, 1, (height, width, *shape)).astype(np.float32)
    depth = number()
    depth[0, 0] = np.inf
    objects = np.arange(height * width).reshape(height, width) * 4000 - 1
    return st.Layers(*map(jnp.asarray, (depth, number(3), objects, number())))


def _channels(path) -> dict[str, np.ndarray]:
    file = oiio.ImageInput.open(str(path))
    pixels = file.read_image(oiio.FLOAT)
    return dict(zip(file.spec().channelnames, np.moveaxis(pixels, -1, 0), strict=True))


@pytest.mark.parametrize("bits", [16, 32])
def test_layers_are_channels_beside_the_colours(bits, tmp_path):
    path, layers = tmp_path / "a.exr", _layers()
    st.write_image(path, PICTURE, layers=layers, bits=bits)
    found = _channels(path)
    assert set(found) == {"R", "G", "B", "A", "Z", "N.X", "N.Y", "N.Z", "id"}
    np.testing.assert_array_equal(found["A"], layers.coverage)
    np.testing.assert_array_equal(found["Z"], layers.depth)
    for k, name in enumerate("XYZ"):
        np.testing.assert_array_equal(found[f"N.{name}"], layers.normal[..., k])
    np.testing.assert_array_equal(found["id"], layers.object)
    error = 1e-3 if bits == 16 else 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # no layer of colours could be meant but one
        warnings.filterwarnings("ignore", ".* transparent")
        np.testing.assert_allclose(st.read_image(path), PICTURE, rtol=error)


def test_layers_need_exr_and_the_size_of_the_picture(tmp_path):
    with pytest.raises(st.PictureError, match=r"layers need an EXR file \(.exr\), got '.png'"):
        st.write_image(tmp_path / "a.png", PICTURE, layers=_layers())
    with pytest.raises(st.PictureError, match=r"layers of shape \(4, 5\), .* got \(5, 5\)"):
        st.write_image(tmp_path / "a.exr", PICTURE, layers=_layers(5))
    assert not list(tmp_path.iterdir())


def test_the_command_line_writes_layers(tmp_path):
    scene, path = tmp_path / "scene.txt", tmp_path / "a.exr"
    scene.write_text(TEXT)
    size = ("--size", "32x24")
    assert spheretrace("render", scene, "-o", path, *size, "--layers")[0] == 0
    found, layers = _channels(path), st.render_layers(st.load_scene(scene), width=32, height=24)
    np.testing.assert_array_equal(found["id"], layers.object)
    np.testing.assert_allclose(found["Z"], layers.depth, rtol=1e-5)
    np.testing.assert_allclose(found["A"], layers.coverage, rtol=1e-5)
    status, out, err = spheretrace("render", scene, "-o", tmp_path / "a.png", *size, "--layers")
    assert (status, out) == (2, "") and "layers need an EXR file" in err and err.count("\n") == 1
    assert not (tmp_path / "a.png").exists()
