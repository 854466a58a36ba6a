"""What a fit compares: the target picture, and which of its numbers count."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from .._types import Picture
from ..errors import PictureError

# White in 8 and 16 bits is read as 1, give or take the rounding of the conversion to linear light;
# the next number below it in 16 bits is 1 - 3e-5.
_NEARLY_WHITE, _WHITE = 1 - 1e-5, 1 + 5e-5


class Target(eqx.Module):
    """A picture to fit and which of its numbers count."""

    image: Picture
    counts: Bool[Array, "height width 3"]

    def residual(self, picture: Picture) -> Float[Array, " numbers"]:
        """Picture minus target where it counts, 0 elsewhere, flat."""
        return jnp.where(self.counts, picture - self.image, 0).reshape(-1)


def make_target(image: ArrayLike, dtype: np.dtype) -> Target:
    """Checks a target picture and leaves out what is clipped.

    A picture none of whose numbers exceeds 1 and some of which are 1 was clipped, as 8- and 16-bit
    files are: the numbers at 1 say "at least 1" and do not count. Pictures with brighter pixels
    (EXR, HDR) are taken to be whole.

    **Raises:** `PictureError` for shapes other than `(height, width, 3)`, for nan and inf, for
    integers, and if everything is clipped.
    """
    pixels = np.asarray(image)
    if pixels.ndim != 3 or pixels.shape[2] != 3 or 0 in pixels.shape:
        raise PictureError(f"the target must have shape (height, width, 3), got {pixels.shape}")
    wild = int(np.count_nonzero(~np.isfinite(pixels)))
    if wild:
        raise PictureError(f"the target must be finite, got {wild} numbers that are nan or inf")
    if not np.issubdtype(pixels.dtype, np.floating):
        raise PictureError(
            f"the target must hold linear floating numbers, as read_image gives, got {pixels.dtype}"
        )
    clipped = (pixels >= _NEARLY_WHITE) & (pixels.max() <= _WHITE)
    if clipped.all():
        raise PictureError("every number of the target is clipped: there is nothing to fit")
    return Target(jnp.asarray(pixels, dtype), jnp.asarray(~clipped))
