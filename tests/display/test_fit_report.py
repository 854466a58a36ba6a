"""The report of a fit: one page that needs no network, and the same in Markdown."""

import base64
import io
import re
from html.parser import HTMLParser

import equinox as eqx
import jax
import matplotlib.image
import numpy as np
import pytest
from helpers.browser import pages

import spheretrace_jax as st
from spheretrace_jax.base.srgb import code_srgb

WIDTH, HEIGHT = 24, 20
SPHERES = st.Spheres([[-60.0, 0, 0], [70, 10, 0]], [80.0, 60], [[0.8, 0.3, 0.2], [0.2, 0.5, 0.9]])
LIGHTS = [
    st.Lights([[200.0, 100, 300]], [[1.0, 1, 1]]),
    st.Lights([[-250.0, 50, 300]], [[1.0] * 3]),
]
MASK = np.ones((HEIGHT, WIDTH), bool)
MASK[:6, :5] = False


@pytest.fixture(scope="module")
def fit():
    """Fits two pictures with lights of their own, of which a corner does not count."""
    scenes = [st.Scene(SPHERES, lights) for lights in LIGHTS]
    targets = [np.array(st.render(s, width=WIDTH, height=HEIGHT, bounces=0)) for s in scenes]
    starts = [eqx.tree_at(lambda s: s.spheres.color, s, 0.7 * SPHERES.color) for s in scenes]
    with jax.numpy_dtype_promotion("standard"):
        return st.fit(
            starts, targets, free=("color", "light_position"), own=("light_position",), bounces=0,
            mask=[MASK, None],
        )  # fmt: skip


@pytest.fixture(scope="module")
def text(fit, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "fit.html"
    assert fit.report(path) == [path]
    return path.read_text(encoding="utf-8")


class Page(HTMLParser):
    """Collects what a page holds; elements must be closed in order."""

    def __init__(self, text: str):
        super().__init__()
        self.open, self.images, self.addresses, self.words = [], [], [], []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        named = dict(attrs)
        self.addresses += [named[k] for k in ("src", "href") if k in named]
        if tag == "img":
            assert named["alt"]
            data = named["src"].removeprefix("data:image/png;base64,")
            self.images.append(matplotlib.image.imread(io.BytesIO(base64.b64decode(data))))
        if tag not in ("img", "meta", "link", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


def test_the_page_is_one_file_with_its_pictures_inside(fit, text):
    page = Page(text)
    assert all(a.startswith("data:") for a in page.addresses) and "url(" not in text
    # of each picture: target, start, fit, two on the slider, the residual; and the cost curve
    assert len(page.images) == 2 * 6 + 1
    assert [i.shape[:2] for i in page.images[:5]] == [(HEIGHT, WIDTH)] * 5
    assert "script" not in text


def test_pictures_are_those_of_target_start_and_fit(fit, text):
    images = Page(text).images
    counts = MASK[..., None]
    scenes = [fit.problem.targets[0].image] + [
        st.render(scene, width=WIDTH, height=HEIGHT, bounces=0)
        for scene in (fit.starts[0], fit.scenes[0])
    ]
    for image, linear in zip(images, scenes, strict=False):
        expected = np.where(counts, code_srgb(np.clip(np.asarray(linear), 0, 1)), 0)
        np.testing.assert_allclose(image[..., :3], expected, atol=0.6 / 255)


def test_verdict_parameters_and_settings_are_said(fit, text):
    words = " ".join(Page(text).words)
    assert fit.trust.verdict[1:] in words
    for name in ("picture 2, light 1", "sphere 2", "light_position", "0.56 0.21 0.14", "jax",
                 f"{WIDTH} x {HEIGHT}", "do not count"):  # fmt: skip
        assert name in words, name
    assert text.count("class='swatch'") == 2 * len(SPHERES)


def test_a_folder_holds_the_page_and_markdown(fit, text, tmp_path):
    files = fit.report(tmp_path / "new" / "report")
    assert [f.name for f in files] == ["comparison.png", "cost.png", "report.md", "report.html"]
    assert files[3].read_text(encoding="utf-8") == text
    markdown = files[2].read_text(encoding="utf-8")
    assert "| color | sphere 1 | 0.56 0.21 0.14 | 0.8 0.3 0.2 |" in markdown
    assert re.findall(r"\((\w+\.png)\)", markdown) == ["comparison.png", "cost.png"]


@pytest.mark.parametrize("name", ["fit.pdf", "file"])
def test_other_endings_are_refused(fit, tmp_path, name):
    (tmp_path / "file").touch()
    with pytest.raises(st.InputError, match=r"expected a name that ends in \.html, or a folder"):
        fit.report(tmp_path / name)
    assert [f.name for f in tmp_path.iterdir()] == ["file"]


def test_a_report_without_a_folder_is_refused_before_it_is_made(fit, tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        fit.report(tmp_path / "none" / "fit.html")


@pytest.mark.slow
def test_large_pictures_are_shown_smaller(tmp_path):
    scene = st.Scene(SPHERES, LIGHTS[0])
    target = st.render(scene, width=1700, height=900, bounces=0)
    fit = st.fit(scene, target, free=("kd",), bounces=0)
    text = fit.report(tmp_path / "fit.html")[0].read_text()
    assert Page(text).images[0].shape[:2] == (300, 566) and "means of boxes" in text
    assert len(text) < 3e6


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 360])
def test_the_slider_moves_in_a_browser(text, tmp_path, width):
    """Left of the slider is the target, right of it the fit: here white, so that they differ."""
    file = tmp_path / "fit.html"
    file.write_text(text, encoding="utf-8")
    with pages(width) as browser:
        browser.open(file)
        over = browser.page.locator(".over").first
        shown = []
        for at in (0, 100):
            over.locator("input").fill(str(at))
            clip = over.locator("img").nth(1).evaluate("e => getComputedStyle(e).clipPath")
            shown.append(clip)
        assert shown == ["inset(0px 0px 0px 0%)", "inset(0px 0px 0px 100%)"]
        assert browser.page.evaluate("document.documentElement.scrollWidth") <= width
