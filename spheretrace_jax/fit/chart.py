"""Positions of lights as points of projective space, in which infinity is a point like others.

A position p at the scene's scale, p = middle + size u/w, is the direction of (u, w) in four
dimensions: near the scene w is 1 and u is the position; far away u is the direction and w, the
inverse distance, which the picture determines ever less, goes to 0. Around the start p0 a solver
works on the tangent (gnomonic) plane of the sphere of these directions: three numbers of order one
wherever the light is. Two turn the light's direction and only the third changes w, so that w > 0 is
a bound on one number.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

# Lights as far as so many times the scene's size are at infinity, as far as a picture can tell.
_FARTHEST = 1e7


class Chart(eqx.Module):
    """Three numbers for a position, all 0 at the start."""

    middle: Float[Array, " 3"]
    size: Float[Array, ""]
    u: Float[Array, " 3"]  #: the start, u.u + w w = 1
    w: Float[Array, ""]
    axes: Float[Array, "3 3"]  #: unit vectors: two across u, and u's direction

    def position(self, y: Float[Array, " 3"]) -> Float[Array, " 3"]:
        """The position that three numbers stand for."""
        length = jnp.linalg.norm(self.u)
        along = self.axes[2]
        u = self.u + self.axes[0] * y[0] + self.axes[1] * y[1] - along * (self.w * y[2])
        w = jnp.maximum(self.w + length * y[2], 1 / _FARTHEST)
        return self.middle + u * (self.size / w)

    def least(self) -> Float[Array, " 3"]:
        """The least that the numbers may be: where the light is at infinity."""
        length = jnp.linalg.norm(self.u)
        farthest = (1 / _FARTHEST - self.w) / jnp.where(length > 0, length, 1)
        return jnp.asarray([-jnp.inf, -jnp.inf, 0], self.w.dtype) + jnp.zeros_like(self.u).at[
            2
        ].set(jnp.where(length > 0, farthest, -jnp.inf))


def chart_at(
    position: Float[Array, " 3"], middle: Float[Array, " 3"], size: Float[Array, ""]
) -> Chart:
    """The chart around a position. **Arguments:** `middle`, `size`: of the scene."""
    away = (position - middle) / size
    square = jnp.sum(away**2)
    w = 1 / jnp.sqrt(1 + square)
    u = away * w
    length = jnp.linalg.norm(u)
    some = length > 0
    along = jnp.where(some, u / jnp.where(some, length, 1), jnp.eye(3, dtype=u.dtype)[2])
    # the axis that is least along it, made perpendicular
    least = jnp.eye(3, dtype=u.dtype)[jnp.argmin(jnp.abs(along))]
    first = jnp.cross(along, least)
    first = first / jnp.linalg.norm(first)
    return Chart(middle, size, u, w, jnp.stack([first, jnp.cross(along, first), along]))
