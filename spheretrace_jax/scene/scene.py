"""`Scene`: spheres, lights, planes, textures, background and camera, as pytrees of arrays.

Every array is a leaf that can be differentiated. Fields that only select code (the texture numbers,
the antialias flag) are static. Leading axes: n spheres, m lights, p planes. Lengths are in the
file's units, angles in radians, colours linear RGB. The note "moves edges" marks parameters that
move silhouettes or shadow edges in the picture, where a point-sampled picture jumps.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .arrays import converted, floats, precision
from .camera import Camera
from .lights import Lights
from .planes import BackPlane, Planes
from .spheres import Spheres
from .summary import summary
from .texture import Texture


class Scene(eqx.Module):
    """A world of spheres, its lights, and the camera that looks at it.

    All arrays are float32 or all float64. Whole numbers are converted. Half precision, which ends
    at 65504 and keeps three digits, is refused in all parts of a scene, and so are bool and complex
    arrays.
    """

    spheres: Spheres
    lights: Lights
    camera: Camera
    planes: Planes
    textures: tuple[Texture, ...]
    background: Float[Array, " 3"]  #: colour seen by rays that meet nothing; differentiable
    sky: Texture | None  #: a bitmap around the scene, in place of the background colour
    back_plane: BackPlane | None
    antialias: int = eqx.field(static=True)  #: 1: covered edges (pixels are areas); 0: single rays

    def __init__(
        self,
        spheres: Spheres,
        lights: Lights,
        camera: Camera | None = None,
        planes: Planes | None = None,
        textures: Sequence[Texture] = (),
        background: ArrayLike | Sequence = (0.0, 0.0, 0.0),
        sky: Texture | None = None,
        back_plane: BackPlane | None = None,
        antialias: int = 0,
    ):
        """Builds a scene. **Arguments:** as the fields, converted to the dtype of `spheres`.

        **Raises:** `ValueError` for a texture number without a texture. `InputError`, a
        `ValueError` too, for a dtype that no scene may have.
        """
        fields = (
            lights,
            Camera() if camera is None else camera,
            Planes() if planes is None else planes,
            tuple(textures),
            floats(background)[0],
            sky,
            back_plane,
        )
        fields = jax.tree.map(lambda leaf: converted(leaf, spheres.radius.dtype), fields)
        self.spheres = spheres
        (
            self.lights,
            self.camera,
            self.planes,
            self.textures,
            self.background,
            self.sky,
            self.back_plane,
        ) = fields
        self.antialias = int(antialias)

    def __check_init__(self):
        for i, pic in enumerate(self.spheres.pic):
            if not 0 <= pic <= len(self.textures):
                raise ValueError(
                    f"sphere {i + 1} has texture {pic}, but there are {len(self.textures)} textures"
                )

    def __str__(self) -> str:
        """Returns a summary of at most ten lines; `repr` shows the whole pytree."""
        return summary(self)

    @property
    def dtype(self) -> np.dtype:
        """Returns the floating dtype of the scene, which is that of its pictures."""
        return np.dtype(self.spheres.radius.dtype)

    @property
    def objects(self) -> int:
        """Counts the objects that a ray can meet: spheres, planes and the back plane."""
        return len(self.spheres) + len(self.planes) + (self.back_plane is not None)

    def with_antialias(self, antialias: int) -> "Scene":
        """Returns the scene with another antialias flag."""
        fields: dict[str, Any] = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        fields["antialias"] = antialias
        return Scene(**fields)

    def astype(self, dtype: Any) -> "Scene":
        """Converts the scene to float32 or float64. **Raises:** `InputError` for other dtypes."""
        chosen = precision(dtype)
        return jax.tree.map(lambda leaf: converted(leaf, chosen), self)

    def check_dtype(self) -> None:
        """Checks the dtype of all arrays, which `jax.tree.map` and `eqx.tree_at` can replace.

        **Raises:** `InputError` for a dtype that no scene may have.
        """
        for leaf in jax.tree.leaves(self):
            precision(leaf.dtype)
