"""How much of a pixel lies inside an edge: exact areas of a half-plane and of a disc in a box.

A pixel's box is the unit square around its centre, x and y from -1/2 to 1/2. What bounds a region
is known at the centre together with its derivatives by x and y (ray differentials: Igehy, "Tracing
Ray Differentials", SIGGRAPH 1999), and is taken to be linear across the pixel. Areas, unlike the
yes or no of a single ray, are differentiable in where the edge is.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from ..base.safe_math import clamp, larger, safe_sqrt, smaller
from ..base.types import PixelArray
from ..base.vec import Vec, cross, dot, unit
from ..tracing.differential import Differential
from ..xla.barriers import barrier
from .polygon import HalfPlane, half_plane_of, half_plane_with_area

# Where rounding is more than one part in this many of a parallelogram's area, as it is seen too
# obliquely or is too small on the disc, it is cut by the straight edge R - |q| = 0 instead.
_DIGITS = 256


class Region(eqx.Module):
    """A part of a pixel's box, and the half-plane that stands for it where edges cross."""

    part: PixelArray  #: its area, 0..1
    edge: HalfPlane  #: of the same area, on the same side


def half_plane_region(f: Differential[PixelArray]) -> Region:
    """Where f > 0; see `half_plane`."""
    return Region(half_plane_area(f.value, f.dx, f.dy), half_plane_of(f))


def disc_region(q: Differential[Vec], axis: Vec, radius: PixelArray) -> Region:
    """Where |q| < radius; see `disc`."""
    part = disc_area(q.value, q.dx, q.dy, axis, radius)
    inwards = q.value * (-1 / (radius * radius))
    return Region(part, half_plane_with_area(part, dot(inwards, q.dx), dot(inwards, q.dy)))


def half_plane_area(f: PixelArray, fx: PixelArray, fy: PixelArray) -> PixelArray:
    """The part of a pixel's box in which f + fx x + fy y > 0.

    With a the larger and a m the smaller of |fx|, |fy| and u = f/a, it is the mean over y in
    -1/2..1/2 of clamp(u + 1/2 + m y, 0, 1).

    **Arguments:** `f`: any function that is positive inside, at the pixel's centre. `fx`, `fy`:
    its derivatives by the position in pixels. Where both are 0 the edge does not pass.

    **Returns:** the area, 0..1, differentiable in all three.
    """
    fx, fy = jnp.abs(fx), jnp.abs(fy)
    a, b = larger(fx, fy), smaller(fx, fy)
    passes = jnp.abs(f) < 2 * a
    a = jnp.where(passes, a, 1)
    u = jnp.where(passes, f / a, jnp.where(f > 0, 2, -2).astype(f.dtype))
    # for smaller m the quotient below is rounding, and m no longer matters
    m = larger(jnp.where(passes, b / a, 0), (8 * float(jnp.finfo(f.dtype).eps)) ** 0.5)
    low, high = u + 0.5 - m / 2, u + 0.5 + m / 2
    ramp_low, ramp_high = clamp(low, 0, 1), clamp(high, 0, 1)
    ramp = (ramp_high - ramp_low) * (ramp_high + ramp_low) / 2
    above = larger(high - 1, 0) - larger(low - 1, 0)
    return clamp((ramp + above) / m, 0, 1)


