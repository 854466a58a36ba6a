"""The command `spheretrace view`: a window to look at a scene, change it and watch a fit."""

import asyncio
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import FlagCreatePairsOff, arg

from ..base.errors import InputError
from .arguments import Compiling, SceneFile, Sized
from .standard_streams import STANDARD, read_scene


@dataclass(kw_only=True)
class ViewCommand(Sized, Compiling):
    """Look at a scene in a window of the browser, change it, and watch a fit step by step.

    Drag to orbit, scroll to zoom, drag the lights, move sliders. Shows the picture, its derivative
    by any number, or the residual of a target. The page is served to this machine only, and ends
    with the command (Ctrl-C). Needs the extra `view`.
    """

    scene: SceneFile
    target: Annotated[
        Path | None, arg(metavar="PICTURE", help="a picture to compare with and to fit to")
    ] = None
    port: Annotated[int, arg(metavar="N", help="of the page, 0 for any")] = 0
    no_browser: Annotated[
        bool, FlagCreatePairsOff, arg(help="print the address, open no browser")
    ] = False

    def run(self) -> int:
        """Serves the window until it is interrupted."""
        try:
            from ..display.view.server import Window, serve
        except ModuleNotFoundError as error:
            if error.name != "aiohttp":
                raise
            raise InputError(
                "the window needs the extra view: pip install 'spheretrace_jax[view]'"
            ) from None
        import webbrowser

        from ..display.view.session import Session

        if not 0 <= self.port < 1 << 16:
            raise InputError(f"--port must be in 0..65535, got {self.port}")
        scene, size, target = self._what()
        name = "scene.txt" if self.scene == STANDARD else self.scene.name
        folder = Path() if self.scene == STANDARD else self.scene.parent
        window = Window(Session(scene, size, target), _free_name(folder / name), {})

        def ready(address: str) -> None:
            print(f"{self.scene}: {address} (Ctrl-C ends it)", flush=True)
            if not self.no_browser:
                webbrowser.open(address)

        try:
            asyncio.run(serve(window, self.port, ready))
        except KeyboardInterrupt:
            print()
        return 130  # the program then ends at once, also while something compiles

    def _what(self):
        """Reads the scene and the target. **Returns:** scene, size and target."""
        import numpy as np

        from .. import read_image

        size = self.width_height
        scene = read_scene(self.scene, "float32")
        if self.target is None:
            return scene, (size["width"], size["height"]), None
        target = np.asarray(read_image(self.target), np.float32)
        if self.size != Sized.size and target.shape[:2] != (size["height"], size["width"]):
            shape = f"{target.shape[1]}x{target.shape[0]}"
            raise InputError(f"--size must be that of the target, {shape}, got {self.size}")
        return scene, target.shape[1::-1], target


def _free_name(file: Path) -> Path:
    """Returns a name of no file: that of a scene, with `_edited` and a number."""
    names = (
        file.with_name(f"{file.stem}_edited{k if k > 1 else ''}.txt") for k in range(1, 1_000_000)
    )
    return next(name for name in names if not name.exists())
