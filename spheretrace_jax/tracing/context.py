"""`TraceContext`: everything that the tracer's functions share, built once per picture."""

import dataclasses
from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from ..acceleration.accelerator import Accelerator, build_accelerator
from ..acceleration.binning import Visitor
from ..base.types import Ids, Index, PixelArray, Scalar
from ..base.vec import Vec
from ..scene.lights import Lights
from ..scene.needs import Needs
from ..scene.scene import Scene
from ..scene.settings import RenderSettings
from ..xla.barriers import compute_once, compute_pair_once, unknown_one
from ..xla.gather import gather_pixel_rows, gather_rows
from ..xla.loops import UNROLL, loop
from .hit import Hit
from .shapes.plane import Plane
from .shapes.sphere import Sphere
from .tables import Material, PixelTables, SceneTables, build_tables, table_row

T = TypeVar("T")
P = TypeVar("P")

Candidates = Callable[[Visitor, Any, T], T]
"""Lets pixels test some of the spheres: from a visitor, what it is told of pixels, and states."""


class TraceContext(eqx.Module):
    """A scene in tables, the settings of its picture, and what finds its objects."""

    scene: Scene
    tables: SceneTables
    settings: RenderSettings
    accelerator: Accelerator | None  #: finds spheres along rays where there are many
    pixel_tables: PixelTables | None  #: what each pixel sees in place of the tables, for Jacobians
    witness: Scalar  #: a number that XLA does not know; see `xla.barriers.compute_once`

    @property
    def needs(self) -> Needs:
        """Returns what the scene needs computed."""
        return self.settings.needs

    @property
    def dtype(self) -> jnp.dtype:
        """Returns the floating dtype of the picture."""
        return self.scene.dtype

    def compute_once(self, phase: Callable[[], T]) -> T:
        """Returns the value of `phase()`, which XLA computes once (`xla.barriers.compute_once`)."""
        return compute_once(phase, self.witness)

    def compute_pair_once(
        self, phase: Callable[[], tuple[PixelArray, PixelArray]]
    ) -> tuple[PixelArray, PixelArray]:
        """Returns two arrays that XLA computes once (`xla.barriers.compute_pair_once`)."""
        return compute_pair_once(phase, self.witness)

    # -- variants

    def from_row(self, first_row: Int[Array, ""]) -> "TraceContext":
        """Returns the context of a strip of full rows of pixels that starts at `first_row`."""
        if self.accelerator is None:
            return self
        return dataclasses.replace(self, accelerator=self.accelerator.from_row(first_row))

    def of_pixels(self, pixels: Ids) -> "TraceContext":
        """Returns the context of some pixels, by their numbers, of the rows that are computed."""
        if self.accelerator is None:
            return self
        width = self.settings.width
        place = self.accelerator.of_pixels(pixels % width, pixels // width)
        return dataclasses.replace(self, accelerator=place)

    def with_settings(self, **changes: Any) -> "TraceContext":
        """Returns the context with some of its settings changed."""
        return dataclasses.replace(self, settings=dataclasses.replace(self.settings, **changes))

    def with_pixel_tables(self, tables: PixelTables) -> "TraceContext":
        """Returns the context of pixels that have tables of their own."""
        return dataclasses.replace(self, pixel_tables=tables)

    def with_lights(self, lights: Lights) -> "TraceContext":
        """Returns the context with other lights, such as lights that each pixel has for itself.

        It is not accelerated: there are light buffers only for the scene's own lights.
        """
        return eqx.tree_at(lambda c: c.scene.lights, self.unaccelerated(), lights)

    def of_scene(self, scene: Scene) -> "TraceContext":
        """Returns the context of another scene with the same shapes, which is not accelerated."""
        return dataclasses.replace(self.unaccelerated(), scene=scene, tables=build_tables(scene))

    def unaccelerated(self) -> "TraceContext":
        """Returns the context in which every ray looks at every sphere, for rays in any order."""
        return dataclasses.replace(self, accelerator=None)

    def at_pixels(self, places: Ids) -> "TraceContext":
        """Returns the context of the pixels at some places of a flat list."""
        context, lights = self, self.scene.lights
        if self.pixel_tables is not None:
            context = context.with_pixel_tables(self.pixel_tables.at_pixels(places))
        if lights.position.ndim > 2 or lights.color.ndim > 2:
            own = lambda x: x[..., places] if x.ndim > 2 else x
            context = context.with_lights(jax.tree.map(own, lights))
        return context

    # -- rows of the tables, per pixel

    def sphere(self, ids: Ids) -> Sphere:
        """Returns the geometry of the spheres of these numbers; other numbers give any sphere's."""
        if self.pixel_tables is None:
            return gather_rows(self.tables.spheres, ids)
        return gather_pixel_rows(self.pixel_tables.spheres, ids)

    def plane(self, ids: Ids) -> Plane:
        """Returns the geometry of the planes of these numbers."""
        return gather_rows(self.tables.planes, self.tables.plane_rows(ids))

    def curvature(self, ids: Ids) -> PixelArray:
        """Returns 1/R of the spheres of these numbers; of shared tables 1/R is found per sphere."""
        per = lambda radius: 1 / jnp.where(radius > 0, radius, 1)
        if self.pixel_tables is None:
            return gather_rows(per(self.tables.spheres.radius), ids)
        return per(gather_pixel_rows(self.pixel_tables.spheres.radius, ids))

    def curvature_of_hit(self, hit: Hit) -> PixelArray:
        """Returns 1/R of the object that is hit, 0 for a plane."""
        return jnp.where(self.tables.is_sphere(hit.id), self.curvature(hit.id), 0)

    def material(self, ids: Ids, part: Callable[[Material], T]) -> T:
        """Returns a part of the materials of the objects of these numbers."""
        if self.pixel_tables is None:
            return gather_rows(part(self.tables.materials), ids)
        return gather_pixel_rows(part(self.pixel_tables.materials), ids)

    # -- all objects

    def fold(
        self,
        body: Callable[[P, Sphere | Plane, Ids | Index, T], T],
        pixels: P,
        start: T,
        *,
        candidates: Candidates | None = None,
        spheres: bool = True,
        planes: bool = True,
        scale: Scalar | None = None,
        unroll: int = UNROLL,
    ) -> T:
        """Folds `body` over all objects.

        **Arguments:** `body`: from what is known of pixels, an object, its number and a state to
        the next state. `candidates`: visits the spheres that may matter to each pixel, None for
        all of them; spheres then come in any order, those of `shadow_candidates` more than once.
        `spheres`, `planes`: false to leave out a shape that is looked at in another way. `scale`:
        of the objects' lengths, None for 1. `unroll`: loops over at most this many objects are
        written out.
        """
        shapes: list[tuple[Sphere | Plane, int, int]] = []
        if candidates is not None:

            def visit(pixels: P, center: Vec, radius: PixelArray, number: Ids, state: T) -> T:
                sphere, number = Sphere(center, radius), number.astype(self.tables.id_type)
                return body(
                    pixels, sphere if scale is None else sphere.scaled(scale), number, state
                )

            start = candidates(visit, pixels, start)
        elif spheres:
            shapes.append((self.tables.spheres, 0, self.tables.sphere_count))
        if planes and self.needs.planes:
            shapes.append((self.tables.planes, self.tables.sphere_count, self.tables.plane_count))
        for table, first, count in shapes:
            rows = table if scale is None else table.scaled(scale)

            def of_object(i: Index, state: T, rows=rows, first=first) -> T:
                return body(pixels, table_row(rows, i), i + first if first else i, state)

            start = loop(count, of_object, start, unroll)
        return start


def build_context(scene: Scene, settings: RenderSettings, accelerated: bool = True) -> TraceContext:
    """Builds the context of a picture: once per picture, before its rays are traced.

    **Arguments:** `accelerated`: false to have every ray look at every sphere.
    """
    tables, accelerator = build_tables(scene), None
    if accelerated:
        accelerator = build_accelerator(*tables.spheres.bounds(), scene, settings)
    return TraceContext(scene, tables, settings, accelerator, None, unknown_one())
