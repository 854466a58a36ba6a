"""Scene formats: for each, the functions that read and write it.

A new format is a module in this folder, with a reader or a writer, and an entry in the table here.
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
class SceneFormat:
    """A format of scene files."""

    read: Callable[..., Scene] | None = None  #: called as `load_scene`
    export: Callable[..., None] | None = None  #: called as `write_povray`
    usage: str = ""  #: the command that draws an exported `{file}`


#: The formats by ending. Files of other endings are read as the lecture's scene text.
SCENE_FORMATS = {
    ".txt": SceneFormat(read=load_scene),
    ".pov": SceneFormat(
        export=write_povray, usage="povray +W512 +H512 -A +FN16 File_Gamma=1 {file}"
    ),
}


def read_scene(path: str | os.PathLike, dtype: Any = None) -> Scene:
    """Reads a scene file of any format. **Arguments, raises:** as `load_scene`."""
    known = SCENE_FORMATS.get(Path(path).suffix.lower())
    read = load_scene if known is None or known.read is None else known.read
    return read(path, dtype)
