"""Scene formats: for each ending, the function that reads it, or that writes it.

A new format is a module in this folder, with a reader or a writer, and an entry in a table here.
(Formats of pictures are in `picture_formats`.)
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..base.types import Highlight
from ..scene.scene import Scene
from .mitsuba import write_mitsuba
from .nff import read_nff
from .povray import write_povray
from .povray_reader import read_povray
from .scene_text import load_scene_text
from .scene_writer import save_scene


@dataclass(frozen=True)
class ExportFormat:
    """A format that scenes are converted to, mostly one of another program."""

    write: Callable[..., None]  #: called as `write_povray`
    usage: str  #: the command that draws the written `{file}`


def _write_text(
    path: str | os.PathLike[str],
    scene: Scene,
    *,
    highlight: Highlight,
    bounces: int,
    scene_path: str | os.PathLike[str] | None = None,
) -> None:
    """Writes scene text, which holds neither highlight nor bounces."""
    save_scene(path, scene)


#: The readers by ending, called as `load_scene`. Other files are read as the lecture's scene text.
READERS: dict[str, Callable[..., Scene]] = {
    ".txt": load_scene_text,
    ".nff": read_nff,
    ".pov": read_povray,
}

#: The formats that scenes are converted to, by ending.
EXPORT_FORMATS = {
    ".pov": ExportFormat(write_povray, "povray +W512 +H512 -A +FN16 File_Gamma=1 {file}"),
    ".txt": ExportFormat(_write_text, "spheretrace render {file} -o picture.png"),
    ".xml": ExportFormat(write_mitsuba, "mitsuba -m scalar_rgb -D width=512 -D height=512 {file}"),
}


def load_scene(path: str | os.PathLike[str], dtype: Any = None) -> Scene:
    """Reads a scene file: NFF and POV-Ray's by their endings, all others as scene text.

    `spheretrace_jax.files.scene_text`, `nff` and `povray_reader` have the grammars.

    **Arguments:** `dtype`: float32 or float64, by default JAX's default floating dtype.

    **Raises:** `SceneError`, with `file:line:column: what was expected, what stands there`.

    **Warns:** `SceneWarning`, with `file:line`, of what a scene here cannot be, and what was done.
    """
    return READERS.get(Path(path).suffix.lower(), load_scene_text)(path, dtype)
