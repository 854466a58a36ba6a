"""Saturation: the level at which a camera or a file clips a channel, from the picture alone.

A clipped channel has many numbers exactly at its maximum: a spike at the top of its histogram. So
has a flat area, such as a uniform background, which is not clipped. They differ at their borders:
what shades a surface goes through the level where it is clipped, so the picture falls steadily from
there; at the border of a flat area it jumps. Where no border tells, nothing is left out.
"""

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...base.errors import InputError

# The range of numbers that a file clipped. White in 8 and 16 bits is 1, give or take the rounding
# of the conversion to linear light; the next number below white in 16 bits is 1 - 3e-5.
_NEARLY_WHITE, _WHITE = 1 - 1e-5, 1 + 5e-5

# The relative difference of numbers at one level: rounding of the conversion to linear light, and
# of levels that are printed with six digits. Neighbouring levels of 16 bits are 1.5e-5 apart.
_ONE_LEVEL = 1e-5

# The least numbers at a channel's maximum that are many. Fewer are told by chance, or by the
# symmetry of a picture, and matter little.
_MANY = 8

# How many times sparser the histogram is below a spike than at it: as many numbers as stand at the
# level spread below it over this many of its distances to the next number. The top level of a
# smooth picture in 8 bits holds no more numbers than the next one.
_SPIKE = 3

# Profiles from a border outwards: how many steps they have, and how many pixels a step has. Longer
# ones leave small spheres, shorter ones take antialiased edges for shading. In large pictures of 8
# bits the shading stays on one level for some pixels.
_PROFILE, _STRIDES = 4, (1, 2, 4, 8)

# About so many profiles are looked at in each direction; fewer tell shares less exactly.
_MOST_PROFILES = 2000

# The largest part of a profile's fall that one step of shading makes, where four would be even. An
# edge falls in one step, or in two where it is antialiased: in one of these by half at least.
_STEADY = 0.45

# The least part of a border's profiles that fall steadily where a level is clipped. The others lie
# at silhouettes and at edges of shadows. A larger part misses clipping in pictures of few pixels; a
# smaller one finds it at flat areas, where antialiased edges along a profile make up to 0.15.
_CLIPPED = 0.17


class Plateau(NamedTuple):
    """Many numbers exactly at the maximum of a channel."""

    channel: int
    level: float
    at: Bool[np.ndarray, "height width"]  #: which pixels' numbers these are


def plateaus(
    image: Float[np.ndarray, "height width 3"], counts: Bool[np.ndarray, "height width 3"]
) -> list[Plateau]:
    """Returns the channels with a spike at the top of their histogram.

    **Arguments:** `counts`: which numbers count.
    """
    found = []
    for channel in range(3):
        values, counted = image[..., channel], counts[..., channel]
        level = float(np.max(values, where=counted, initial=-np.inf))
        at = counted & (values >= level * (1 - _ONE_LEVEL))
        count = int(np.count_nonzero(at))
        if level > 0 and count >= _MANY and _is_spike(values[counted & ~at], level, count):
            found.append(Plateau(channel, level, at))
    return found


def _is_spike(below: Float[np.ndarray, " below"], level: float, count: int) -> bool:
    """Tells whether many more numbers are at a level than are near below it."""
    if not below.size:
        return False
    place = max(below.size - count, 0)
    as_many = level - float(np.partition(below, place)[place])
    return as_many >= _SPIKE * (level - float(below.max()))


def saturated(
    image: Float[np.ndarray, "height width 3"], counts: Bool[np.ndarray, "height width 3"]
) -> Bool[np.ndarray, "height width 3"]:
    """Returns which numbers are clipped.

    Those at 1 in a picture without brighter ones, as files clip there, and those at a plateau whose
    borders show that the channel is clipped.
    """
    brightest = np.max(image, where=counts, initial=-np.inf)
    clipped = counts & (image >= _NEARLY_WHITE) & (brightest <= _WHITE)
    found = [p for p in plateaus(image, counts) if not clipped[..., p.channel].any()]
    # channels of one level are clipped by the same camera
    levels = [p.level for p in found if _is_clipped(image, counts, p)]
    for plateau in found:
        if any(abs(plateau.level - level) <= _ONE_LEVEL * level for level in levels):
            clipped[..., plateau.channel] |= plateau.at
    return clipped


def from_level(
    image: Float[np.ndarray, "height width 3"], brightest: Any
) -> Bool[np.ndarray, "height width 3"]:
    """Returns which numbers are at a level or above.

    **Arguments:** `brightest`: one level, or one for each channel; inf for none.

    **Raises:** `InputError` for other shapes and nan.
    """
    level = np.asarray(brightest)
    if level.dtype.kind not in "iuf" or level.shape not in ((), (3,)) or np.isnan(level).any():
        raise InputError(f"brightest must be one number or one for each channel, got {brightest}")
    return image >= level - _ONE_LEVEL * np.abs(np.where(np.isfinite(level), level, 0))


def _is_clipped(
    image: Float[np.ndarray, "height width 3"],
    counts: Bool[np.ndarray, "height width 3"],
    plateau: Plateau,
) -> bool:
    """Tells whether the picture falls steadily from a plateau's border, as shading does."""
    values, counted = (x[..., plateau.channel] for x in (image, counts))
    below = float(np.max(values, where=counted & ~plateau.at, initial=-np.inf))
    steady, borders = 0, 0
    for turns in range(4):
        turn = partial(np.rot90, k=turns)
        turned = turn(values), turn(counted), turn(plateau.at)
        falls, border = _profiles(*turned, plateau.level, plateau.level - below)
        steady, borders = steady + falls, borders + border
    return steady >= _CLIPPED * borders > 0


def _profiles(
    values: Float[np.ndarray, "height width"],
    counted: Bool[np.ndarray, "height width"],
    at: Bool[np.ndarray, "height width"],
    level: float,
    gap: float,
) -> tuple[int, int]:
    """Counts the profiles that leave a plateau to the right, those that fall steadily and all.

    **Arguments:** `gap`: the distance from the level to the next number.
    """
    width = values.shape[1]
    row, column = np.nonzero(at[:, :-1] & counted[:, 1:] & ~at[:, 1:])
    every = max(1, row.size // _MOST_PROFILES)
    row, column = row[::every], column[::every]
    steady = np.zeros(row.size, bool)
    for stride in _STRIDES:
        columns = column[:, None] + 1 + stride * np.arange(_PROFILE)[None]
        inside = columns[:, -1] < width
        columns = np.minimum(columns, width - 1)
        rows = np.broadcast_to(row[:, None], columns.shape)
        inside &= (counted & ~at)[rows, columns].all(axis=1)
        profile = np.concatenate([np.full((row.size, 1), level), values[rows, columns]], axis=1)
        steps = -np.diff(profile, axis=1)
        fall = level - profile[:, -1]
        # falls of few levels of 8 bits tell nothing
        tells = inside & (fall >= _PROFILE * gap)
        steady |= tells & (steps.max(axis=1) <= _STEADY * fall) & (steps.min(axis=1) >= 0)
    return int(np.count_nonzero(steady)), row.size
