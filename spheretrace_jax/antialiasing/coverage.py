"""Analytic coverage: exact areas of a half-plane and of a disc inside a pixel's box.

A pixel's box is the unit square around its centre, x and y from -1/2 to 1/2. The function that
bounds a region is known at the centre with its derivatives by x and y (ray differentials: Igehy,
"Tracing Ray Differentials", SIGGRAPH 1999), and is taken to be linear across the pixel. Areas,
unlike the hit or miss of a single ray, are differentiable in the position of the edge.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from ..base.derivatives import stop_first_gradient
from ..base.safe_math import clamp, larger, safe_sqrt, smaller
from ..base.types import PixelArray
from ..base.vec import Vec, cross, dot, unit
from ..tracing.differential import Differential
from ..xla.barriers import barrier
from .polygon import HalfPlane, half_plane_of, half_plane_with_area

# Least ratio of a parallelogram's area to its rounding error. Below this ratio the straight edge
# R - |q| = 0 cuts the pixel instead of the circle: the parallelogram is seen too obliquely or is
# too small on the disc.
_LEAST_PRECISION = 256


class Region(eqx.Module):
    """The covered region of a pixel's box, and its half-plane for clipping where edges cross."""

    area: PixelArray  #: of the part of the pixel, 0..1
    edge: HalfPlane  #: of the same area, on the same side


def half_plane_region(f: Differential[PixelArray]) -> Region:
    """Returns the region f > 0; see `half_plane_area`."""
    return Region(half_plane_area(f.value, f.dx, f.dy), half_plane_of(f))


def disc_region(q: Differential[Vec], axis: Vec, radius: PixelArray) -> Region:
    """Returns the region |q| < radius; see `disc_area`."""
    area = disc_area(q.value, q.dx, q.dy, axis, radius)
    inwards = q.value * (-1 / (radius * radius))
    return Region(area, half_plane_with_area(area, dot(inwards, q.dx), dot(inwards, q.dy)))


def half_plane_area(f: PixelArray, fx: PixelArray, fy: PixelArray) -> PixelArray:
    """Computes the area of a pixel's box in which f + fx x + fy y > 0.

    Let a be the larger of |fx|, |fy|, a m the smaller, and u = f/a. The area is the mean over y in
    -1/2..1/2 of clamp(u + 1/2 + m y, 0, 1).

    **Arguments:** `f`: at the pixel's centre, any function that is positive inside. `fx`, `fy`:
    the derivatives of f by the position in pixels. No edge crosses the pixel where both are 0.

    **Returns:** the area, 0..1, differentiable in all three.
    """
    fx, fy = jnp.abs(fx), jnp.abs(fy)
    a, b = larger(fx, fy), smaller(fx, fy)
    crosses = jnp.abs(f) < 2 * a
    a = jnp.where(crosses, a, 1)
    u = jnp.where(crosses, f / a, jnp.where(f > 0, 2, -2).astype(f.dtype))
    # for smaller m the quotient below is rounding error, and the area no longer depends on m
    m = larger(jnp.where(crosses, b / a, 0), (8 * float(jnp.finfo(f.dtype).eps)) ** 0.5)
    low, high = u + 0.5 - m / 2, u + 0.5 + m / 2
    ramp_low, ramp_high = clamp(low, 0, 1), clamp(high, 0, 1)
    ramp = (ramp_high - ramp_low) * (ramp_high + ramp_low) / 2
    above = larger(high - 1, 0) - larger(low - 1, 0)
    return clamp((ramp + above) / m, 0, 1)


