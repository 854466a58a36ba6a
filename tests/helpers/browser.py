"""A headless browser that fails a test for errors in the console and for requests that leave."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest


@dataclass
class Browser:
    """A page of a browser, and what it said."""

    page: Any
    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def open(self, file: Path) -> None:
        """Opens a file."""
        self.page.goto(file.as_uri())


@contextmanager
def pages(width: int, height: int = 900, hosts: tuple[str, ...] = ()) -> Iterator[Browser]:
    """Opens Chromium, or skips the test where there is none.

    **Arguments:** `hosts`: what pages may ask, besides their own files.
    """
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("there is no Chromium on the path")
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=chromium, args=["--no-sandbox", "--disable-gpu"]
        )
        viewport = {"width": width, "height": height}
        opened = Browser(browser.new_page(viewport=viewport, bypass_csp=True))
        opened.page.on(
            "console", lambda m: opened.errors.append(m.text) if m.type == "error" else None
        )
        opened.page.on("pageerror", lambda error: opened.errors.append(str(error)))
        opened.page.on("request", lambda request: opened.requests.append(request.url))
        yield opened
        browser.close()
    assert not opened.errors, opened.errors
    own = ("file:", "data:", *(f"{scheme}://{host}" for host in hosts for scheme in ("http", "ws")))
    outside = [r for r in opened.requests if not r.startswith(own)]
    assert not outside, outside
