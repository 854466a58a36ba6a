"""Polygon clipping: half-planes clipped to a pixel's box, with exact areas and derivatives.

A pixel's box is the unit square around its centre, x to the right and y down, from -1/2 to 1/2.
Across one pixel every edge is taken to be straight. The visible region of an object is inside its
silhouette and outside those of the objects in front; the lit region is outside the shadows. All of
these are half-planes, so that their intersection is a convex polygon with an exact area.
"""

import functools
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..base.safe_math import clamp, larger, safe_sqrt, smaller
from ..base.types import Index, Mask, PixelArray
from ..tracing.differential import Differential
from ..xla.loops import loop

# Offset in pixels of a line that does not cut the box, whose half diagonal is 0.71.
_FAR = 1.0

# The box as half-planes: inward normals (right, down), each with offset 1/2.
_BOX_RIGHT, _BOX_DOWN = (1, -1, 0, 0), (0, 0, 1, -1)


class HalfPlane(eqx.Module):
    """The half-plane `right x + down y + offset > 0`; (right, down) is the inward unit normal."""

    right: PixelArray
    down: PixelArray
    offset: PixelArray  #: distance of the box's centre from the line, in pixels; > 0 inside

    def __invert__(self) -> "HalfPlane":
        """Returns the complement."""
        return HalfPlane(-self.right, -self.down, -self.offset)


class Polygon(eqx.Module):
    """The intersection of half-planes and the box."""

    sides: tuple[HalfPlane, ...]
    area: PixelArray  #: 0..1
    x: PixelArray  #: of the centroid, without first derivatives; the box's centre if empty
    y: PixelArray


def whole_pixel(like: PixelArray) -> HalfPlane:
    """Returns a half-plane that contains the box, in the shape and dtype of `like`."""
    return HalfPlane(jnp.ones_like(like), jnp.zeros_like(like), jnp.full_like(like, _FAR))


def half_plane_of(f: Differential[PixelArray]) -> HalfPlane:
    """Returns the half-plane f > 0 with f linearised; all or nothing where f does not vary."""
    slope = safe_sqrt(f.dx * f.dx + f.dy * f.dy)
    cuts = jnp.abs(f.value) < _FAR * slope
    per_slope = 1 / jnp.where(cuts, slope, 1)
    return HalfPlane(
        jnp.where(cuts, f.dx * per_slope, 1),
        jnp.where(cuts, f.dy * per_slope, 0),
        jnp.where(cuts, f.value * per_slope, _uncut_offset(f.value > 0, f.value)),
    )


def half_plane_with_area(area: PixelArray, x: PixelArray, y: PixelArray) -> HalfPlane:
    """Returns the half-plane with a known area inside the box and a known normal direction.

    **Arguments:** `area`: 0..1. `x`, `y`: the inward normal, of any length that is not tiny.
    """
    square = x * x + y * y
    # the derivative needs the inverse square, which is infinite for shorter normals
    nonzero = square > float(jnp.finfo(square.dtype).tiny) ** 0.5
    per_length = jnp.where(nonzero, 1 / jnp.sqrt(jnp.where(nonzero, square, 1)), 0)
    right, down = jnp.where(nonzero, x * per_length, 1), jnp.where(nonzero, y * per_length, 0)
    abs_right, abs_down = jnp.abs(right), jnp.abs(down)
    a, b = larger(abs_right, abs_down), smaller(abs_right, abs_down)
    less = smaller(area, 1 - area)
    cuts_corner = 2 * a * less < b
    corner = safe_sqrt(jnp.where(cuts_corner, 2 * a * b * less, 0)) - (a + b) / 2
    trapezoid = a * (less - 0.5)
    offset = jnp.where(cuts_corner, corner, trapezoid)
    offset = jnp.where(area > 0.5, -offset, offset)
    cuts = (area > 0) & (area < 1)
    return HalfPlane(
        jnp.where(cuts, right, 1),
        jnp.where(cuts, down, 0),
        jnp.where(cuts, offset, _uncut_offset(area > 0.5, area)),
    )


def contain_pixel(half_planes: tuple[HalfPlane, ...]) -> Mask:
    """Tests whether the box lies in every half-plane, as in `whole_pixel`."""
    offsets = lax.stop_gradient([h.offset for h in half_planes])
    return functools.reduce(jnp.minimum, offsets) >= _FAR


def _uncut_offset(inside: Mask, like: PixelArray) -> PixelArray:
    """Returns the offset of a line that leaves all of the box inside or outside."""
    return jnp.where(inside, _FAR, -_FAR).astype(like.dtype)


def clipped_area(*half_planes: HalfPlane) -> PixelArray:
    """Returns the area of the intersection of half-planes and the box, 0..1."""
    return clip_pixel(*half_planes).area


