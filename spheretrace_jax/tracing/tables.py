"""`World`: a scene laid out for tracing. Objects are numbered: spheres first, then planes.

The back plane is a plane like the others here, derived from the camera.
"""

from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..acceleration.accelerator import Accelerator
from ..base.safe_math import larger, safe_sqrt, smaller
from ..base.types import Ids, Mask, PixelArray, Scalar
from ..base.vec import Vec, dot, norm, unit, vec, where
from ..scene.camera import Ray, view_frame
from ..scene.needs import Needs
from ..scene.scene import Scene
from ..xla.gather import gather_pixel_rows, gather_rows, smallest_int
from .intersect import perpendicular

T = TypeVar("T")


class SphereGeometry(eqx.Module):
    """Where a sphere is. Arrays of shape `(n,)`, or planes once fetched per pixel."""

    center: Vec
    radius: PixelArray


class PlaneGeometry(eqx.Module):
    """Where a plane is; `normal` of unit length. Arrays of shape `(p,)`, or planes."""

    point: Vec
    normal: Vec


class Checker(eqx.Module):
    """The other colour of a plane's squares and their side, 0 for none."""

    color: Vec
    size: PixelArray


class Material(eqx.Module):
    """What an object is made of, in the lecture's letters. Arrays `(objects,)`, or planes."""

    color: Vec
    ka: PixelArray
    kd: PixelArray
    ks: PixelArray
    exponent: PixelArray
    kgr: PixelArray
    kt: PixelArray


class Hit(eqx.Module):
    """The discrete half of what a ray meets; it has no derivative."""

    id: Ids  #: which object, -1 for none
    inside: Mask  #: whether it is a sphere seen from inside


class Surface(eqx.Module):
    """The smooth half of what a ray meets: differentiable in the scene."""

    point: Vec  #: P
    normal: Vec  #: N, of unit length, turned to the viewer
    facing: PixelArray  #: N.V, at least 0


class PixelTables(eqx.Module):
    """Tables of each pixel's own: derivatives by them are the rows of a picture's Jacobian.

    Arrays of shape `(objects, *pixels)`, or `(1, *pixels)` where each pixel sees only one object.
    What is discrete is found with the tables that all pixels share.
    """

    balls: SphereGeometry
    materials: Material

    def row(self, number: Int[Array, "*chunks"]) -> "PixelTables":
        """One object's row, as a table; others' numbers give some object's.

        Of several numbers the tables of one row of as many chunks of pixels.
        """
        return jax.tree.map(lambda x: x[jnp.minimum(number, len(x) - 1)][None], self)

    def at(self, places: Ids) -> "PixelTables":
        """The tables of the pixels at some places of a flat list."""
        return jax.tree.map(lambda column: column[:, places], self)


