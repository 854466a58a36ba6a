"""Textures: bitmaps around spheres and the sky, checkers on planes."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..base.types import Ids, Mask, PixelArray
from ..base.vec import SplitVec, Vec, cross, dot, norm, where
from ..xla.gather import gather_rows
from .tables import SceneTables


def sphere_uv(direction: Vec) -> tuple[PixelArray, PixelArray]:
    """Converts directions to texture coordinates (equirectangular mapping).

    **Returns:** u = azimuth / 2 pi around +z, in 0..1, and v = polar angle / pi from +z, in 0..1.
    At the poles u is 0, with derivative 0.
    """
    at_pole = (direction.x == 0) & (direction.y == 0)
    azimuth = jnp.arctan2(direction.y, jnp.where(at_pole, 1, direction.x))
    u = azimuth / (2 * jnp.pi)
    polar = jnp.arctan2(
        norm(SplitVec(direction.x, direction.y, jnp.zeros_like(direction.x))), direction.z
    )
    return jnp.where(u < 0, u + 1, u), polar / jnp.pi


def lookup(image: Float[Array, "rows columns 3"], u: PixelArray, v: PixelArray) -> Vec:
    """Looks up a bitmap's colour at (u, v): bilinear, wrapped in u, clamped in v.

    The centre of texel (row i, column j) is at u = (j + 1/2) / columns, v = (i + 1/2) / rows.
    """
    rows, columns, _ = image.shape
    x, y = u * columns - 0.5, v * rows - 0.5
    left, top = jnp.floor(jax.lax.stop_gradient(x)), jnp.floor(jax.lax.stop_gradient(y))
    right_weight, lower_weight = x - left, y - top
    j = left.astype(jnp.int32) % columns
    i = top.astype(jnp.int32)
    i0, i1 = jnp.clip(i, 0, rows - 1), jnp.clip(i + 1, 0, rows - 1)
    j1 = (j + 1) % columns

    def texel(i: Ids, j: Ids) -> Vec:
        colors = image[i, j]
        return SplitVec(colors[..., 0], colors[..., 1], colors[..., 2])

    upper = texel(i0, j) * (1 - right_weight) + texel(i0, j1) * right_weight
    lower = texel(i1, j) * (1 - right_weight) + texel(i1, j1) * right_weight
    return upper * (1 - lower_weight) + lower * lower_weight


def texture_color(
    tables: SceneTables, ids: Ids, outward: Vec, images: tuple, pic: tuple[int, ...]
) -> Vec:
    """Returns the texture colour that multiplies an object's colour; white without a texture.

    **Arguments:** `ids`: of the objects. `outward`: outward normals. `images`: bitmaps of
    shape `(rows, columns, 3)`. `pic`: per sphere the number of its texture from 1, 0 for none.
    """
    u, v = sphere_uv(outward)
    one = jnp.ones_like(u)
    factor = SplitVec(one, one, one)
    # the last entry stands for all objects that are not spheres
    table = jnp.asarray((*pic, 0), jnp.int32)
    texture = table[jnp.where(tables.is_sphere(ids), ids.astype(jnp.int32), len(pic))]
    for k in sorted(set(pic) - {0}):
        factor = where(texture == k, lookup(images[k - 1], u, v), factor)
    return factor


def second_square(tables: SceneTables, ids: Ids, point: Vec) -> tuple[Mask, Vec]:
    """Finds points on the second squares of a checker, and the colour of these squares.

    Squares have a corner at the plane's point. Their sides run along the world's x axis projected
    onto the plane, and across it. Where the normal is nearest to x, the y axis replaces the x axis.

    **Returns:** the mask of points on second squares, and the second colour.
    """
    plane, checker = gather_rows((tables.planes, tables.checkers), tables.plane_rows(ids))
    n = jax.lax.stop_gradient(plane.normal)
    near_x_axis = (jnp.abs(n.x) > jnp.abs(n.y)) & (jnp.abs(n.x) > jnp.abs(n.z))
    zero, one = jnp.zeros_like(n.x), jnp.ones_like(n.x)
    axis = where(near_x_axis, SplitVec(zero, one, zero), SplitVec(one, zero, zero))
    tangent = axis - n * dot(axis, n)
    tangent = tangent * (1 / norm(tangent))
    bitangent = cross(n, tangent)
    offset = jax.lax.stop_gradient(point - plane.point)
    size = jax.lax.stop_gradient(checker.size)
    has_checker = tables.is_plane(ids) & (size > 0)
    side = jnp.where(has_checker, size, 1)
    squares = jnp.floor(dot(offset, tangent) / side) + jnp.floor(dot(offset, bitangent) / side)
    return has_checker & (squares % 2 != 0), checker.color
