"""`Spheres`: where they are, and their materials."""

from collections.abc import Sequence

import equinox as eqx
from jaxtyping import Array, ArrayLike, Float

from .arrays import COEFFICIENTS, floats, material_rows, misshapen, number_rows, vectors


class Spheres(eqx.Module):
    """Spheres, n of them, as a struct of arrays: one row of 14 columns each in the scene file."""

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
        """Builds n spheres. **Arguments:** as the fields; one number or colour holds for all."""
        center, radius, kt, *material = floats(center, radius, kt, color, ka, kd, ks, exponent, kgr)
        self.center = vectors(center)
        n = self.center.shape[0]
        self.color, self.ka, self.kd, self.ks, self.exponent, self.kgr = material_rows(n, *material)
        self.radius, self.kt = number_rows(radius, n), number_rows(kt, n)
        self.pic = (pic,) * n if isinstance(pic, int) else tuple(int(k) for k in pic)

    def __check_init__(self):
        n = len(self.center)
        if self.center.shape != (n, 3) or self.color.shape != (n, 3):
            raise ValueError(
                "center and color of the spheres must have shape (n, 3), "
                f"got {self.center.shape} and {self.color.shape}"
            )
        for name, shape in misshapen(self, ("radius", *COEFFICIENTS, "kt"), (n,)):
            raise ValueError(f"{name} must have shape ({n},) as there are {n} spheres, got {shape}")
        if len(self.pic) != n:
            raise ValueError(
                f"pic must name a texture for each of {n} spheres, got {len(self.pic)}"
            )

    def __len__(self) -> int:
        return self.center.shape[0]
