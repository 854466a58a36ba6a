"""Pixels of which a part may lie in shadow."""

import equinox as eqx
import jax.numpy as jnp

from ..base.types import PixelArray
from ..base.vec import Vec, norm
from .differential import Differential


class ShadowedPixel(eqx.Module):
    """The visible part of a surface in pixels, and the light whose shadows are looked for."""

    point: Differential[Vec]  #: the surface at the middle of what is visible, with derivatives
    middle: tuple[PixelArray, PixelArray]  #: that middle, pixels right and down of the centre
    light: Vec
    light_distance: PixelArray  #: from the point to the light
    footprint: PixelArray  #: how far the surface point moves in the pixel at most

    def extent(self, dx: Vec, dy: Vec) -> PixelArray:
        """Returns how far a vector varies at most between the middle and the pixel's corners.

        **Arguments:** `dx`, `dy`: the vector's derivatives by the position in pixels.
        """
        across, down = self.spans
        return norm(dx) * across + norm(dy) * down

    @property
    def spans(self) -> tuple[PixelArray, PixelArray]:
        """Returns the largest distances, across and down, from the middle to the pixel's border."""
        return 0.5 + jnp.abs(self.middle[0]), 0.5 + jnp.abs(self.middle[1])
