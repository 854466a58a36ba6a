"""What a scene is: spheres, lights, planes, textures, background and camera, as pytrees of arrays.

Every array is a leaf that can be differentiated; what only selects code (the texture numbers, the
antialias flag) is static. Leading axes: n spheres, m lights, p planes. Lengths are in the file's
units, angles in radians, colours linear RGB. Gradient notes: "edges" marks the parameters whose
change moves silhouettes or shadow edges in the picture, where a point-sampled picture jumps.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..base.errors import InputError
from ..base.types import Scalar


def precision(dtype: Any) -> np.dtype:
    """A scene's dtype. **Raises:** `InputError` if it is neither float32 nor float64."""
    if np.dtype(dtype) not in (np.float32, np.float64):
        raise InputError(f"a scene's dtype must be float32 or float64, got {np.dtype(dtype)}")
    return np.dtype(dtype)


def _floats(*values: Any) -> list[Array]:
    """The values as arrays of one floating dtype.

    Python numbers, lists and arrays of whole numbers follow the floating arrays beside them; where
    there are none, all take JAX's default dtype.

    **Raises:** `InputError` for arrays of other dtypes.
    """
    typed = {v.dtype for v in values if isinstance(v, jax.Array | np.ndarray)}
    typed = {precision(t) for t in typed if not jnp.issubdtype(t, jnp.integer)}
    dtype = jax.dtypes.canonicalize_dtype(np.result_type(*typed) if typed else float)
    return [jnp.asarray(v, dtype) for v in values]


def _wide(value: Array, rows: int) -> Array:
    """One number per row: a single number holds for all of them."""
    return jnp.broadcast_to(value, (rows,)) if value.ndim == 0 else value


class Spheres(eqx.Module):
    """n spheres as a struct of arrays: one row of 14 columns each in the scene file."""

    center: Float[Array, "n 3"]  #: world coordinates; differentiable, moves edges
    radius: Float[Array, " n"]  #: > 0, world units; differentiable, moves edges
    color: Float[Array, "n 3"]  #: the lecture's S_R, S_G, S_B in 0..1; differentiable
    ka: Float[Array, " n"]  #: ambient coefficient in 0..1; differentiable
    kd: Float[Array, " n"]  #: diffuse coefficient in 0..1; differentiable
    ks: Float[Array, " n"]  #: highlight coefficient in 0..1; differentiable
    exponent: Float[Array, " n"]  #: highlight exponent, >= 0; differentiable
    kgr: Float[Array, " n"]  #: global reflection in 0..1; differentiable
    kt: Float[Array, " n"]  #: straight-through transmission in 0..1; differentiable
    pic: tuple[int, ...] = eqx.field(static=True)  #: texture number from 1, 0 for none

    def __init__(
        self,
        center: ArrayLike | Sequence,
        radius: ArrayLike | Sequence,
        color: ArrayLike | Sequence = (0.5, 0.5, 0.5),
        ka: ArrayLike | Sequence = 0.2,
        kd: ArrayLike | Sequence = 0.8,
        ks: ArrayLike | Sequence = 0.0,
        exponent: ArrayLike | Sequence = 20.0,
        kgr: ArrayLike | Sequence = 0.0,
        kt: ArrayLike | Sequence = 0.0,
        pic: Sequence[int] | int = 0,
    ):
        """**Arguments:** as the fields; a single number or colour holds for all n spheres."""
        c, r, s, *rest = _floats(center, radius, color, ka, kd, ks, exponent, kgr, kt)
        self.center = c.reshape(-1, 3) if c.size == 0 else c
        n = self.center.shape[0]
        self.color = jnp.broadcast_to(s, (n, 3)) if s.ndim == 1 else s
        self.radius = _wide(r, n)
        self.ka, self.kd, self.ks, self.exponent, self.kgr, self.kt = (_wide(x, n) for x in rest)
        self.pic = (pic,) * n if isinstance(pic, int) else tuple(int(k) for k in pic)

    def __check_init__(self):
        n = len(self.center)
        if self.center.shape != (n, 3) or self.color.shape != (n, 3):
            raise ValueError(
                "center and color of the spheres must have shape (n, 3), "
                f"got {self.center.shape} and {self.color.shape}"
            )
        for name in ("radius", "ka", "kd", "ks", "exponent", "kgr", "kt"):
            if getattr(self, name).shape != (n,):
                shape = getattr(self, name).shape
                raise ValueError(
                    f"{name} must have shape ({n},) as there are {n} spheres, got {shape}"
                )
        if len(self.pic) != n:
            raise ValueError(
                f"pic must name a texture for each of {n} spheres, got {len(self.pic)}"
            )

    def __len__(self) -> int:
        return self.center.shape[0]


