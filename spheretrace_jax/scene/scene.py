"""`Scene`: spheres, lights, planes, textures, background and camera, as pytrees of arrays.

Every array is a leaf that can be differentiated. Fields that only select code (the texture numbers,
the antialias flag) are static. Leading axes: n spheres, m lights, p planes. Lengths are in the
file's units, angles in radians, colours linear RGB. The note "moves edges" marks parameters that
move silhouettes or shadow edges in the picture, where a point-sampled picture jumps.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..base.errors import InputError
from .arrays import check_shapes, converted, described, floats, is_traced, precision, with_one_dtype
from .camera import Camera
from .lights import Lights, check_directional
from .numbers import check_numbers
from .planes import BackPlane, Planes
from .spheres import Spheres, check_pic
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

        **Raises:** `InputError` for a texture number without a texture, for parts of other classes,
        and for a dtype that no scene may have.
        """
        self.spheres, self.lights = spheres, lights
        self.camera = Camera() if camera is None else camera
        self.planes = Planes() if planes is None else planes
        self.textures, self.background = tuple(textures), floats(background)[0]
        self.sky, self.back_plane = sky, back_plane
        self.antialias = antialias
        _check_parts(self)
        self.antialias = int(antialias)  # True and False are the same
        for name in ("lights", "camera", "planes", "textures", "background", "sky", "back_plane"):
            convert = lambda leaf: converted(leaf, spheres.radius.dtype)
            setattr(self, name, jax.tree.map(convert, getattr(self, name)))

    def __str__(self) -> str:
        """Returns a summary of at most ten lines; `repr` shows the whole pytree."""
        return summary(check_scene(self))

    def _repr_html_(self) -> str:
        """Returns a small picture beside a table, for notebooks."""
        from ..display.notebook import scene_html

        return scene_html(self)

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


def check_scene(scene: Any) -> Scene:
    """Checks a scene: `jax.tree.map`, `equinox.tree_at` and `replace` change one without a check.

    All that takes a scene from a user begins here. Classes, shapes and dtypes are looked at, which
    are known of traced numbers too, and numbers where these are known.

    **Returns:** the scene, with Python's numbers and NumPy's arrays as arrays of JAX.

    **Warns:** `SceneWarning`, once, for colours of objects out of 0..1.

    **Raises:** `InputError`, which names the field, what it must be, and what it is.
    """
    if not isinstance(scene, Scene):
        raise InputError(f"expected a Scene, as load_scene returns, got {described(scene)}")
    _check_parts(scene)
    arrays = check_shapes("", scene)
    for name, part, _ in _parts(scene):
        arrays |= check_shapes(f"{name}.", part)
    check_pic(scene.spheres)
    check_directional(scene.lights)
    for name, array in arrays.items():
        if name.endswith(".image") and 0 in array.shape:
            raise InputError(f"{name} must hold a pixel or more, got shape {array.shape}")
    scene = with_one_dtype(scene, arrays)
    check_numbers(arrays)
    return scene


def known_scene(scene: Any) -> Scene:
    """Checks a scene that is to be written. **Returns, raises:** as `check_scene`.

    **Raises:** `InputError` for numbers that are traced, too.
    """
    scene = check_scene(scene)
    if is_traced(scene):
        raise InputError("a scene that JAX traces has no numbers to write: write it outside of jit")
    return scene


def _check_parts(scene: Scene) -> None:
    """Checks the classes of a scene's parts, and its numbers that are static.

    **Raises:** `InputError` for other classes, and for numbers out of range.
    """
    if not isinstance(scene.textures, tuple | list):
        raise InputError(f"textures must be a tuple, got {described(scene.textures)}")
    for name, part, kind in _parts(scene):
        if not isinstance(part, kind):
            raise InputError(f"{name} must be of class {kind.__name__}, got {described(part)}")
    if scene.antialias not in (0, 1):
        raise InputError(f"antialias must be 0 or 1, got {scene.antialias!r}")
    pics, known = scene.spheres.pic, len(scene.textures)
    if wrong := set(pics) - set(range(known + 1)):
        i = next(i for i, pic in enumerate(pics) if pic in wrong)
        raise InputError(f"sphere {i + 1} has texture {pics[i]}, but there are {known} textures")


def _parts(scene: Scene) -> Iterator[tuple[str, Any, type]]:
    """Yields the names of a scene's parts, the parts, and the classes that these must be of."""
    yield "spheres", scene.spheres, Spheres
    yield "lights", scene.lights, Lights
    yield "camera", scene.camera, Camera
    yield "planes", scene.planes, Planes
    for k, texture in enumerate(scene.textures):
        yield f"textures[{k}]", texture, Texture
    if scene.sky is not None:
        yield "sky", scene.sky, Texture
    if scene.back_plane is not None:
        yield "back_plane", scene.back_plane, BackPlane
