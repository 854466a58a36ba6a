"""Array aliases with named axes, shared by the whole package."""

from typing import Literal

from jaxtyping import Array, Bool, Float, Int

Scalar = Float[Array, ""]
"""One real number of the scene."""

PixelArray = Float[Array, "*#pixels"]
"""One real number per pixel. Functions of planes take scalars too: `*pixels` may be empty."""

Mask = Bool[Array, "*#pixels"]
"""One yes or no per pixel."""

Ids = Int[Array, "*#pixels"]
"""The number of an object per pixel: spheres first, then planes; -1 where there is none."""

Index = int | Int[Array, ""]
"""The number of one object or light, in a loop that is written out or not."""

Picture = Float[Array, "height width 3"]
"""Linear RGB, row 0 at the top, unclamped."""

Highlight = Literal["phong", "blinn"]
"""Which highlight: Phong's (R.V)^n or the halfway vector's (H.N)^n."""
