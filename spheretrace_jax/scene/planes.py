"""`Planes`: where they are, and their materials; `BackPlane`: the view plane made visible."""

from collections.abc import Sequence

import equinox as eqx
from jaxtyping import Array, ArrayLike, Float

from ..base.types import Scalar
from .arrays import (
    check_refraction,
    check_shapes,
    color_rows,
    floats,
    material_rows,
    number_rows,
    vectors,
)


class Planes(eqx.Module):
    """Infinite planes, p of them, seen from both sides, plain or with a two-colour checker.

    The squares of a checker have the side `checker_size`, and one of them has a corner at `point`.
    Their sides run along the world's x axis, projected onto the plane. (Along the y axis, where the
    normal is nearest to x.)
    """

    point: Float[Array, "p 3"]  #: any point of the plane; differentiable, moves edges
    normal: Float[Array, "p 3"]  #: of any length but 0; differentiable, moves edges
    color: Float[Array, "p 3"]
    ka: Float[Array, " p"]
    kd: Float[Array, " p"]
    ks: Float[Array, " p"]
    exponent: Float[Array, " p"]
    kgr: Float[Array, " p"]
    ior: Float[Array, " p"]  #: index of refraction of the coat, >= 1; 1 for none
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
        ior: ArrayLike | Sequence = 1.0,
    ):
        """Builds p planes. **Arguments:** as the fields; one number or colour holds for all.

        **Raises:** `InputError` for an index of refraction below 1.
        """
        point, normal, checker_color, checker_size, ior, *material = floats(
            point, normal, checker_color, checker_size, ior, color, ka, kd, ks, exponent, kgr
        )
        self.point, self.normal = vectors(point), vectors(normal)
        p = self.point.shape[0]
        self.color, self.ka, self.kd, self.ks, self.exponent, self.kgr = material_rows(p, *material)
        self.checker_color = color_rows(checker_color, p)
        self.checker_size, self.ior = number_rows(checker_size, p), number_rows(ior, p)

    def __check_init__(self):
        check_shapes("planes.", self)
        check_refraction("planes.", self.ior)

    def __len__(self) -> int:
        return self.point.shape[0]


class BackPlane(eqx.Module):
    """The view plane made visible, `distance` before the eye and across the view."""

    color: Float[Array, " 3"]
    ka: Scalar
    kd: Scalar

    def __init__(self, color: ArrayLike | Sequence, ka: ArrayLike = 0.2, kd: ArrayLike = 0.8):
        """Builds the back plane. **Arguments:** as the fields."""
        self.color, self.ka, self.kd = floats(color, ka, kd)