def disc_area(q: Vec, qx: Vec, qy: Vec, axis: Vec, radius: PixelArray) -> PixelArray:
    """The part of a pixel's box in which |q + qx x + qy y| < radius.

    For the silhouette of a sphere q runs from the ray to its centre at a right angle; for a shadow
    the ray runs from the lit point to the light. The box becomes a parallelogram in the plane
    across the ray, and its area inside the disc is what is left when the excess beyond the circle
    is taken off: along each side, the integral of (r^2 - R^2)/2 by the angle. Slivers, spheres
    smaller than a pixel and curved edges are exact.

    **Arguments:** `q`: at the pixel's centre, world units. `qx`, `qy`: its derivatives by the
    position in pixels. `axis`: the ray's direction, of unit length. `radius`: > 0.

    **Returns:** the area, 0..1, differentiable in all.
    """
    per_radius = 1 / radius
    q, qx, qy = q * per_radius, qx * per_radius, qy * per_radius
    # the box in the plane across the ray; which axes are taken there changes no area, so that they
    # need no derivatives, which overflow where qx is tiny
    qx, qy = (v - axis * dot(v, axis) for v in (qx, qy))
    first = jax.lax.stop_gradient(unit(qx))
    second = cross(jax.lax.stop_gradient(axis), first)
    to_plane = lambda v: (dot(v, first), dot(v, second))
    (cx, cy), (xx, xy), (yx, yy) = barrier((to_plane(q), to_plane(qx), to_plane(qy)))
    area = xx * yy - xy * yx
    square = xx * xx + xy * xy + yx * yx + yy * yy
    rounding = float(jnp.finfo(area.dtype).eps) * (square + safe_sqrt(square))
    thin = jnp.abs(area) <= _DIGITS * jax.lax.stop_gradient(rounding)
    # the corners, once around, and the side that starts at each
    across = [-0.5, 0.5, 0.5, -0.5]
    along = [-0.5, -0.5, 0.5, 0.5]
    corner_x = jnp.stack([cx + s * xx + t * yx for s, t in zip(across, along, strict=True)])
    corner_y = jnp.stack([cy + s * xy + t * yy for s, t in zip(across, along, strict=True)])
    side_x = jnp.stack([xx, yx, -xx, -yx])
    side_y = jnp.stack([xy, yy, -xy, -yy])
    beyond = jnp.sum(_beyond_unit_circle(corner_x, corner_y, side_x, side_y), axis=0)
    round_edge = clamp(1 - beyond / jnp.where(thin, 1, area), 0, 1)
    length = safe_sqrt(cx * cx + cy * cy)
    per_length = 1 / jnp.where(length > 0, length, 1)
    slope = lambda x, y: -(cx * x + cy * y) * per_length
    straight_edge = half_plane_area(1 - length, slope(xx, xy), slope(yx, yy))
    return jnp.where(thin, straight_edge, round_edge)


def _beyond_unit_circle(x: PixelArray, y: PixelArray, dx: PixelArray, dy: PixelArray) -> PixelArray:
    """The integral of (r^2 - 1)/2 by the angle along the part of a side outside the unit circle.

    **Arguments:** the side runs from (x, y) to (x + dx, y + dy).
    """
    # the integrand vanishes where the side crosses the circle, so that moving these ends changes
    # nothing: without their derivatives no root is ever differentiated near 0
    enter, leave = _inside_unit_circle(*jax.lax.stop_gradient((x, y, dx, dy)))
    some = dx * dx + dy * dy > 0

    def stretch(start: PixelArray, end: PixelArray) -> PixelArray:
        ax, ay = x + start * dx, y + start * dy
        bx, by = x + end * dx, y + end * dy
        turned = ax * (by - ay) - ay * (bx - ax)
        ahead = ax * bx + ay * by
        empty = (end <= start) | ~some | (turned == 0) & (ahead == 0)
        angle = jnp.arctan2(jnp.where(empty, 0, turned), jnp.where(empty, 1, ahead))
        return jnp.where(empty, 0, (turned - angle) / 2)

    return stretch(jnp.zeros_like(enter), enter) + stretch(leave, jnp.ones_like(leave))


def _inside_unit_circle(
    x: PixelArray, y: PixelArray, dx: PixelArray, dy: PixelArray
) -> tuple[PixelArray, PixelArray]:
    """Where a side enters and leaves the unit circle, 0..1 of its length."""
    square = dx * dx + dy * dy
    per_square = 1 / jnp.where(square > 0, square, 1)
    middle = -(x * dx + y * dy) * per_square
    apart = x * dy - y * dx  # from the centre to the side, times the side's length
    chord = safe_sqrt(square - apart * apart) * per_square
    return jnp.clip(middle - chord, 0, 1), jnp.clip(middle + chord, 0, 1)
