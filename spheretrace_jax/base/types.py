"""Array aliases with named axes, shared by the whole package."""

from typing import Literal

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

Scalar = Float[Array, ""]
"""One real number of the scene."""

PixelArray = Float[Array, "*#pixels"]
"""One real number per pixel. Functions of pixels take scalars too: `*pixels` may be empty."""

Mask = Bool[Array, "*#pixels"]
"""One boolean per pixel."""

Ids = Int[Array, "*#pixels"]
"""The index of an object per pixel: spheres first, then planes; -1 for no object."""

Index = int | Int[Array, ""]
"""The index of one object or light, in an unrolled loop (int) or a rolled one (tracer)."""

Picture = Float[Array, "height width 3"]
"""Linear RGB, row 0 at the top, unclamped."""

Colorspace = Literal["auto", "linear", "srgb"]
"""How a picture file's numbers are coded; `"auto"` for what the file says, or what is usual."""

Highlight = Literal["phong", "blinn"]
"""The highlight model: Phong's (R.V)^n or the halfway vector's (H.N)^n."""


def widest_float(dtype: jnp.dtype) -> jnp.dtype:
    """Returns double precision where JAX has it (`jax_enable_x64`), else the dtype."""
    return max(jnp.dtype(dtype), jnp.dtype(jnp.result_type(float)), key=lambda d: d.itemsize)
