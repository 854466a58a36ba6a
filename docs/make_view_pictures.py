"""Records the window of `spheretrace view` while a fit runs: docs/view.webp and docs/view.png.

Needs Chromium on the path, and the extras `view` and `docs`.

python docs/make_view_pictures.py
"""

import io
import sys
import tempfile
from pathlib import Path

from PIL import Image

import spheretrace_jax as st

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from helpers.browser import pages  # noqa: E402
from helpers.window import window  # noqa: E402

SIZE = (1060, 600)


def main() -> None:
    """Fits nine spheres from grey ones to their picture, and takes a picture of each step."""
    truth = st.load_scene(ROOT / "data" / "nine_spheres.txt")
    start = st.replace(truth, {"color": (0.4, 0.4, 0.5), "light_position": (700.0, 0.0, 500.0)})
    frames: list[Image.Image] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        st.save_scene(folder / "grey.txt", start)
        st.write_image(folder / "photo.exr", st.render(truth, width=480, height=480, bounces=5))
        command = ("grey.txt", "--target", "photo.exr")
        with window(folder, *command) as address, pages(*SIZE, hosts=("127.0.0.1",)) as browser:
            page = browser.page
            page.set_default_timeout(120_000)
            page.goto(address)
            page.wait_for_selector("#picture[data-frame]")
            page.set_viewport_size({"width": SIZE[0], "height": SIZE[1]})
            frames.append(shot(page))
            page.click("#fit")
            said = ""
            while not said.startswith("conv"):
                page.wait_for_timeout(60)
                now = page.inner_text("#fitted")
                if now != said and not now.startswith("compiling"):
                    page.wait_for_timeout(150)  # the frame comes after its words
                    frames.append(shot(page))
                said = now
    frames = frames[:1] + frames[1:-1][-5:] + frames[-1:]
    first, *others = frames
    pauses = [1500] + [600] * (len(frames) - 2) + [3000]
    first.save(
        ROOT / "docs" / "view.webp", save_all=True, append_images=others, duration=pauses, loop=0,
        quality=60,
    )  # fmt: skip
    frames[-1].save(ROOT / "docs" / "view.png", optimize=True)
    print(f"{len(frames)} pictures of the window")


def shot(page) -> Image.Image:
    """Takes a picture of the window."""
    return Image.open(io.BytesIO(page.screenshot())).convert("RGB")


if __name__ == "__main__":
    main()
