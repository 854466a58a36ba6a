"""`Spheres`: where they are, and their materials."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..base.errors import InputError
from .arrays import check_refraction, check_shapes, floats, material_rows, number_rows, vectors


class Spheres(eqx.Module):
    """Spheres, n of them, as a struct of arrays: one row each of the scene file."""

    center: Float[Array, "n 3"]  #: world coordinates; differentiable, moves edges
    radius: Float[Array, " n"]  #: > 0, world units; differentiable, moves edges
    color: Float[Array, "n 3"]  #: the lecture's S_R, S_G, S_B in 0..1; differentiable
    ka: Float[Array, " n"]  #: ambient coefficient in 0..1; differentiable
    kd: Float[Array, " n"]  #: diffuse coefficient in 0..1; differentiable
    ks: Float[Array, " n"]  #: highlight coefficient in 0..1; differentiable
    exponent: Float[Array, " n"]  #: highlight exponent, >= 0; differentiable
    kgr: Float[Array, " n"]  #: global reflection in 0..1; differentiable
    kt: Float[Array, " n"]  #: straight-through transmission in 0..1; differentiable
    ior: Float[Array, " n"]  #: index of refraction of the coat, >= 1; 1 for none; differentiable
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
        pic: ArrayLike | Sequence = 0,
        ior: ArrayLike | Sequence = 1.0,
    ):
        """Builds n spheres. **Arguments:** as the fields; one number or colour holds for all.

        **Raises:** `InputError` for an index of refraction below 1.
        """
        center, radius, kt, ior, *material = floats(
            center, radius, kt, ior, color, ka, kd, ks, exponent, kgr
        )
        self.center = vectors(center)
        n = self.center.shape[0]
        self.color, self.ka, self.kd, self.ks, self.exponent, self.kgr = material_rows(n, *material)
        self.radius, self.kt, self.ior = (number_rows(x, n) for x in (radius, kt, ior))
        pics: Any = [pic] * n if np.ndim(pic) == 0 else pic
        self.pic = tuple(map(_whole_number, pics))

    def __check_init__(self):
        check_shapes("spheres.", self)
        check_pic(self)
        check_refraction("spheres.", self.ior)

    def __len__(self) -> int:
        return self.center.shape[0]


def check_pic(spheres: Spheres) -> None:
    """Checks the texture numbers. **Raises:** `InputError` for fewer or more than spheres."""
    if len(spheres.pic) != len(spheres):
        raise InputError(
            f"spheres.pic must name a texture for each of {len(spheres)} spheres, "
            f"got {len(spheres.pic)}"
        )


def _whole_number(pic: Any) -> int:
    """Returns a texture number. **Raises:** `InputError` for all but whole numbers."""
    try:
        number = int(pic)
    except (TypeError, ValueError):
        number = None
    if number is None or number != pic:
        raise InputError(f"spheres.pic must hold whole numbers, got {pic!r}")
    return number
