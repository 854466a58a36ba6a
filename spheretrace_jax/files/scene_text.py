"""Scene text: the lecture's scene file, read. (`scene_writer.py` writes it.)

The grammar, with `//` comments to the end of the line and any white space between words:

    theta phi mu distance                 view: radians and world units, mu >= 0, distance > 0
    antialias                             0 or 1
    numlights                             then as many lines:
      Lx Ly Lz [LR LG LB] [directional] [falloff DISTANCE]
                                            a light's position and colour, white by default;
                                            of a directional light the direction toward it;
                                            with a fall-off it has its colour at DISTANCE, and at
                                            r that times (DISTANCE / r)^2
    numspheres                            then as many lines:
      cx cy cz radius R G B ka kd ks specExp kgr kt pic [ior]

and, in any order, lines that start with a keyword:

    texture FILE                          a picture; `pic` 1, 2, ... name them in their order
    background R G B                      the colour seen by rays that meet nothing
    background_image FILE                 a picture around the scene in its place: the starry sky
    back_plane R G B ka kd                the view plane made visible
    plane px py pz nx ny nz R G B ka kd ks specExp kgr [ior N] [checker R G B size]
                                          a plane through p with normal n, any number of them
    window HEIGHT                         of the window on the view plane, 512 by default
    look_at X Y Z                         what the eye looks at and turns around, 0 0 0 by default
    roll ANGLE                            of the camera about its axis, radians, 0 by default
    principal_point X Y                   of the axis: right and down of the picture's centre, in
                                          heights of the picture, 0 0 by default
    pixel_aspect A                        width of a pixel / its height, 1 by default
    orthographic                          rays are parallel, the window is of the world's size

Colours and ka, kd, ks, kgr, kt are in 0..1 (a light's colour only >= 0), specExp and DISTANCE >= 0,
ior and N >= 1 (1 by default: no coat), radius, HEIGHT, A and size > 0, normals and directions not
0. A directional light has no fall-off, and DISTANCE 0 is none. FILE is relative to the scene file;
a name with spaces stands in double quotes. Every lecture file is valid: the first six numbers may
stand on one line or many, and each light and sphere has one line.
"""

import os
import warnings
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ..base.errors import InputError, PictureError, SceneWarning, printable
from ..scene.arrays import precision
from ..scene.camera import Camera
from ..scene.lights import Lights
from ..scene.planes import BackPlane, Planes
from ..scene.scene import Scene
from ..scene.spheres import Spheres
from ..scene.texture import Texture
from .scene_reader import SceneReader
from .tokens import Token, Tokens, decode, read_bytes


def load_scene_text(path: str | os.PathLike[str], dtype: Any = None) -> Scene:
    """Reads a file of scene text; see above for its grammar.

    **Arguments:** `dtype`: float32 or float64, by default JAX's default floating dtype.

    **Raises:** `SceneError`, with `file:line:column: what was expected, what stands there`.
    **Warns:** `SceneWarning` where ka + kd > 1, which the lecture rules out.
    """
    dtype = scene_dtype(dtype)
    return parse_scene(read_bytes(path), os.fspath(path), Path(path).parent, dtype)


def parse_scene(
    data: bytes, name: str, folder: str | os.PathLike[str] = ".", dtype: Any = None
) -> Scene:
    """Reads the content of a scene file.

    **Arguments:** `name`: of the file, for messages. `folder`: to which textures are relative.
    `dtype`, raises, warns: as `load_scene_text`.
    """
    dtype = scene_dtype(dtype)
    reader = SceneReader(name, decode(name, data), dtype).read()
    for message in reader.warnings:
        warnings.warn(message, SceneWarning, stacklevel=4)
    return _build(reader, Path(folder), dtype)


def scene_dtype(dtype: Any) -> np.dtype:
    """Returns a scene's dtype, by default JAX's. **Raises:** `InputError`."""
    default = jax.dtypes.canonicalize_dtype(float)
    chosen = precision(default if dtype is None else dtype)
    if chosen == np.float64 and default != np.float64:
        raise InputError(
            "a float64 scene needs 64-bit JAX: jax.config.update('jax_enable_x64', True)"
        )
    return chosen


def check_text(name: str, text: str, dtype: np.dtype) -> None:
    """Checks a scene's text, without its textures. **Raises:** `SceneError`."""
    SceneReader(name, text, dtype).read()


def _build(reader: SceneReader, folder: Path, dtype: np.dtype) -> Scene:
    """Builds the scene of the reader, and reads its textures from the files."""

    def table(rows: list[list[float]], columns: int) -> np.ndarray:
        return np.asarray(rows, dtype).reshape(len(rows), columns)

    spheres = table(reader.spheres, 14)
    lights = table([numbers for numbers, _ in reader.lights], 7)
    directional = [far for _, far in reader.lights]
    planes, back = table(reader.planes, 19), reader.back_plane
    pics = [pic for _, pic in reader.pics]
    texture = partial(texture_at, reader.tokens, folder)
    view = {n: x if x is True else np.asarray(x, dtype) for n, x in reader.camera.items()}
    return Scene(
        Spheres(
            spheres[:, :3],
            spheres[:, 3],
            spheres[:, 4:7],
            *spheres[:, 7:13].T,
            pic=pics,
            ior=spheres[:, 13],
        ),
        Lights(lights[:, :3], lights[:, 3:6], directional, lights[:, 6]),
        Camera(*(np.asarray(value, dtype) for value in (*reader.view, reader.window)), **view),
        Planes(
            planes[:, :3],
            planes[:, 3:6],
            planes[:, 6:9],
            *planes[:, 9:14].T,
            checker_color=planes[:, 14:17],
            checker_size=planes[:, 17],
            ior=planes[:, 18],
        ),
        textures=[texture(*file) for file in reader.files],
        background=np.asarray(reader.background, dtype),
        sky=None if reader.sky is None else texture(*reader.sky),
        back_plane=None
        if back is None
        else BackPlane(np.asarray(back[:3], dtype), *table([back], 5)[0, 3:]),
        antialias=reader.antialias,
    )


def texture_at(tokens: Tokens, folder: Path, token: Token, name: str) -> Texture:
    """Reads the texture that `token` names. **Raises:** `SceneError` at the token."""
    from .images import read_texture

    file = os.path.abspath(folder / name)
    try:
        image = read_texture(file)
        if not np.isfinite(image).all():
            raise PictureError("it holds numbers that are nan or inf")
        return Texture(image, file)
    except PictureError as error:
        reason = str(error).removeprefix(f"{file}: ")
        tokens.fail(token, f"expected a picture, got {printable(name)}: {reason}")