class SceneTables(eqx.Module):
    """The scene's objects in tables of one row per object, as `Vec`s of arrays."""

    balls: SphereGeometry
    flats: PlaneGeometry
    materials: Material
    checkers: Checker
    window: Scalar
    lists: Accelerator | None = None  #: where to look for spheres if there are many
    own: PixelTables | None = None  #: what each pixel sees in place of the tables, for Jacobians

    def listed(self, lists: Accelerator | None) -> "SceneTables":
        """The world with the lists of a picture, if it has any."""
        return eqx.tree_at(lambda w: w.lists, self, lists, is_leaf=lambda x: x is None)

    def of_strip(self, first_row: Int[Array, ""]) -> "SceneTables":
        """The world seen by a strip of full rows of pixels from one on."""
        if self.lists is None:
            return self
        return eqx.tree_at(lambda w: w.lists, self, self.lists.from_row(first_row))

    @property
    def tables(self) -> PixelTables:
        """What pixels may have of their own, as all share it."""
        return PixelTables(self.balls, self.materials)

    def with_own(self, own: PixelTables) -> "SceneTables":
        """The world of pixels that have tables of their own."""
        return eqx.tree_at(lambda w: w.own, self, own, is_leaf=lambda x: x is None)

    @property
    def spheres(self) -> int:
        return self.balls.radius.shape[0]

    @property
    def planes(self) -> int:
        return self.flats.point.x.shape[0]

    @property
    def id_type(self) -> jnp.dtype:
        """The smallest type that holds the objects' numbers."""
        return smallest_int(self.spheres + self.planes)

    def ball(self, ids: Ids) -> SphereGeometry:
        """Where the spheres of these numbers are; others' are some sphere's."""
        return (
            gather_rows(self.balls, ids)
            if self.own is None
            else gather_pixel_rows(self.own.balls, ids)
        )

    def curvature(self, ids: Ids) -> PixelArray:
        """1/R of the spheres of these numbers; divided per sphere, which is seldom per pixel."""
        per = lambda radius: 1 / jnp.where(radius > 0, radius, 1)
        if self.own is None:
            return gather_rows(per(self.balls.radius), ids)
        return per(gather_pixel_rows(self.own.balls.radius, ids))

    def material(self, ids: Ids, part: Callable[[Material], T]) -> T:
        """A part of what the objects of these numbers are made of."""
        if self.own is None:
            return gather_rows(part(self.materials), ids)
        return gather_pixel_rows(part(self.own.materials), ids)

    def flat(self, ids: Ids) -> PlaneGeometry:
        """Where the planes of these numbers are."""
        return gather_rows(self.flats, ids - self.spheres)


def _columns(array: Float[Array, "rows 3"]) -> Vec:
    return Vec(array[:, 0], array[:, 1], array[:, 2])


def build_tables(scene: Scene) -> SceneTables:
    """Lays out a scene for tracing."""
    s, p, back = scene.spheres, scene.planes, scene.back_plane
    flats = PlaneGeometry(_columns(p.point), unit(_columns(p.normal)))
    table = Material(_columns(p.color), p.ka, p.kd, p.ks, p.exponent, p.kgr, jnp.zeros_like(p.ka))
    checkers = Checker(_columns(p.checker_color), p.checker_size)
    if back is not None:
        frame, zero = view_frame(scene.camera), jnp.zeros_like(back.ka)
        middle = frame.eye + frame.forward * scene.camera.distance
        flats = _append(flats, PlaneGeometry(middle, -frame.forward))
        matte = Material(vec(back.color), back.ka, back.kd, zero, zero, zero, zero)
        table = _append(table, matte)
        checkers = _append(checkers, Checker(Vec(zero, zero, zero), zero))
    material = Material(_columns(s.color), s.ka, s.kd, s.ks, s.exponent, s.kgr, s.kt)
    return SceneTables(
        balls=SphereGeometry(_columns(s.center), s.radius),
        flats=flats,
        materials=jax.tree.map(lambda a, b: jnp.concatenate([a, b]), material, table),
        checkers=checkers,
        window=scene.camera.window,
    )


def _append(table: T, row: T) -> T:
    """A table with one more row."""
    return jax.tree.map(lambda column, value: jnp.append(column, value), table, row)


def surface_at(world: SceneTables, ray: Ray, hit: Hit, needs: Needs) -> Surface:
    """The point and normal at which rays meet the objects they are known to hit.

    With q the perpendicular from the ray to the centre and h half the chord, the hit point seen
    from the centre is w = -q - h D (from inside -q + h D): no root near zero is ever subtracted,
    so N = w/R is exact for the smallest and the largest sphere. It follows that N.V = h/R.

    **Returns:** a `Surface`; where a ray hits nothing its numbers are finite but mean nothing.
    """
    ball = world.ball(hit.id)
    _, q = perpendicular(ray.origin, ray.direction, ball.center)
    half_chord = safe_sqrt(ball.radius * ball.radius - dot(q, q))
    return _surface(world, ray, hit, needs, ball, q, half_chord, None)