def clip_pixel(*half_planes: HalfPlane) -> Polygon:
    """Clips the box by half-planes to a convex polygon.

    By Green's theorem the area is half the sum over the edges of length times distance from the
    centre. Each edge is a line clipped by all other half-planes (Liang, Barsky, "A New Concept and
    Method for Line Clipping", ACM TOG 3, 1984).
    """
    names = ("right", "down", "offset")
    lines = (
        jnp.stack(jnp.broadcast_arrays(*(getattr(h, name) for h in half_planes))) for name in names
    )
    area, x, y = _area_and_centroid(*lines)
    return Polygon(half_planes, area, x, y)


@jax.custom_jvp
def _area_and_centroid(
    right: Float[Array, "lines *pixels"],
    down: Float[Array, "lines *pixels"],
    offset: Float[Array, "lines *pixels"],
) -> tuple[PixelArray, PixelArray, PixelArray]:
    return _integrate(offset, *_clip_lines(right, down, offset))


@_area_and_centroid.defjvp
def _area_and_centroid_jvp(primals, tangents):
    # closed form: where a line moves outwards, the area grows by the length of its edge. Quotients
    # of small numbers, as from two nearly parallel lines, are never differentiated.
    length, x, y = _clip_lines(*primals)
    right, down, offset = tangents
    growth = (length[:-4] * (offset + right * x[:-4] + down * y[:-4])).sum(0)
    zero = jnp.zeros_like(growth)  # of the centroid; see `stop_first_gradient`
    return _integrate(primals[2], length, x, y), (growth, zero, zero)


def _integrate(
    offset: Array, length: Array, x: Array, y: Array
) -> tuple[PixelArray, PixelArray, PixelArray]:
    """Computes area and centroid from the length and midpoint (x, y) of each edge.

    The triangle between the centre and an edge has its centroid two thirds of the way out.
    """
    box_offset = jnp.full_like(length[-4:], 0.5)
    triangles = length * jnp.concatenate([offset, box_offset]) / 2
    area = triangles.sum(0)
    positive = area > jnp.finfo(area.dtype).eps
    scale = jnp.where(positive, 1 / jnp.where(positive, area, 1), 0) * (2 / 3)
    return clamp(area, 0, 1), (triangles * x).sum(0) * scale, (triangles * y).sum(0) * scale


def _clip_lines(right: Array, down: Array, offset: Array) -> tuple[Array, Array, Array]:
    """Clips each line by all other half-planes and the box.

    **Returns:** length and midpoint (x, y) of each line's edge, the box's four sides last.
    """
    like = right[:1]
    sides = lambda *values: [jnp.full_like(like, value) for value in values]
    right = jnp.concatenate([right, *sides(*_BOX_RIGHT)])
    down = jnp.concatenate([down, *sides(*_BOX_DOWN)])
    offset = jnp.concatenate([offset, *sides(0.5, 0.5, 0.5, 0.5)])
    count = right.shape[0]
    number = jnp.arange(count, dtype=jnp.int32).reshape(count, *(1,) * (right.ndim - 1))
    # distances along a line are measured from its foot, the point nearest the centre
    unclipped = jnp.full_like(right, -2), jnp.full_like(right, 2)
    clip = partial(_clip_by, right, down, offset, number)
    start, end = loop(count, clip, unclipped, unroll=0)
    length = larger(end - start, 0)
    middle = (start + end) / 2
    return length, -offset * right - middle * down, -offset * down + middle * right


def _clip_by(
    right: Array,
    down: Array,
    offset: Array,
    number: Array,
    j: Index,
    segment: tuple[Array, Array],
) -> tuple[Array, Array]:
    """Clips the segments (start, end) of all lines by half-plane j.

    **Arguments:** `number`: each line's index.
    """
    start, end = segment
    rj, dj, oj = (lax.dynamic_index_in_dim(v, j) for v in (right, down, offset))
    cosine = right * rj + down * dj
    # computed twice with the lines exchanged: fused multiply-adds round so that a single difference
    # would not be 0 for equal lines, nor antisymmetric
    sine = ((right * dj - down * rj) - (rj * down - dj * right)) / 2
    # distance of the foot inside half-plane j, from the difference of the two normals: nearly
    # parallel lines then cross at one point, and the distance of equal lines is 0
    sign = jnp.where(cosine > 0, 1, -1).astype(offset.dtype)
    deviation = (rj - sign * right) * right + (dj - sign * down) * down
    inside = oj - sign * offset - deviation * offset
    crossing = -inside / jnp.where(sine == 0, 1, sine)
    other = number != j
    start = jnp.where(other & (sine > 0), larger(crossing, start), start)
    end = jnp.where(other & (sine < 0), smaller(end, crossing), end)
    # of equal lines the first one keeps the edge
    equal = (inside == 0) & (cosine > 0) & (number > j)
    return start, jnp.where(other & (sine == 0) & ((inside < 0) | equal), start, end)
