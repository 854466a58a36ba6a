"""Linear shading: colours as linear functions of a few numbers for each shading sample.

With the lecture's C = ka A S + sum_l C_l (kd u_l S + ks h_l), u_l = lit N.L and h_l the highlight,
both as the light's distance leaves them, a sample's colour is linear in X = (1, u_l, h_l), with
factors that are the same for all samples of an object. So are its derivatives: X, the derivatives
of u_l and h_l by the light's position, that of h_l by the exponent, and that of u_l by the coat's
index of refraction, are all that a step
evaluates.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.types import Ids, Index, PixelArray
from ...base.vec import Vec, components, grey, where, zeros
from ...scene.light import Light, make_light, map_lights
from ...scene.parameters import LIGHT_PLACES
from ...tracing.context import TraceContext
from ...tracing.hit import Hit, Surface
from ...tracing.material import MOST_LIGHTS, finish_of, local_color, sum_lights
from ...tracing.shading import Finish
from ...xla.loops import loop
from .jacobian_rows import TABLE_COLUMNS
from .parameter_index import ParameterIndex

Terms = Callable[[Light, bool, Finish], tuple[PixelArray, PixelArray]]
"""From a light, whether it may be blocked, and finishes, to u and h of samples."""

Basis = Float[Array, "_ _ ..."]
"""The numbers of samples; one channel stands for all three where nothing is tinted."""


class LinearShading(eqx.Module):
    """What colours and their derivatives are made of.

    The numbers of a sample, its basis: 1, all u, all h (these are X); the derivatives of all h by
    the exponent, and of all u by the index of refraction (with X these make up the columns of the
    object); then, light by light, the derivatives of all u by the position, and those of all h.
    """

    context: TraceContext
    index: ParameterIndex = eqx.field(static=True)

    @property
    def lights(self) -> int:
        """Returns the number of lights."""
        return len(self.context.scene.lights)

    @property
    def shines(self) -> bool:
        """Tells whether there are highlights."""
        return self.context.needs.highlights

    @property
    def linear(self) -> int:
        """Returns the size of X."""
        return 1 + (1 + self.shines) * self.lights

    @property
    def finishes(self) -> dict[str, int]:
        """Returns the parameters of finishes that are free and show.

        With the place in X of the terms, light by light, whose factors are those of their columns.
        """
        needed = {"exponent": self.shines, "ior": self.context.needs.coated}
        terms = {"exponent": 1 + self.lights, "ior": 1}
        return {n: terms[n] for n in terms if needed[n] and n in self.index.spheres}

    @property
    def own(self) -> int:
        """Returns how many of the numbers make up the columns of an object."""
        return self.linear + self.lights * len(self.finishes)

    @property
    def by_position(self) -> int:
        """Returns how many numbers the lights' positions and directions have, if any is free."""
        return 3 * self.lights if set(LIGHT_PLACES) & set(self.index.lights) else 0

    @property
    def numbers(self) -> int:
        """Returns how many numbers a sample has."""
        return self.own + (1 + self.shines) * self.by_position

    def basis(self, ids: Ids, terms: Terms, tint: Vec | None) -> Basis:
        """Returns the numbers of samples. **Arguments:** `ids`: of the objects that they show."""
        context, lights = self.context, self.context.scene.lights
        finish, needs = finish_of(context, ids), context.needs
        none = jnp.zeros((0, *ids.shape), context.dtype)

        def of_light(
            place: Float[Array, " 3"], falloff: PixelArray, directional: bool, shadows: bool
        ) -> tuple[Float[Array, "_ ..."], ...]:
            fades = falloff if needs.falloff else None
            of = lambda place, finish: terms(make_light(place, fades, directional), shadows, finish)
            return self._of_light(of, place, finish, none)

        if self.lights <= MOST_LIGHTS:
            flags = [needs.shadows_of(k) for k in range(self.lights)]
            rows = zip(lights.position, lights.falloff, lights.directional, flags, strict=True)
            each = [of_light(*row) for row in rows]
            parts = [jnp.concatenate(x) for x in zip(*each, strict=True)]
        else:
            each = map_lights(partial(of_light, shadows=needs.shadows), lights)
            parts = [x.reshape(-1, *ids.shape) for x in each]
        one = jnp.ones((1, *ids.shape), context.dtype)
        u, h, by_exponent, by_ior, u_slope, h_slope = parts or [none] * 6
        u = jnp.concatenate([one, u])
        channels = [one] if tint is None else [t[None] for t in components(tint)]
        numbers = [(u * t, h, by_exponent, by_ior * t, u_slope * t, h_slope) for t in channels]
        return jnp.stack([jnp.concatenate(x) for x in numbers])

    def _of_light(
        self,
        terms: Callable[[Float[Array, " 3"], Finish], tuple[PixelArray, PixelArray]],
        place: Float[Array, " 3"],
        finish: Finish,
        none: Float[Array, "0 ..."],
    ) -> tuple[Float[Array, "_ ..."], ...]:
        """Returns of one light u, h, h by the exponent, u by the index, and both by the position.

        **Arguments:** `none`: for what is not needed.
        """
        at = lambda place: terms(place, finish)
        if self.by_position:
            by = lambda step: jax.jvp(at, (place,), (step,))
            steps = jnp.eye(3, dtype=place.dtype)
            (u, h), (u_slope, h_slope) = jax.vmap(by, out_axes=(None, 0))(steps)
        else:
            (u, h), u_slope, h_slope = at(place), none, none
        by_exponent = by_ior = none
        if "exponent" in self.finishes and (n := finish.exponent) is not None:
            of = lambda n: terms(place, finish._replace(exponent=n))[1]
            by_exponent = jax.jvp(of, (n,), (jnp.ones_like(n),))[1][None]
        if "ior" in self.finishes and (n := finish.ior) is not None:
            of = lambda n: terms(place, finish._replace(ior=n))[0]
            by_ior = jax.jvp(of, (n,), (jnp.ones_like(n),))[1][None]
        h, h_slope = (h[None], h_slope) if self.shines else (none, none)
        return u[None], h, by_exponent, by_ior, u_slope, h_slope

    def seen(self, basis: Basis, factors: Float[Array, "3 x ..."]) -> Float[Array, "3 ..."]:
        """Returns the colours of samples. **Arguments:** `factors`: of the samples' objects."""
        # term by term: a sum over an axis so short takes XLA five times as long
        term = lambda i: factors[:, i] * basis[:, i]
        return loop(self.linear - 1, lambda i, total: total + term(i + 1), term(0))

    def light_columns(
        self, basis: Basis, factors: Float[Array, "3 x ..."]
    ) -> Float[Array, "3 positions ..."]:
        """Returns the derivatives of the colours by the lights' positions."""
        slopes, count = basis[:, self.own :], self.by_position
        if not count:
            return jnp.zeros((3, *slopes.shape[1:]), slopes.dtype)
        of_lights = lambda first: jnp.repeat(factors[:, first : first + self.lights], 3, axis=1)
        columns = of_lights(1) * slopes[:, :count]
        return columns + of_lights(1 + self.lights) * slopes[:, count:] if self.shines else columns

    # -- of objects

    def factors(self, number: Index, free: dict[str, Any] | None = None) -> Float[Array, "3 x"]:
        """Returns the factors of X of one object; those of the background are 1 and 0.

        What textures, planes and the background say is in the samples' tint.

        **Arguments:** `free`: other values of what is free: of the object, and the lights' colours.
        """
        scene, free = self.context.scene, {} if free is None else free
        needs = dataclasses.replace(self.context.needs, textures=False, checkers=False)
        context = self.context.with_settings(needs=needs)
        row = context.tables.shared.row(jnp.asarray(number, jnp.int32))
        is_plane, materials = context.tables.is_plane(jnp.asarray(number)), row.materials
        color = where(is_plane, grey(jnp.ones_like(materials.ka)), materials.color)
        row = eqx.tree_at(lambda r: r.materials.color, row, color)
        if names := [name for name in free if name in TABLE_COLUMNS]:
            at = lambda row: [TABLE_COLUMNS[name](row) for name in names]
            row = eqx.tree_at(at, row, [free[name] for name in names])
        context = context.with_pixel_tables(row)
        if "light_color" in free:
            lights = eqx.tree_at(lambda lights: lights.color, scene.lights, free["light_color"])
            context = context.with_lights(lights)
        hit = Hit(jnp.asarray(number, context.tables.id_type), jnp.array(False))
        nothing = zeros((), scene.dtype)
        nowhere = Surface(nothing, nothing, nothing.x)

        def color_of(terms: Float[Array, "2 lights"]) -> Float[Array, " 3"]:
            light_by_light = iter(terms.T)
            most = self.lights
            sums = sum_lights(context, (), lambda *_: tuple(next(light_by_light)), most)
            return jnp.stack(components(local_color(context, hit, nowhere, sums)))

        dark = jnp.zeros((2, self.lights), scene.dtype)
        by_terms = jax.jacrev(color_of)(dark)[:, : 1 + self.shines].reshape(3, -1)
        factors = jnp.concatenate([color_of(dark)[:, None], by_terms], axis=1)
        background = jnp.zeros_like(factors).at[:, 0].set(1)
        return jnp.where(number < context.tables.object_count, factors, background)

    def all_factors(self) -> Float[Array, "objects 3 x"]:
        """Returns the factors of all objects and of the background."""
        numbers = jnp.arange(self.context.tables.object_count + 1, dtype=jnp.int32)
        return jax.vmap(self.factors)(numbers)

    def sphere_columns(self) -> tuple[Float[Array, "3 spheres own columns"], np.ndarray]:
        """Returns what the columns of each sphere are as multiples of its numbers.

        And the columns' places among all free parameters, `(spheres, columns)`.
        """
        others = {"kgr", "kt", "exponent", "ior"}
        names = [name for name in self.index.spheres if name not in others]
        count = self.context.tables.sphere_count
        numbers = jnp.arange(count, dtype=jnp.int32)

        def of_sphere(number: Index) -> Float[Array, "3 own columns"]:
            row = self.context.tables.shared.row(jnp.asarray(number))
            start = {name: TABLE_COLUMNS[name](row) for name in names}
            by = jax.jacrev(lambda free: self.factors(number, free))(start) if names else {}
            leaves = [leaf for name in names for leaf in jax.tree.leaves(by[name])]
            parts = [leaf.reshape(3, self.linear, -1) for leaf in leaves]
            none = jnp.zeros((3, self.linear, 0), self.context.dtype)
            columns = jnp.concatenate([none, *parts], axis=2)
            columns = jnp.pad(columns, ((0, 0), (0, self.own - self.linear), (0, 0)))
            factors, at = self.factors(number), self.linear
            for name in last:
                column = jnp.zeros((3, self.own, 1), columns.dtype)
                if name in self.finishes:
                    first = self.finishes[name]
                    of_terms = factors[:, first : first + self.lights, None]
                    column = column.at[:, at : at + self.lights].set(of_terms)
                    at += self.lights
                columns = jnp.concatenate([columns, column], axis=2)
            return columns

        last = [name for name in ("exponent", "ior") if name in self.index.spheres]
        places = [self.index.spheres[name].reshape(count, -1) for name in (*names, *last)]
        places = np.concatenate([np.zeros((count, 0), int), *places], axis=1)
        return jnp.moveaxis(jax.vmap(of_sphere)(numbers), 0, 1), places

    def color_columns(self) -> Float[Array, "3 objects own columns"]:
        """Returns what the columns of the lights' colours are as multiples of objects' numbers."""
        objects = self.context.tables.object_count + 1
        if "light_color" not in self.index.lights:
            return jnp.zeros((3, objects, self.own, 0), self.context.dtype)
        colors = self.context.scene.lights.color

        def of_object(number: Index) -> Float[Array, "3 own columns"]:
            by = jax.jacrev(lambda c: self.factors(number, {"light_color": c}))(colors)
            return jnp.pad(
                by.reshape(3, self.linear, -1), ((0, 0), (0, self.own - self.linear), (0, 0))
            )

        return jnp.moveaxis(jax.vmap(of_object)(jnp.arange(objects, dtype=jnp.int32)), 0, 1)
