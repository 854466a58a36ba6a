"""`Texture`: a bitmap around a sphere or the scene."""

import equinox as eqx
from jaxtyping import Array, ArrayLike, Float

from .arrays import floats


class Texture(eqx.Module):
    """A bitmap that wraps a sphere, or the sky: linear RGB, row 0 at the north pole (+z)."""

    image: Float[Array, "rows columns 3"]  #: differentiable
    file: str = eqx.field(static=True)  #: where it was read from; "" if it is in no file

    def __init__(self, image: ArrayLike, file: str = ""):
        """Builds a texture. **Arguments:** as the fields."""
        (self.image,) = floats(image)
        self.file = file
