"""Half-planes in a pixel's box, and the exact area of what several of them have in common.

A pixel's box is the unit square around its centre, x to the right and y down, from -1/2 to 1/2.
Seen from near enough every edge is straight. What is seen of an object is then what lies inside its
own outline and outside those in front of it; what is lit, outside the shadows: half-planes all of
them, so that what they have in common is a convex polygon, whose area is exact.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..base.safe_math import larger, safe_sqrt, smaller
from ..base.types import Index, Mask, PixelArray
from ..tracing.differential import Differential
from ..xla.loops import loop

# The box's half diagonal is 0.71: a line this far away does not cut it.
_FAR = 1.0


class HalfPlane(eqx.Module):
    """Where `right x + down y + offset > 0`, with (right, down) a unit vector, inwards."""

    right: PixelArray
    down: PixelArray
    offset: PixelArray  #: how far the box's centre is inside, in pixels

    def __invert__(self) -> "HalfPlane":
        """The other side."""
        return HalfPlane(-self.right, -self.down, -self.offset)


class Polygon(eqx.Module):
    """What half-planes have in common in the box."""

    sides: tuple[HalfPlane, ...]
    area: PixelArray  #: 0..1
    x: PixelArray  #: the middle's place, without derivatives; the box's, if there is nothing
    y: PixelArray


def whole_pixel(like: PixelArray) -> HalfPlane:
    """A half-plane that holds all of the box."""
    return HalfPlane(jnp.ones_like(like), jnp.zeros_like(like), jnp.full_like(like, _FAR))


def half_plane_of(f: Differential[PixelArray]) -> HalfPlane:
    """Where f > 0, taken to be linear: everything or nothing where it does not vary."""
    slope = safe_sqrt(f.dx * f.dx + f.dy * f.dy)
    passes = jnp.abs(f.value) < _FAR * slope
    per_slope = 1 / jnp.where(passes, slope, 1)
    return HalfPlane(
        jnp.where(passes, f.dx * per_slope, 1),
        jnp.where(passes, f.dy * per_slope, 0),
        jnp.where(passes, f.value * per_slope, _beyond(f.value > 0, f.value)),
    )


def half_plane_with_area(part: PixelArray, x: PixelArray, y: PixelArray) -> HalfPlane:
    """The half-plane that holds a given part of the box and lies in a given direction.

    **Arguments:** `part`: the area, 0..1. `x`, `y`: the direction, of a length that is not tiny.
    """
    square = x * x + y * y
    # of anything shorter the inverse square, which its derivative needs, is infinite
    some = square > float(jnp.finfo(square.dtype).tiny) ** 0.5
    per_length = jnp.where(some, 1 / jnp.sqrt(jnp.where(some, square, 1)), 0)
    right, down = jnp.where(some, x * per_length, 1), jnp.where(some, y * per_length, 0)
    across, along = jnp.abs(right), jnp.abs(down)
    a, b = larger(across, along), smaller(across, along)
    less = smaller(part, 1 - part)
    cuts_corner = 2 * a * less < b
    corner = safe_sqrt(jnp.where(cuts_corner, 2 * a * b * less, 0)) - (a + b) / 2
    middle = a * (less - 0.5)
    offset = jnp.where(cuts_corner, corner, middle)
    offset = jnp.where(part > 0.5, -offset, offset)
    cuts = (part > 0) & (part < 1)
    return HalfPlane(
        jnp.where(cuts, right, 1),
        jnp.where(cuts, down, 0),
        jnp.where(cuts, offset, _beyond(part > 0.5, part)),
    )


def contain_pixel(half_planes: tuple[HalfPlane, ...]) -> Mask:
    """Whether all of the box lies in all of them, as in `everything`."""
    offsets = lax.stop_gradient([h.offset for h in half_planes])
    return functools.reduce(jnp.minimum, offsets) >= _FAR


def _beyond(inside: Mask, like: PixelArray) -> PixelArray:
    """The offset of a line that does not cut the box, all of which is inside or outside."""
    return jnp.where(inside, _FAR, -_FAR).astype(like.dtype)


def clipped_area(*half_planes: HalfPlane) -> PixelArray:
    """The part of the box that lies in all of some half-planes, 0..1."""
    return clip_pixel(*half_planes).area


def clip_pixel(*half_planes: HalfPlane) -> Polygon:
    """What of the box lies in all of some half-planes.

    By Green's theorem its area is half the sum, over the lines that bound it, of the length of the
    line's piece times its distance from the centre; each piece is what is left of the line between
    all others (Liang, Barsky, "A New Concept and Method for Line Clipping", ACM TOG 3, 1984).
    """
    names = ("right", "down", "offset")
    lines = (
        jnp.stack(jnp.broadcast_arrays(*(getattr(h, name) for h in half_planes))) for name in names
    )
    area, x, y = _area_and_middle(*lines)
    return Polygon(half_planes, area, *lax.stop_gradient((x, y)))


@jax.custom_jvp
def _area_and_middle(
    right: Float[Array, "lines *pixels"],
    down: Float[Array, "lines *pixels"],
    offset: Float[Array, "lines *pixels"],
) -> tuple[PixelArray, PixelArray, PixelArray]:
    return _sums(offset, *_pieces(right, down, offset))


@_area_and_middle.defjvp
def _area_and_middle_jvp(primals, tangents):
    # Where a line moves outwards, the area grows by the length of its piece: no quotient of small
    # numbers, as two nearly parallel lines make them, is ever differentiated.
    length, x, y = _pieces(*primals)
    right, down, offset = tangents
    grows = (length[:-4] * (offset + right * x[:-4] + down * y[:-4])).sum(0)
    still = jnp.zeros_like(grows)
    return _sums(primals[2], length, x, y), (grows, still, still)


def _sums(
    offset: Array, length: Array, x: Array, y: Array
) -> tuple[PixelArray, PixelArray, PixelArray]:
    """Area and middle, from each line's piece.

    The triangle between the centre and a piece has its own middle two thirds of the way out.
    """
    sides = jnp.full_like(length[-4:], 0.5)
    parts = length * jnp.concatenate([offset, sides]) / 2
    area = parts.sum(0)
    some = area > jnp.finfo(area.dtype).eps
    out = jnp.where(some, 1 / jnp.where(some, area, 1), 0) * (2 / 3)
    return jnp.clip(area, 0, 1), (parts * x).sum(0) * out, (parts * y).sum(0) * out


def _pieces(right: Array, down: Array, offset: Array) -> tuple[Array, Array, Array]:
    """Of each line, the box's four sides last, the length and middle of the piece that bounds."""
    like = right[:1]
    sides = lambda *values: [jnp.full_like(like, value) for value in values]
    right = jnp.concatenate([right, *sides(1, -1, 0, 0)])
    down = jnp.concatenate([down, *sides(0, 0, 1, -1)])
    offset = jnp.concatenate([offset, *sides(0.5, 0.5, 0.5, 0.5)])
    count = right.shape[0]
    number = jnp.arange(count, dtype=jnp.int32).reshape(count, *(1,) * (right.ndim - 1))

    def clip(j: Index, piece: tuple[Array, Array]) -> tuple[Array, Array]:
        start, end = piece
        rj, dj, oj = (lax.dynamic_index_in_dim(v, j) for v in (right, down, offset))
        along = right * rj + down * dj
        # twice, with the lines exchanged: fused multiply-adds round so that it would not be 0 for
        # equal lines, nor change its sign as the lines change their places
        turn = ((right * dj - down * rj) - (rj * down - dj * right)) / 2
        # how far the foot is inside half-plane j, from the difference of the two normals, so that
        # two nearly parallel lines cross at one point, and that of equal ones is 0
        sign = jnp.where(along > 0, 1, -1).astype(offset.dtype)
        apart = (rj - sign * right) * right + (dj - sign * down) * down
        inside = oj - sign * offset - apart * offset
        at = -inside / jnp.where(turn == 0, 1, turn)
        other = number != j
        start = jnp.where(other & (turn > 0), jnp.maximum(start, at), start)
        end = jnp.where(other & (turn < 0), jnp.minimum(end, at), end)
        equal = (inside == 0) & (along > 0) & (number > j)
        return start, jnp.where(other & (turn == 0) & ((inside < 0) | equal), start, end)

    # a line is followed from its foot, the point nearest the centre, at a right angle to its normal
    whole = jnp.full_like(right, -2), jnp.full_like(right, 2)
    start, end = loop(count, clip, whole, unroll=0)
    length = jnp.maximum(end - start, 0)
    middle = (start + end) / 2
    return length, -offset * right - middle * down, -offset * down + middle * right
