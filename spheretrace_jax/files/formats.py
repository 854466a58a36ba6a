"""Scene formats: for each ending, the function that reads it, or that writes it.

A new format is a module in this folder, with a reader or a writer, and an entry in a table here.
(Formats of pictures are in `picture_formats`.)
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..scene.scene import Scene
from .povray import write_povray
from .scene_text import load_scene


@dataclass(frozen=True)
class ExportFormat:
    """A format of another program, which draws the same picture."""

    write: Callable[..., None]  #: called as `write_povray`
    usage: str  #: the command that draws the written `{file}`


#: The readers by ending, called as `load_scene`. Other files are read as the lecture's scene text.
READERS: dict[str, Callable[..., Scene]] = {".txt": load_scene}

#: The formats that scenes are converted to, by ending.
EXPORT_FORMATS = {
    ".pov": ExportFormat(write_povray, "povray +W512 +H512 -A +FN16 File_Gamma=1 {file}"),
}


def read_scene(path: str | os.PathLike[str], dtype: Any = None) -> Scene:
    """Reads a scene file of any format. **Arguments, raises:** as `load_scene`."""
    return READERS.get(Path(path).suffix.lower(), load_scene)(path, dtype)
