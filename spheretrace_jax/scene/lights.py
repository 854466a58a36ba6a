"""`Lights`: where they are, and their colours."""

from collections.abc import Sequence

import equinox as eqx
from jaxtyping import Array, ArrayLike, Float

from .arrays import check_shapes, color_rows, floats, vectors


class Lights(eqx.Module):
    """Point lights, m of them, without fall-off."""

    position: Float[Array, "m 3"]  #: world coordinates; differentiable, moves shadow edges
    color: Float[Array, "m 3"]  #: white is 1, 1, 1; differentiable

    def __init__(
        self, position: ArrayLike | Sequence, color: ArrayLike | Sequence = (1.0, 1.0, 1.0)
    ):
        """Builds m lights. **Arguments:** as the fields; one colour holds for all lights."""
        position, color = floats(position, color)
        self.position = vectors(position)
        self.color = color_rows(color, self.position.shape[0])

    def __check_init__(self):
        check_shapes("lights.", self)

    def __len__(self) -> int:
        return self.position.shape[0]
