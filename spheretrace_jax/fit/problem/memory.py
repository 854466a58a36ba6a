"""The memory that a fit takes, said before a large picture takes it."""

import math
import warnings
from collections.abc import Sequence

from ...base.errors import PictureWarning
from ...scene.settings import RenderSettings
from ..model.target import common_divisors

# The memory of a fit of the lecture's kind, in bytes per pixel beside what programs take: of each
# pixel, and of each of its rays or parts with covered edges. Measured on the nine spheres with
# 1024 x 1024 and 2048 x 2048 pixels: 280 to 420 with single rays and 860 with four, 610 to 900 with
# covered edges and 1980 with four parts; in float64 1.0 to 1.5 times as much.
_OF_PIXEL, _OF_RAY, _OF_AREA, _DOUBLE = 130, 180, 490, 1.2

# The memory from which it is said, in bytes.
_MUCH = 1e9


def memory(settings: RenderSettings, itemsize: int) -> float:
    """Returns about how many bytes the fit of a picture takes, of numbers of `itemsize` bytes."""
    of_sample = _OF_AREA if settings.antialias else _OF_RAY
    of_pixel = _OF_PIXEL + of_sample * settings.samples**2
    return of_pixel * settings.width * settings.height * (_DOUBLE if itemsize == 8 else 1.0)


def warn_of_memory(settings: Sequence[RenderSettings], itemsize: int, shrink: int) -> None:
    """Says what a fit of large pictures takes, and what a smaller one takes.

    **Arguments:** `settings`: of the pictures. `shrink`: by how much they are smaller already.

    **Warns:** `PictureWarning`.
    """
    total = sum(memory(s, itemsize) for s in settings)
    if total < _MUCH:
        return
    pixels = sum(s.width * s.height for s in settings)
    said = f"a fit of {pixels / 1e6:.1f} million pixels takes about {total / 1e9:.1f} GB of memory"
    divisor = math.gcd(*(side for s in settings for side in (s.width, s.height)))
    sides = common_divisors(divisor, divisor)
    if sides:
        side = next((n for n in sides if total / n**2 < _MUCH), sides[-1])
        smaller = f"shrink={shrink * side} (--shrink {shrink * side})"
        said += f", with {smaller} about {total / side**2 / 1e9:.2g} GB"
    warnings.warn(said, PictureWarning, stacklevel=4)