class Lights(eqx.Module):
    """m point lights without fall-off."""

    position: Float[Array, "m 3"]  #: world coordinates; differentiable, moves shadow edges
    color: Float[Array, "m 3"]  #: white is 1, 1, 1; differentiable

    def __init__(
        self, position: ArrayLike | Sequence, color: ArrayLike | Sequence = (1.0, 1.0, 1.0)
    ):
        position, color = _floats(position, color)
        self.position = position.reshape(-1, 3) if position.size == 0 else position
        m = self.position.shape[0]
        self.color = jnp.broadcast_to(color, (m, 3)) if color.ndim == 1 else color

    def __check_init__(self):
        m = len(self.position)
        if self.position.shape != (m, 3) or self.color.shape != (m, 3):
            raise ValueError(
                "position and color of the lights must have shape (m, 3), "
                f"got {self.position.shape} and {self.color.shape}"
            )

    def __len__(self) -> int:
        return self.position.shape[0]


class Planes(eqx.Module):
    """p infinite planes, seen from both sides, plain or with a two-colour checker.

    The squares of a checker have the side `checker_size`; a corner of one lies at `point`. Their
    sides run along the world's x axis laid into the plane (y, where the normal is nearest to x).
    """

    point: Float[Array, "p 3"]  #: any point of the plane; differentiable, moves edges
    normal: Float[Array, "p 3"]  #: of any length but 0; differentiable, moves edges
    color: Float[Array, "p 3"]
    ka: Float[Array, " p"]
    kd: Float[Array, " p"]
    ks: Float[Array, " p"]
    exponent: Float[Array, " p"]
    kgr: Float[Array, " p"]
    checker_color: Float[Array, "p 3"]  #: the colour of every other square
    checker_size: Float[Array, " p"]  #: the side of a square, world units; 0 for a plain plane

    def __init__(
        self,
        point: ArrayLike | Sequence = (),
        normal: ArrayLike | Sequence = (),
        color: ArrayLike | Sequence = (0.5, 0.5, 0.5),
        ka: ArrayLike | Sequence = 0.2,
        kd: ArrayLike | Sequence = 0.8,
        ks: ArrayLike | Sequence = 0.0,
        exponent: ArrayLike | Sequence = 20.0,
        kgr: ArrayLike | Sequence = 0.0,
        checker_color: ArrayLike | Sequence = (0.0, 0.0, 0.0),
        checker_size: ArrayLike | Sequence = 0.0,
    ):
        """**Arguments:** as the fields; a single number or colour holds for all p planes."""
        p0, n0, s0, c0, *rest = _floats(
            point, normal, color, checker_color, ka, kd, ks, exponent, kgr, checker_size
        )
        self.point = p0.reshape(-1, 3) if p0.size == 0 else p0
        self.normal = n0.reshape(-1, 3) if n0.size == 0 else n0
        p = self.point.shape[0]
        self.color = jnp.broadcast_to(s0, (p, 3)) if s0.ndim == 1 else s0
        self.checker_color = jnp.broadcast_to(c0, (p, 3)) if c0.ndim == 1 else c0
        self.ka, self.kd, self.ks, self.exponent, self.kgr, self.checker_size = (
            _wide(x, p) for x in rest
        )

    def __check_init__(self):
        p = len(self.point)
        for name in ("point", "normal", "color", "checker_color"):
            if getattr(self, name).shape != (p, 3):
                shape = getattr(self, name).shape
                raise ValueError(f"{name} of the planes must have shape ({p}, 3), got {shape}")
        for name in ("ka", "kd", "ks", "exponent", "kgr", "checker_size"):
            if getattr(self, name).shape != (p,):
                shape = getattr(self, name).shape
                raise ValueError(f"{name} of the planes must have shape ({p},), got {shape}")

    def __len__(self) -> int:
        return self.point.shape[0]


