"""`Lights`: where they are, or in which direction, their colours and their fall-off."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..base.errors import InputError
from .arrays import check_shapes, color_rows, floats, is_traced, number_rows, vectors


class Lights(eqx.Module):
    """Lights, m of them: at points, with or without fall-off, or infinitely far away.

    A directional light is a point of homogeneous coordinates (x, y, z, w) with w = 0: its rays are
    parallel, and it casts shadows from everything that lies in its direction.
    """

    #: world coordinates; of a directional light the direction toward it, of any length above 0;
    #: differentiable, moves shadow edges
    position: Float[Array, "m 3"]
    color: Float[Array, "m 3"]  #: white is 1, 1, 1; differentiable
    #: the distance at which a light has its colour C: at r it is C (falloff / r)^2, the
    #: inverse-square law; 0 for none, and for directional lights; differentiable
    falloff: Float[Array, " m"]
    directional: tuple[bool, ...] = eqx.field(static=True)  #: which lights are infinitely far away

    def __init__(
        self,
        position: ArrayLike | Sequence,
        color: ArrayLike | Sequence = (1.0, 1.0, 1.0),
        directional: ArrayLike | Sequence = False,
        falloff: ArrayLike | Sequence = 0.0,
    ):
        """Builds m lights. **Arguments:** as the fields; one value holds for all lights.

        **Raises:** `InputError` for directional lights without a direction or with a fall-off, and
        for a fall-off below 0.
        """
        position, color, falloff = floats(position, color, falloff)
        self.position = vectors(position)
        m = self.position.shape[0]
        self.color, self.falloff = color_rows(color, m), number_rows(falloff, m)
        chosen: Any = [directional] * m if np.ndim(directional) == 0 else directional
        self.directional = tuple(_flag(each) for each in chosen)

    def __check_init__(self):
        check_shapes("lights.", self)
        check_directional(self)
        if not is_traced((self.position, self.falloff)):
            _check_values(self)

    def __len__(self) -> int:
        return self.position.shape[0]

    def numbers(self, directional: bool) -> list[int]:
        """Returns the numbers of the directional lights, or of those at points, from 0."""
        return [k for k, far in enumerate(self.directional) if far == directional]


def check_directional(lights: Lights) -> None:
    """Checks the kinds of lights. **Raises:** `InputError` for fewer or more than lights."""
    if len(lights.directional) != len(lights):
        raise InputError(
            f"lights.directional must be True or False for each of {len(lights)} lights, "
            f"got {len(lights.directional)}"
        )


def _check_values(lights: Lights) -> None:
    """Checks what directions and fall-offs may be. **Raises:** `InputError`."""
    falloff, position = np.asarray(lights.falloff), np.asarray(lights.position)
    for k, far in enumerate(lights.directional):
        light, got = f"light {k + 1}", f"got {falloff[k]:g}"
        if falloff[k] < 0:
            raise InputError(f"{light}: the fall-off must be at least 0, {got}")
        if far and falloff[k] > 0:
            raise InputError(f"{light} is directional: it has no fall-off, {got}")
        if far and not position[k].any():
            raise InputError(f"{light} is directional: its direction must not be 0 0 0")


def _flag(value: Any) -> bool:
    """Returns whether a light is directional. **Raises:** `InputError` for all but booleans."""
    if not isinstance(value, bool | np.bool_):
        raise InputError(f"lights.directional must be True or False, got {value!r}")
    return bool(value)
