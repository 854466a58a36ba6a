"""`Light`: one light, as shading and shadows ask for it.

In homogeneous coordinates (x, y, z, w) the way from a point P to a light is (x, y, z) - w P: w is 1
for a light at a point, and exactly 0 for a directional one, whose way is the same from everywhere.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..base.safe_math import to_order_one
from ..base.types import Mask, PixelArray, Scalar
from ..base.vec import Vec, components, dot, norm, unit, vec
from .lights import Lights

T = TypeVar("T")


class Light(eqx.Module):
    """A light at a point, or infinitely far away."""

    place: Vec  #: the position; of a directional light the unit vector toward it
    falloff: PixelArray | None  #: the distance at which it has its colour, 0 or None for any
    directional: bool = eqx.field(static=True)

    def toward(self, point: Vec) -> Vec:
        """Returns the way from points to the light: of unit length if that is infinitely far."""
        return self.place if self.directional else self.place - point

    def direction(self, point: Vec) -> Vec:
        """Returns L: the unit vectors from points to the light."""
        return self.place if self.directional else unit(self.place - point)

    def distance(self, point: Vec) -> PixelArray:
        """Returns the distance from points to the light, which may be infinite."""
        return jnp.full_like(point.x, jnp.inf) if self.directional else norm(self.place - point)

    def within(self, center: Vec, square_radius: PixelArray) -> Mask | bool:
        """Tests whether the light is inside of spheres."""
        if self.directional:
            return False
        away = self.place - center
        return dot(away, away) < square_radius

    def scaled(self, scale: Scalar) -> "Light":
        """Returns the light of a world that is `scale` times as large."""
        falloff = None if self.falloff is None else self.falloff * scale
        place = self.place if self.directional else self.place * scale
        return Light(place, falloff, self.directional)

    def faded(self, point: Vec, term: PixelArray) -> PixelArray:
        """Returns a term of shading at points times (falloff / r)^2, the inverse-square law."""
        if self.falloff is None:
            return term
        distance, fades = self.distance(point), self.falloff > 0
        ratio = jnp.where(fades, self.falloff, 1) / jnp.where(fades & (distance > 0), distance, 1)
        # one after the other: the square of a ratio may overflow where the term is 0
        return term * ratio * ratio


def make_light(
    position: Float[Array, "3 *pixels"], falloff: PixelArray | None, directional: bool
) -> Light:
    """Returns a light. **Arguments:** a row of each field of `Lights`; None for no fall-off."""
    place = vec(position)
    if directional:  # squares of lengths far from 1 leave the range of floating numbers
        place = unit(place * to_order_one(*components(place)))
    return Light(place, None if directional else falloff, directional)


def light_of(lights: Lights, number: int | Array, directional: bool, falloff: bool) -> Light:
    """Returns one of the lights.

    **Arguments:** `number`: from 0; an array if it is not known, of lights of one kind.
    `directional`: of which kind. `falloff`: false where no light has a fall-off.
    """
    own = lights.falloff[number] if falloff and not directional else None
    return make_light(lights.position[number], own, directional)


def each_light(lights: Lights, falloff: bool) -> Iterator[Light]:
    """Yields all lights, one by one. **Arguments:** `falloff`: as for `light_of`."""
    for k, directional in enumerate(lights.directional):
        yield light_of(lights, k, directional, falloff)


def _of_row(
    function: Callable[[Float[Array, " 3"], PixelArray, bool], T],
    directional: bool,
    row: tuple[Array, Array],
) -> T:
    return function(row[0], row[1], directional)


def map_lights(function: Callable[[Float[Array, " 3"], PixelArray, bool], T], lights: Lights) -> T:
    """Returns what a function says of each light, stacked: a loop over the lights of each kind.

    **Arguments:** `function`: of a light's position, its fall-off, and whether it is directional.
    """
    order, parts = [], []
    for directional in sorted(set(lights.directional)):
        numbers = lights.numbers(directional)
        at = np.asarray(numbers, np.int32)
        rows = lights.position[at], lights.falloff[at]
        of_row = partial(_of_row, function, directional)
        parts.append(lax.map(of_row, rows))
        order += numbers
    if len(parts) == 1:
        return parts[0]
    back = np.argsort(np.asarray(order))
    return jax.tree.map(lambda *x: jnp.concatenate(x)[back], *parts)