class BackPlane(eqx.Module):
    """The view plane made visible: it lies `distance` before the eye, across the view."""

    color: Float[Array, " 3"]
    ka: Scalar
    kd: Scalar

    def __init__(self, color: ArrayLike | Sequence, ka: ArrayLike = 0.2, kd: ArrayLike = 0.8):
        self.color, self.ka, self.kd = _floats(color, ka, kd)


class Texture(eqx.Module):
    """A bitmap that wraps a sphere, or the sky: linear RGB, row 0 at the north pole (+z)."""

    image: Float[Array, "rows columns 3"]  #: differentiable
    file: str = eqx.field(static=True)  #: where it was read from; "" if it is in no file

    def __init__(self, image: ArrayLike, file: str = ""):
        (self.image,) = _floats(image)
        self.file = file


class Camera(eqx.Module):
    """The lecture's view: the eye on a sphere around the origin, looking at the origin."""

    theta: Scalar  #: azimuth of the eye, radians; differentiable, moves edges
    phi: Scalar  #: polar angle of the eye from +z, radians; differentiable, moves edges
    mu: Scalar  #: from the origin to the eye, world units; differentiable, moves edges
    distance: Scalar  #: from the eye to the view plane, world units; differentiable, moves edges
    window: Scalar  #: height of the window on the view plane, world units; differentiable

    def __init__(
        self,
        theta: ArrayLike = 0.0,
        phi: ArrayLike = 0.0,
        mu: ArrayLike = 500.0,
        distance: ArrayLike = 800.0,
        window: ArrayLike = 512.0,
    ):
        self.theta, self.phi, self.mu, self.distance, self.window = _floats(
            theta, phi, mu, distance, window
        )


class Scene(eqx.Module):
    """A world of spheres, and who looks at it.

    All arrays are float32 or all float64. Whole numbers are converted; half precision, which ends
    at 65504 and keeps three digits, is refused in all parts of a scene, as are bool and complex
    arrays.
    """

    spheres: Spheres
    lights: Lights
    camera: Camera
    planes: Planes
    textures: tuple[Texture, ...]
    background: Float[Array, " 3"]  #: what a ray that leaves the world sees; differentiable
    sky: Texture | None  #: a picture all around, in place of the background colour
    back_plane: BackPlane | None
    antialias: int = eqx.field(static=True)  #: 1: pixels are areas, their edges covered; 0: rays

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
        """**Arguments:** as the fields. Everything is brought to the floating dtype of `spheres`.

        **Raises:** `ValueError` for a texture number without a texture; `InputError`, which is one,
        for a dtype that no scene may have.
        """
        parts = (
            lights,
            Camera() if camera is None else camera,
            Planes() if planes is None else planes,
            tuple(textures),
            _floats(background)[0],
            sky,
            back_plane,
        )
        parts = jax.tree.map(lambda leaf: leaf.astype(spheres.radius.dtype), parts)
        self.spheres = spheres
        (
            self.lights,
            self.camera,
            self.planes,
            self.textures,
            self.background,
            self.sky,
            self.back_plane,
        ) = parts
        self.antialias = int(antialias)

    def __check_init__(self):
        for i, pic in enumerate(self.spheres.pic):
            if not 0 <= pic <= len(self.textures):
                raise ValueError(
                    f"sphere {i + 1} has texture {pic}, but there are {len(self.textures)} textures"
                )

    @property
    def dtype(self) -> np.dtype:
        """The floating dtype of the scene, and so of its pictures."""
        return np.dtype(self.spheres.radius.dtype)

    @property
    def objects(self) -> int:
        """How many things a ray can meet: spheres, planes and the back plane."""
        return len(self.spheres) + len(self.planes) + (self.back_plane is not None)

    def with_antialias(self, antialias: int) -> "Scene":
        """The same scene with another antialias flag."""
        parts: dict[str, Any] = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        parts["antialias"] = antialias
        return Scene(**parts)

    def astype(self, dtype: Any) -> "Scene":
        """The same scene in float32 or float64. **Raises:** `InputError` for other dtypes."""
        chosen = precision(dtype)
        return jax.tree.map(lambda leaf: leaf.astype(chosen), self)

    def check_dtype(self) -> None:
        """**Raises:** `InputError` if arrays were given a dtype that no scene may have.

        For what is put in place of its arrays, by `jax.tree.map` or `eqx.tree_at`.
        """
        for leaf in jax.tree.leaves(self):
            precision(leaf.dtype)
