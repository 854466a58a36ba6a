"""Pictures on Matplotlib axes, and what notebooks show."""

import base64
import io
import re
from types import SimpleNamespace
from unittest.mock import Mock

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib
import matplotlib.image
import numpy as np
import pytest
from helpers.scenes import SCENES
from helpers.unchecked import messages
from matplotlib.figure import Figure

import spheretrace_jax as st
from spheretrace_jax.display import notebook

SCENE = SCENES["diffuse"]


def drawn(html: str) -> list[np.ndarray]:
    """Returns the pictures that a piece of HTML holds."""
    found = re.findall(r"base64,([^']+)'", html)
    return [matplotlib.image.imread(io.BytesIO(base64.b64decode(data))) for data in found]


@pytest.fixture(scope="module")
def html():
    return SCENE._repr_html_()


def test_numbers_of_a_display():
    picture = np.array([[[0.0, 0.5, 1.0], [2.0, -1.0, np.nan]]])
    expected = [[[0, 0.735357, 1], [1, 0, 0]]]
    np.testing.assert_allclose(st.to_srgb(picture), expected, atol=1e-6)
    np.testing.assert_allclose(st.to_srgb(jnp.asarray(picture, jnp.float32)), expected, atol=1e-6)


def test_other_pictures_are_refused():
    got = {"np.zeros((3, 4))": "shape (3, 4)", "'nine.png'": "str", "None": "NoneType"}
    expected = {
        f"st.{use}({picture})": "InputError: expected a picture of shape (height, width, 3), or a "
        f"Scene, got {words}"
        for picture, words in got.items()
        for use in ("to_srgb", "show")
    }
    assert messages(list(expected)) == expected


def test_a_picture_is_shown_as_it_is():
    picture = np.linspace(0, 1, 18).reshape(2, 3, 3)
    ax = Figure().subplots()
    assert st.show(picture, ax, title="a picture") is ax and ax.get_title() == "a picture"
    np.testing.assert_allclose(ax.images[0].get_array(), st.to_srgb(picture))
    with pytest.raises(st.InputError, match="a picture is shown as it is: unknown width"):
        st.show(picture, ax, width=8)


def test_a_scene_is_rendered():
    matplotlib.use("agg")
    ax = st.show(SCENE, width=24, height=16, bounces=0)
    expected = st.to_srgb(st.render(SCENE, width=24, height=16, bounces=0))
    np.testing.assert_allclose(ax.images[0].get_array(), expected)


def test_a_scene_is_its_picture_beside_its_table(html):
    (picture,) = drawn(html)
    assert picture.shape[:2] == (160, 160) and picture[..., :3].max() > 0.2
    assert html.count("<tr>") == 1 + len(SCENE.spheres) and "http" not in html
    assert str(SCENE).splitlines()[0] in html


def test_long_scenes_are_shown_in_part(html):
    n = 300
    spheres = st.Spheres(np.zeros((n, 3)) + np.arange(n)[:, None], np.ones(n))
    html = st.Scene(spheres, SCENE.lights)._repr_html_()
    assert not drawn(html) and "and 288 more spheres" in html


def test_displays_never_fail():
    broken = eqx.tree_at(lambda s: s.spheres.radius, SCENE, -SCENE.spheres.radius)
    assert "spheres.radius[0] must be greater than 0" in broken._repr_html_()
    said = []
    jax.jit(lambda s: said.append(s._repr_html_()) or s.spheres.ka)(SCENE)
    assert "its numbers are traced" in said[0]


def test_a_fit_is_its_summary_beside_its_picture():
    fit = Mock(spec=st.Fit, scene=SCENE, trust=SimpleNamespace(grade="usable"))
    fit.__str__ = lambda _: "converged, usable\nsphere 1's <ks> is lost"
    html = notebook.fit_html(fit)
    assert len(drawn(html)) == 1 and "#c98a00" in html and "&lt;ks&gt;" in html