def mean_surface_at(
    world: SceneTables, ray: Ray, q: Vec, hit: Hit, needs: Needs, reach: PixelArray
) -> Surface:
    """The mean surface of the part of a pixel that an object covers, for rays that may just miss.

    Its normal is the mean of the normals, as Lambert's term, being linear, needs it: of unit length
    unless the sphere is as small as the pixel.

    **Arguments:** `q`: the perpendicular from the ray to the sphere's centre. `reach`: how far |q|,
    or for planes D.N, varies from the pixel's centre to its border.
    """
    ball = world.ball(hit.id)
    half_chord, q = mean_chord(q, ball.radius, reach)
    return _surface(world, ray, hit, needs, ball, q, half_chord, reach)


def _surface(
    world: SceneTables,
    ray: Ray,
    hit: Hit,
    needs: Needs,
    ball: SphereGeometry,
    q: Vec,
    half_chord: PixelArray,
    reach: PixelArray | None,
) -> Surface:
    per_radius = world.curvature(hit.id)
    facing = half_chord * per_radius
    if needs.inside:
        half_chord = jnp.where(hit.inside, -half_chord, half_chord)
        per_radius = jnp.where(hit.inside, -per_radius, per_radius)
    w = -q - ray.direction * half_chord
    on_sphere = Surface(ball.center + w, w * per_radius, facing)
    if not needs.planes:
        return on_sphere
    on_plane = _on_plane(world, ray, hit, reach)
    is_plane = hit.id >= world.spheres
    return where(is_plane, on_plane, on_sphere)


def mean_chord(q: Vec, radius: PixelArray, reach: PixelArray) -> tuple[PixelArray, Vec]:
    """The mean of half the chord, and of q, over |q| +- reach as far as it is inside the sphere."""
    square = dot(q, q)
    outer = safe_sqrt(square + reach * reach)
    shrink = smaller(radius / jnp.where(outer > 0, outer, 1), 1)
    half_chord = mean_root(*chord_range(q, radius, reach))
    # the mean of unit normals is no longer than 1: highlights of a longer one explode
    length = safe_sqrt(square * shrink * shrink + half_chord * half_chord)
    short = smaller(radius / jnp.where(length > 0, length, 1), 1)
    return half_chord * short, q * (shrink * short)


def chord_range(q: Vec, radius: PixelArray, reach: PixelArray) -> tuple[PixelArray, PixelArray]:
    """The least and the largest half chord over |q| +- reach, as far as it is inside the sphere."""
    length, square = norm(q), radius * radius
    near, far = larger(length - reach, 0), length + reach
    # a pixel that only its corner touches has a little of the rim
    least = 0.1 * radius * smaller(reach, radius)
    return safe_sqrt(square - far * far), safe_sqrt(larger(square - near * near, least))


def mean_root(low: PixelArray, high: PixelArray) -> PixelArray:
    """The mean of a number whose square is spread evenly from low^2 to high^2.

    So is half the chord's over a disc, the root of R^2 - q.q.
    """
    both = jnp.where(low + high > 0, low + high, 1)
    return (low * low + low * high + high * high) / both * (2 / 3)


def _on_plane(world: SceneTables, ray: Ray, hit: Hit, reach: PixelArray | None) -> Surface:
    flat = world.flat(hit.id)
    slope = dot(ray.direction, flat.normal)
    away = dot(flat.point - ray.origin, flat.normal)
    if reach is not None:  # the mean of the slopes that meet the plane
        side = jnp.where(away < 0, -1, 1).astype(slope.dtype)
        low = larger(slope * side - reach, 0)
        slope = side * (low + larger(slope * side + reach, 0.1 * reach)) / 2
    crosses = (slope != 0) & (hit.id >= world.spheres)
    t = away / jnp.where(crosses, slope, 1)
    point = ray.origin + ray.direction * jnp.where(crosses, t, 0)
    if reach is not None:
        point = point + flat.normal * dot(flat.point - point, flat.normal)
    return Surface(
        point, flat.normal * jnp.where(slope > 0, -1, 1).astype(slope.dtype), jnp.abs(slope)
    )
