"""Colours that vary over a surface: bitmaps around spheres and the sky, checkers on planes."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..base.types import Ids, Mask, PixelArray
from ..base.vec import Vec, cross, dot, norm, where
from ..xla.gather import gather_rows
from .tables import SceneTables


def sphere_uv(direction: Vec) -> tuple[PixelArray, PixelArray]:
    """Where a direction points on the globe.

    **Returns:** u = azimuth / 2 pi around +z, in 0..1, and v = polar angle / pi from +z, in 0..1.
    At the poles u is 0, with derivative 0.
    """
    axis = (direction.x == 0) & (direction.y == 0)
    azimuth = jnp.arctan2(direction.y, jnp.where(axis, 1, direction.x))
    u = azimuth / (2 * jnp.pi)
    polar = jnp.arctan2(
        norm(Vec(direction.x, direction.y, jnp.zeros_like(direction.x))), direction.z
    )
    return jnp.where(u < 0, u + 1, u), polar / jnp.pi


def lookup(image: Float[Array, "rows columns 3"], u: PixelArray, v: PixelArray) -> Vec:
    """The bitmap's colour at (u, v), bilinear: wrapped in u, clamped in v.

    Texel (row i, column j) has its centre at u = (j + 1/2) / columns, v = (i + 1/2) / rows.
    """
    rows, columns, _ = image.shape
    x, y = u * columns - 0.5, v * rows - 0.5
    left, top = jnp.floor(jax.lax.stop_gradient(x)), jnp.floor(jax.lax.stop_gradient(y))
    right_part, lower_part = x - left, y - top
    j = left.astype(jnp.int32) % columns
    i = top.astype(jnp.int32)
    i0, i1 = jnp.clip(i, 0, rows - 1), jnp.clip(i + 1, 0, rows - 1)
    j1 = (j + 1) % columns

    def texel(i: Ids, j: Ids) -> Vec:
        colors = image[i, j]
        return Vec(colors[..., 0], colors[..., 1], colors[..., 2])

    upper = texel(i0, j) * (1 - right_part) + texel(i0, j1) * right_part
    lower = texel(i1, j) * (1 - right_part) + texel(i1, j1) * right_part
    return upper * (1 - lower_part) + lower * lower_part


def worn(number: Ids, outward: Vec, images: tuple, pic: tuple[int, ...]) -> Vec:
    """What to multiply the colour of an object by: its texture's colour, white if it has none.

    **Arguments:** `number`: the objects' numbers. `outward`: outward normals. `images`: bitmaps.
    `pic`: per sphere the number of its texture from 1, 0 for none.
    """
    u, v = sphere_uv(outward)
    one = jnp.ones_like(u)
    factor = Vec(one, one, one)
    # the last entry is for all that is no sphere
    table = jnp.asarray((*pic, 0), jnp.int32)
    sphere = (number >= 0) & (number < len(pic))
    which = table[jnp.where(sphere, number.astype(jnp.int32), len(pic))]
    for k in sorted(set(pic) - {0}):
        factor = where(which == k, lookup(images[k - 1], u, v), factor)
    return factor


def other_square(tables: SceneTables, number: Ids, point: Vec) -> tuple[Mask, Vec]:
    """Whether a point lies on a checker's other squares, and the colour that these have.

    Squares have a corner at the plane's point; their sides run along the world's x axis laid into
    the plane (y, where the normal is nearest to x) and across it.
    """
    plane, checker = gather_rows((tables.planes, tables.checkers), tables.plane_rows(number))
    n = jax.lax.stop_gradient(plane.normal)
    steep = (jnp.abs(n.x) > jnp.abs(n.y)) & (jnp.abs(n.x) > jnp.abs(n.z))
    zero, one = jnp.zeros_like(n.x), jnp.ones_like(n.x)
    axis = where(steep, Vec(zero, one, zero), Vec(one, zero, zero))
    along = axis - n * dot(axis, n)
    along = along * (1 / norm(along))
    across = cross(n, along)
    offset = jax.lax.stop_gradient(point - plane.point)
    size = jax.lax.stop_gradient(checker.size)
    some = tables.is_plane(number) & (size > 0)
    side = jnp.where(some, size, 1)
    squares = jnp.floor(dot(offset, along) / side) + jnp.floor(dot(offset, across) / side)
    return some & (squares % 2 != 0), checker.color