def disc_area(q: Vec, qx: Vec, qy: Vec, axis: Vec, radius: PixelArray) -> PixelArray:
    """Computes the area of a pixel's box in which |q + qx x + qy y| < radius.

    For the silhouette of a sphere q is the perpendicular from the ray to the sphere's centre. For a
    shadow the ray runs from the lit point to the light. The box becomes a parallelogram in the
    plane across the ray. Its area inside the disc is its area minus the excess beyond the circle:
    along each side, the integral of (r^2 - R^2)/2 by the angle. The area is exact for slivers,
    spheres smaller than a pixel and curved edges.

    **Arguments:** `q`: at the pixel's centre, world units. `qx`, `qy`: the derivatives of q by the
    position in pixels. `axis`: the ray's direction, of unit length. `radius`: > 0.

    **Returns:** the area, 0..1, differentiable in all.
    """
    per_radius = 1 / radius
    q, qx, qy = q * per_radius, qx * per_radius, qy * per_radius
    # the box in the plane across the ray: the choice of axes changes no area, so that the axes need
    # no first derivatives, which would overflow where qx is tiny
    qx, qy = (v - axis * dot(v, axis) for v in (qx, qy))
    x_side, across = stop_first_gradient((qx, axis))
    first = unit(x_side)
    second = cross(across, first)
    to_plane = lambda v: (dot(v, first), dot(v, second))
    (cx, cy), (xx, xy), (yx, yy) = barrier((to_plane(q), to_plane(qx), to_plane(qy)))
    area = xx * yy - xy * yx
    square = xx * xx + xy * xy + yx * yx + yy * yy
    rounding = float(jnp.finfo(area.dtype).eps) * (square + safe_sqrt(square))
    thin = jnp.abs(area) <= _LEAST_PRECISION * jax.lax.stop_gradient(rounding)
    # the corners in order, and the side that starts at each corner
    corners = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
    corner_x = jnp.stack([cx + s * xx + t * yx for s, t in corners])
    corner_y = jnp.stack([cy + s * xy + t * yy for s, t in corners])
    side_x = jnp.stack([xx, yx, -xx, -yx])
    side_y = jnp.stack([xy, yy, -xy, -yy])
    excess = jnp.sum(_excess_beyond_circle(corner_x, corner_y, side_x, side_y), axis=0)
    round_edge = clamp(1 - excess / jnp.where(thin, 1, area), 0, 1)
    length = safe_sqrt(cx * cx + cy * cy)
    per_length = 1 / jnp.where(length > 0, length, 1)
    slope = lambda x, y: -(cx * x + cy * y) * per_length
    straight_edge = half_plane_area(1 - length, slope(xx, xy), slope(yx, yy))
    return jnp.where(thin, straight_edge, round_edge)


def _excess_beyond_circle(
    x: PixelArray, y: PixelArray, dx: PixelArray, dy: PixelArray
) -> PixelArray:
    """Integrates (r^2 - 1)/2 by the angle along a side, where it is outside the unit circle.

    **Arguments:** the side runs from (x, y) to (x + dx, y + dy).
    """
    # the integrand vanishes at the crossings, so that moving these limits changes nothing: a first
    # derivative never differentiates a root near 0
    enter, leave = _circle_crossings(*stop_first_gradient((x, y, dx, dy)))
    nonzero = dx * dx + dy * dy > 0

    def integral(start: PixelArray, end: PixelArray) -> PixelArray:
        ax, ay = x + start * dx, y + start * dy
        bx, by = x + end * dx, y + end * dy
        cross_ab = ax * (by - ay) - ay * (bx - ax)
        dot_ab = ax * bx + ay * by
        empty = (end <= start) | ~nonzero | (cross_ab == 0) & (dot_ab == 0)
        angle = jnp.arctan2(jnp.where(empty, 0, cross_ab), jnp.where(empty, 1, dot_ab))
        return jnp.where(empty, 0, (cross_ab - angle) / 2)

    return integral(jnp.zeros_like(enter), enter) + integral(leave, jnp.ones_like(leave))


def _circle_crossings(
    x: PixelArray, y: PixelArray, dx: PixelArray, dy: PixelArray
) -> tuple[PixelArray, PixelArray]:
    """Returns where a side enters and leaves the unit circle, as fractions 0..1 of its length."""
    square = dx * dx + dy * dy
    per_square = 1 / jnp.where(square > 0, square, 1)
    middle = -(x * dx + y * dy) * per_square
    moment = x * dy - y * dx  # the distance from the centre times the side's length
    half_chord = safe_sqrt(square - moment * moment) * per_square
    return clamp(middle - half_chord, 0, 1), clamp(middle + half_chord, 0, 1)
