"""Scene tables: the scene's objects, one row each, as `Vec`s of arrays.

Objects are numbered: spheres first, then planes. The back plane is a plane like the others here,
derived from the camera. A new shape gets a table here and a file with the methods of `Sphere`.
"""

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..base.types import Ids, Index, Mask, PixelArray
from ..base.vec import SplitVec, Vec, unit, vec
from ..scene.camera import view_frame
from ..scene.scene import Scene
from ..xla.gather import smallest_int
from .shapes.plane import Plane
from .shapes.sphere import Sphere

T = TypeVar("T")


class Checker(eqx.Module):
    """The other colour of a plane's squares, and their side, 0 for none."""

    color: Vec
    size: PixelArray


class Material(eqx.Module):
    """The material of objects, in the lecture's letters. Arrays `(objects,)`, or one per pixel."""

    color: Vec
    ka: PixelArray
    kd: PixelArray
    ks: PixelArray
    exponent: PixelArray
    kgr: PixelArray
    kt: PixelArray
    ior: PixelArray


class PixelTables(eqx.Module):
    """Tables that each pixel has for itself: derivatives by them are rows of a picture's Jacobian.

    Arrays of shape `(objects, *pixels)`, or `(1, *pixels)` where each pixel sees only one object.
    Hits are found with the tables that all pixels share.
    """

    spheres: Sphere
    materials: Material

    def row(self, number: Int[Array, "*chunks"]) -> "PixelTables":
        """Returns one object's row as a table; numbers of no such object give some object's row.

        **Arguments:** `number`: an object, or one for each of several chunks of pixels.
        """
        return jax.tree.map(lambda x: x[jnp.minimum(number, len(x) - 1)][None], self)

    def at_pixels(self, places: Ids) -> "PixelTables":
        """Returns the tables of the pixels at some places of a flat list."""
        return jax.tree.map(lambda column: column[:, places], self)


class SceneTables(eqx.Module):
    """The scene's objects in tables of one row per object."""

    spheres: Sphere
    planes: Plane
    materials: Material
    checkers: Checker

    @property
    def sphere_count(self) -> int:
        """Returns the number of spheres."""
        return self.spheres.radius.shape[0]

    @property
    def plane_count(self) -> int:
        """Returns the number of planes, the back plane included."""
        return self.planes.point.x.shape[0]

    @property
    def object_count(self) -> int:
        """Returns the number of objects."""
        return self.sphere_count + self.plane_count

    @property
    def id_type(self) -> jnp.dtype:
        """Returns the smallest type that holds the objects' numbers."""
        return smallest_int(self.object_count)

    def is_sphere(self, ids: Ids) -> Mask:
        """Tests whether objects are spheres; -1, no object, is none."""
        return (ids >= 0) & (ids < self.sphere_count)

    def is_plane(self, ids: Ids) -> Mask:
        """Tests whether objects are planes."""
        return ids >= self.sphere_count

    def plane_rows(self, ids: Ids) -> Ids:
        """Returns the rows of planes in their table, from the numbers of objects."""
        return ids - self.sphere_count

    @property
    def shared(self) -> PixelTables:
        """Returns the tables of which pixels may have their own, as all pixels share them."""
        return PixelTables(self.spheres, self.materials)


def build_tables(scene: Scene) -> SceneTables:
    """Lays out a scene for tracing."""
    s, p, back = scene.spheres, scene.planes, scene.back_plane
    planes = Plane(_columns(p.point), unit(_columns(p.normal)))
    opaque = jnp.zeros_like(p.ka)
    table = Material(_columns(p.color), p.ka, p.kd, p.ks, p.exponent, p.kgr, opaque, p.ior)
    checkers = Checker(_columns(p.checker_color), p.checker_size)
    if back is not None:
        frame, zero = view_frame(scene.camera), jnp.zeros_like(back.ka)
        middle = frame.eye + frame.forward * scene.camera.distance
        planes = _append(planes, Plane(middle, -frame.forward))
        matte = Material(
            vec(back.color), back.ka, back.kd, zero, zero, zero, zero, jnp.ones_like(zero)
        )
        table = _append(table, matte)
        checkers = _append(checkers, Checker(SplitVec(zero, zero, zero), zero))
    material = Material(_columns(s.color), s.ka, s.kd, s.ks, s.exponent, s.kgr, s.kt, s.ior)
    return SceneTables(
        spheres=Sphere(_columns(s.center), s.radius),
        planes=planes,
        materials=jax.tree.map(lambda a, b: jnp.concatenate([a, b]), material, table),
        checkers=checkers,
    )


def table_row(table: T, number: Index) -> T:
    """Returns one row of a table, as scalars."""
    return jax.tree.map(lambda column: column[number], table)


def _columns(array: Float[Array, "rows 3"]) -> Vec:
    return SplitVec(array[:, 0], array[:, 1], array[:, 2])


def _append(table: T, row: T) -> T:
    return jax.tree.map(lambda column, value: jnp.append(column, value), table, row)
