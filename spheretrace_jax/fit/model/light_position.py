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
from jax import lax
from jaxtyping import Array, Float

# Lights as far as so many times the scene's size are at infinity, as far as a picture can tell.
_FARTHEST = 1e7

# Lights as near to the middle have no direction in which they could go to infinity.
_AT_MIDDLE = 1e-10


class LightPosition(eqx.Module):
    """Three numbers for a position, all 0 at the start."""

    middle: Float[Array, " 3"]
    size: Float[Array, ""]
    u: Float[Array, " 3"]  #: the start, u.u + w w = 1
    w: Float[Array, ""]
    axes: Float[Array, "3 3"]  #: unit vectors: two across u, and u's direction

    @property
    def length(self) -> Float[Array, ""]:
        """That of u, with a derivative where it is 0."""
        return self.axes[2] @ self.u

    def position(self, y: Float[Array, " 3"]) -> Float[Array, " 3"]:
        """The position that three numbers stand for."""
        u = self.u + self.axes[0] * y[0] + self.axes[1] * y[1] - self.axes[2] * (self.w * y[2])
        w = self.w + self.length * y[2]
        # with the slope of w: at the bound, on whichever side rounding puts it, a light without
        # one would never come back
        w = jnp.where(w > 1 / _FARTHEST, w, 1 / _FARTHEST + (w - lax.stop_gradient(w)))
        return self.middle + u * (self.size / w)

    def least(self) -> Float[Array, " 3"]:
        """The least that the numbers may be: where the light is at infinity."""
        some = self.length > _AT_MIDDLE
        farthest = (1 / _FARTHEST - self.w) / jnp.where(some, self.length, 1)
        free = jnp.full_like(self.w, -jnp.inf)
        return jnp.stack([free, free, jnp.where(some, farthest, free)])


def light_position_at(
    position: Float[Array, " 3"], middle: Float[Array, " 3"], size: Float[Array, ""]
) -> LightPosition:
    """The chart around a position, brought nearer if it is farther than infinity.

    **Arguments:** `middle`, `size`: of the scene.
    """
    away = (position - middle) / size
    reach = jnp.max(jnp.abs(away))
    # scaled to order one: squares of what is very far or near leave the range of floating numbers
    scale = jnp.maximum(reach, 1)
    u, w = away / scale, 1 / scale
    length = jnp.sqrt(jnp.sum(u**2) + w**2)
    u, w = u / length, jnp.maximum(w / length, 1 / _FARTHEST)
    along = away / jnp.where(reach > 0, reach, 1)
    along = jnp.where(reach > 0, along, jnp.eye(3, dtype=u.dtype)[2])
    along = along / jnp.linalg.norm(along)
    # the axis that is least along it, made perpendicular
    least = jnp.eye(3, dtype=u.dtype)[jnp.argmin(jnp.abs(along))]
    first = jnp.cross(along, least)
    first = first / jnp.linalg.norm(first)
    return LightPosition(middle, size, u, w, jnp.stack([first, jnp.cross(along, first), along]))
