"""Positions of lights in projective coordinates, in which infinity is a point like others.

A position p at the scene's scale, p = middle + size u/w, is the direction of (u, w) in four
dimensions. Near the scene w is 1 and u is the position. Far away u is the direction and w, the
inverse distance, which the picture determines ever less, goes to 0. Around the start p0 a solver
works on the tangent (gnomonic) plane of the sphere of these directions: three numbers of order one
wherever the light is. Two turn the light's direction and only the third changes w, so that w > 0 is
a bound on one number. Of a directional light w stays 0, and the two that turn are all.
"""

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

# The distance, in sizes of the scene, that stands for infinity: the light's parallax across the
# scene is 1e-7 there, the rounding of float32. A smaller one would show in the picture.
_FARTHEST = 1e7

# The distance from the middle, in sizes of the scene, below which a light has no direction in
# which it could go to infinity: rounding decides the direction there.
_AT_MIDDLE = 1e-10


class LightPosition(eqx.Module):
    """The projective coordinates of one light: three numbers, all 0 at the start."""

    middle: Float[Array, " 3"]
    size: Float[Array, ""]
    u: Float[Array, " 3"]  #: the start, u.u + w w = 1
    w: Float[Array, ""]
    axes: Float[Array, "3 3"]  #: unit vectors: two across u, and u's direction

    @property
    def u_length(self) -> Float[Array, ""]:
        """Returns the length of u, with a derivative where it is 0."""
        return self.axes[2] @ self.u

    def position(self, y: Float[Array, " 3"]) -> Float[Array, " 3"]:
        """Returns the position that three coordinates stand for, in the scene's units."""
        u = self.u + self.axes[0] * y[0] + self.axes[1] * y[1] - self.axes[2] * (self.w * y[2])
        w = self.w + self.u_length * y[2]
        # with the slope of w: at the bound, on whichever side rounding puts it, a light without
        # one would never come back
        w = jnp.where(w > 1 / _FARTHEST, w, 1 / _FARTHEST + (w - lax.stop_gradient(w)))
        return self.middle + u * (self.size / w)

    def direction(self, y: Float[Array, " 2"]) -> Float[Array, " 3"]:
        """Returns the direction that two coordinates stand for, as long as it is at the start."""
        u = self.u + self.axes[0] * y[0] + self.axes[1] * y[1]
        return u * (self.size / jnp.linalg.norm(u))

    def lower_bound(self) -> Float[Array, " 3"]:
        """Returns the least that the coordinates may be: the third's is the light at infinity."""
        has_direction = self.u_length > _AT_MIDDLE
        farthest = (1 / _FARTHEST - self.w) / jnp.where(has_direction, self.u_length, 1)
        unbounded = jnp.full_like(self.w, -no_bound(self.w))
        return jnp.stack([unbounded, unbounded, jnp.where(has_direction, farthest, unbounded)])


def no_bound(unknown: Float[Array, "..."]) -> float:
    """Returns the bound of unbounded numbers: the greatest finite one, which `debug_infs` bears."""
    return float(jnp.finfo(unknown.dtype).max)


def light_position_at(
    position: Float[Array, " 3"], middle: Float[Array, " 3"], size: Float[Array, ""]
) -> LightPosition:
    """Returns the projective coordinates around a position.

    A light beyond the distance that stands for infinity is brought to this distance.

    **Arguments:** `middle`, `size`: of the scene.
    """
    offset = (position - middle) / size
    largest = jnp.max(jnp.abs(offset))
    # scaled to order one: squares of what is very far or near leave the range of floating numbers
    scale = jnp.maximum(largest, 1)
    u, w = offset / scale, 1 / scale
    length = jnp.sqrt(jnp.sum(u**2) + w**2)
    u, w = u / length, jnp.maximum(w / length, 1 / _FARTHEST)
    return LightPosition(middle, size, u, w, _axes(offset))


def light_direction_at(direction: Float[Array, " 3"]) -> LightPosition:
    """Returns the projective coordinates around a direction, whose w is 0.

    **Arguments:** `direction`: of any length above 0, which takes the place of the scene's size.
    """
    axes, largest = _axes(direction), jnp.max(jnp.abs(direction))
    per = 1 / jnp.where(largest > 0, largest, 1)
    size = largest * jnp.linalg.norm(direction * per)
    return LightPosition(jnp.zeros_like(direction), size, axes[2], jnp.zeros_like(size), axes)


def _axes(offset: Float[Array, " 3"]) -> Float[Array, "3 3"]:
    """Returns unit vectors: two across a vector, and its own direction, by default z."""
    largest = jnp.max(jnp.abs(offset))
    direction = offset / jnp.where(largest > 0, largest, 1)
    direction = jnp.where(largest > 0, direction, jnp.eye(3, dtype=offset.dtype)[2])
    direction = direction / jnp.linalg.norm(direction)
    # the coordinate axis most across the direction, made perpendicular
    across = jnp.eye(3, dtype=offset.dtype)[jnp.argmin(jnp.abs(direction))]
    first = jnp.cross(direction, across)
    first = first / jnp.linalg.norm(first)
    return jnp.stack([first, jnp.cross(direction, first), direction])
