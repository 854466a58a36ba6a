"""The page of the window in a real browser: every control is moved, and pixels are compared."""

import json

import jax
import numpy as np
import pytest
from helpers.browser import pages
from helpers.window import window

import spheretrace_jax as st

pytest.importorskip("aiohttp", reason="the extra `view` is not installed")

SIZE = 64
TEXT = """0.5 1.1 500 800
0
1
100 200 900 1 1 1
2
-90 0 0 90 .8 .3 .2 .2 .6 .3 20 0 0 0
90 10 0 80 .2 .5 .9 .2 .6 .3 20 0 0 0
"""


class Controls:
    """The page's controls, each of which waits for the next frame."""

    def __init__(self, page):
        self.page = page

    def __getitem__(self, selector):
        return self.page.locator(selector)

    def after(self, action) -> None:
        """Acts, and waits until the frames that follow have come."""
        seen = self.frames
        action()
        self.page.wait_for_selector(f"#picture[data-frame]:not([data-frame='{seen}'])")
        while (now := self.frames) != seen:  # a drag's last frame is drawn once more
            seen = now
            self.page.wait_for_timeout(600)

    @property
    def frames(self) -> str | None:
        return self["#picture"].get_attribute("data-frame")

    @property
    def pixels(self) -> np.ndarray:
        """Returns what the canvas shows."""
        script = "c => Array.from(c.getContext('2d').getImageData(0, 0, c.width, c.height).data)"
        return np.array(self["#picture"].evaluate(script), np.uint8).reshape(SIZE, SIZE, 4)

    def number(self, label: str) -> float:
        return float(self[f"input[aria-label='{label}']"].input_value())

    def drag(self, selector: str, x: float, y: float) -> None:
        """Drags an element by x and y pixels from its middle."""
        box = self[selector].bounding_box()
        at = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        mouse = self.page.mouse
        mouse.move(*at)
        mouse.down()
        for k in (1, 2, 3):
            mouse.move(at[0] + x * k / 3, at[1] + y * k / 3)
        mouse.up()


def saved(folder, controls, name: str) -> st.Scene:
    """Saves the scene that the page shows, and reads it."""
    controls["#path"].fill(name)
    controls.after(controls["#save"].click)
    assert controls["#message"].inner_text() == f"saved {name}"
    return st.load_scene(folder / name, np.float32)


def same(controls, scene: st.Scene, bounces: int) -> None:
    """Compares the page's pixels with the picture of a scene."""
    with jax.enable_x64(False), jax.numpy_dtype_promotion("standard"):
        picture = st.render(scene, width=SIZE, height=SIZE, bounces=bounces)
    expected = np.round(st.to_srgb(picture) * 255)
    off = np.abs(controls.pixels[..., :3] - expected)
    # other programs for the same picture round differently; one ray may hit another object
    assert (off > 1).mean() < 2e-3, (off > 1).mean()


@pytest.mark.slow
def test_every_control_moves_the_picture(tmp_path):
    (tmp_path / "scene.txt").write_text(TEXT)
    scene = st.load_scene(tmp_path / "scene.txt", np.float32)
    with jax.enable_x64(False), jax.numpy_dtype_promotion("standard"):
        target = st.render(st.replace(scene, {"kd": 0.4}), width=SIZE, height=SIZE)
    st.write_image(tmp_path / "target.exr", target)
    words = ("scene.txt", "--target", "target.exr")
    with window(tmp_path, *words) as address, pages(1280, hosts=("127.0.0.1",)) as browser:
        page, controls = browser.page, Controls(browser.page)
        page.set_default_timeout(120_000)
        page.goto(address)
        page.wait_for_selector("#picture[data-frame]")
        same(controls, scene, 5)

        # mouse, wheel and keys
        controls.after(lambda: controls.drag("#picture", 20, -10))
        assert controls.number("theta") != 0.5 and controls.number("phi") > 1.1
        controls.after(lambda: page.mouse.wheel(0, 100))
        assert controls.number("mu") > 500
        before = controls.number("theta")
        controls.after(lambda: controls["#stage"].press("ArrowLeft"))
        assert controls.number("theta") == pytest.approx(before + 0.05, abs=1e-4)
        mu = controls.number("mu")
        controls.after(lambda: controls["#stage"].press("+"))
        assert controls.number("mu") < mu
        controls.after(lambda: controls.drag("#handles circle", 6, 4))
        same(controls, saved(tmp_path, controls, "dragged.txt"), 5)
        light = np.asarray(st.load_scene(tmp_path / "dragged.txt", np.float32).lights.position)
        assert (light != np.asarray(scene.lights.position)).any()

        # a click chooses a sphere
        controls["#sphere"].select_option("0")
        objects = np.asarray(
            st.render_layers(
                st.load_scene(tmp_path / "dragged.txt", np.float32), width=SIZE, height=SIZE
            ).object
        )
        row, column = np.argwhere(objects == 1).mean(axis=0).astype(int)
        click = {"x": int(column), "y": int(row)}
        controls.after(lambda: controls["#picture"].click(position=click))
        assert controls["#sphere"].input_value() == "1"

        # every slider and its number
        names = set()
        for slider in page.query_selector_all(".slider input[type=range]"):
            label = slider.evaluate("e => e.parentNode.textContent")
            low, high = (float(slider.get_attribute(k)) for k in ("min", "max"))
            value = 0.7 * low + 0.3 * high
            controls.after(lambda slider=slider, value=value: slider.fill(str(value)))
            assert controls.number(label) == pytest.approx(value, rel=1e-4, abs=1e-6), label
            names.add(label)
        assert len(names) == 5 + 14 + 6
        controls.after(lambda: controls["input[aria-label='exponent']"].fill("12"))
        controls.after(lambda: controls["input[aria-label='exponent']"].blur())
        same(controls, saved(tmp_path, controls, "slid.txt"), 5)

        # antialias, bounces, undo
        controls.after(controls["#antialias"].click)
        controls["#bounces"].fill("0")
        controls.after(controls["#bounces"].blur)
        found = saved(tmp_path, controls, "smooth.txt")
        assert found.antialias == 1
        same(controls, found, 0)
        controls.after(controls["#antialias"].click)
        while controls["#undo"].is_enabled():
            controls.after(controls["#undo"].click)
        assert controls.number("theta") == 0.5

        # the derivative, the residual, a fit
        controls.after(lambda: controls["#kind"].select_option("derivative"))
        controls.after(lambda: controls["#parameter"].select_option("kd:0"))
        assert float(controls["#scale"].get_attribute("data-most")) > 0.1
        controls.after(lambda: controls["#kind"].select_option("residual"))
        assert float(controls["#scale"].get_attribute("data-most")) > 0.01
        controls["#fit"].click()
        page.wait_for_function("document.getElementById('fitted').textContent.startsWith('conv')")
        assert float(controls["#scale"].get_attribute("data-most")) < 1e-3
        controls["#stop"].click()

        # a mistake, and a narrow window
        controls["#path"].fill("smooth.txt")
        controls.after(controls["#save"].click)
        assert "exists" in controls["#message"].inner_text()
        page.set_viewport_size({"width": 360, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth") <= 360
        assert json.dumps(sorted(f.name for f in tmp_path.glob("*.txt"))) == json.dumps(
            ["dragged.txt", "scene.txt", "slid.txt", "smooth.txt"]
        )
