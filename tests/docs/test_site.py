"""The site is built, and every page is opened in a browser; what pages tell to run is run."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.browser import pages
from helpers.commands import python

ROOT = Path(__file__).parents[2]

#: For each page: its scripts, in their order. `start.md` tells how to name them.
SCRIPTS = {"start.md": ["draw.py", "invert.py", "photo.py"], "howto/caches.md": ["caches.py"]}


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """Builds the site with its notebooks, warnings as errors."""
    pytest.importorskip("mkdocs", reason="MkDocs is not installed: pip install '.[docs]'")
    folder = tmp_path_factory.mktemp("site")
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 360])
def test_every_page_in_a_browser(site, width):
    """No page says an error, asks for anything outside its folder, or is wider than the window."""
    opened = sorted(site.rglob("*.html"))
    assert len(opened) > 30
    wide = {}
    with pages(width) as browser:
        for page in opened:
            browser.open(page)
            browser.page.wait_for_load_state("networkidle")
            assert not browser.errors, (page, browser.errors)
            size = "[document.documentElement.scrollWidth, document.documentElement.clientWidth]"
            whole, seen = browser.page.evaluate(size)
            if whole > seen:
                wide[page.relative_to(site).as_posix()] = whole
            broken = "[...document.images].filter(i => !i.complete || !i.naturalWidth).length"
            assert browser.page.evaluate(broken) == 0, page
    outside = [r for r in browser.requests if not r.startswith((site.as_uri(), "data:", "blob:"))]
    assert not outside and not wide, (outside, wide)


@pytest.mark.slow
def test_search_without_a_server(site):
    with pages(1280) as browser:
        browser.open(site / "index.html")
        browser.page.fill("input[name=query]", "saturated")
        browser.page.wait_for_selector(".md-search-result__item", timeout=20_000)


@pytest.mark.slow
@pytest.mark.parametrize("page", SCRIPTS)
def test_what_pages_tell_to_run(page, tmp_path):
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / page).read_text(), re.DOTALL)
    scripts = dict(zip(SCRIPTS[page], blocks, strict=True) if len(SCRIPTS[page]) > 1 else [])
    scripts = scripts or {SCRIPTS[page][0]: "\n".join(blocks)}
    shutil.copy(ROOT / "data" / "ball" / "above.jpg", tmp_path / "photo.jpg")
    for name, code in scripts.items():
        # the photograph at hand is a crop: its focal length is 420 pixels, which are 94.5 mm
        (tmp_path / name).write_text(code.replace("focal = 28 / 36", "focal = 94.5 / 36"))
        done = python(name, folder=tmp_path, cache=tmp_path / "cache")
        assert done.returncode == 0, done.stdout + done.stderr
        assert "NOT" not in done.stdout and "not to be used" not in done.stdout, done.stdout
    made = {"picture.png", "found.txt", "fit.html", "photo.html"} if page == "start.md" else set()
    assert made <= {p.name for p in tmp_path.iterdir()}
