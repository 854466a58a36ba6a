"""Gram matrices of linear shading: the normal equations of pixels that show one object each.

With the lecture's C = ka A S + sum_l C_l (kd u_l S + ks h_l), u_l = lit N.L and h_l the highlight,
each row of the Jacobian is made of a few numbers per pixel, X = (1, u_l, h_l and their derivatives
by the light's position and the exponent), the same for all channels. Their coefficients are the
same for all of an object's pixels. So J^T J is made of X X^T, summed over these pixels.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ...base.vec import vec, zeros
from ...rendering.samples import sample_positions, sample_rays
from ...scene.settings import RenderSettings
from ...tracing.context import TraceContext
from ...tracing.hit import Hit, Surface
from ...tracing.material import MOST_LIGHTS, local_color, sum_lights
from ...tracing.path import light_terms_at
from ...tracing.queries import known_hit
from ...tracing.tables import PixelTables
from ..model.parameters import GEOMETRY, LIGHTS
from .jacobian_rows import TABLE_COLUMNS
from .parameter_index import ParameterIndex

Gram = Float[Array, "*chunks 3 all all"]
"""For each channel the sums of products of the weighted numbers X and the residual."""

Free = dict[str, Any]
"""Values of what is free, by name: of the object, as tables of one row, and of the lights."""


def uses_gram(index: ParameterIndex, settings: RenderSettings, lights: int) -> bool:
    """Tests whether Gram matrices do: pixels are single rays, and colours linear in X."""
    fixed = not GEOMETRY & {*index.spheres, *index.camera} and index.exposure is None
    plain = not settings.needs.textures and not settings.needs.checkers
    rays = not settings.antialias and settings.samples == 1
    return fixed and plain and rays and lights <= MOST_LIGHTS


def gram(
    basis: Float[Array, "*chunks size pixels"],
    slope: list[Float[Array, "*chunks pixels"]],
    residual: list[Float[Array, "*chunks pixels"]],
) -> Gram:
    """Returns the Gram matrices of some pixels.

    **Arguments:** `basis`: X. `slope`: of the residual by the picture, channel by channel.
    """
    size = basis.shape[-2]
    row = lambda numbers: numbers[..., None, :]
    squared = lambda rows: rows @ jnp.swapaxes(rows, -1, -2)

    def each() -> Gram:
        of = lambda s, r: squared(jnp.concatenate([row(s) * basis, row(r)], axis=-2))
        return jnp.stack([of(s, r) for s, r in zip(slope, residual, strict=True)], axis=-3)

    def alike() -> Gram:
        square = squared(jnp.concatenate([row(slope[0]) * basis, *map(row, residual)], axis=-2))
        at = [jnp.array([*range(size), size + c]) for c in range(3)]
        return jnp.stack([square[..., i[:, None], i[None, :]] for i in at], axis=-3)

    # where nothing is clipped or masked in some channels only, one product does
    same = (slope[1] == slope[0]) & (slope[2] == slope[0])
    return lax.cond(jnp.all(same), alike, each)


class LinearShading(eqx.Module):
    """The colours of the pixels that show one object, as linear functions of X.

    For `basis` there may be several objects, each with pixels of its own.
    """

    context: TraceContext
    row: PixelTables  #: the object's
    number: Int[Array, "*chunks"]
    index: ParameterIndex = eqx.field(static=True)

    def __init__(self, context: TraceContext, number: Int[Array, "*chunks"], index: ParameterIndex):
        self.context, self.number, self.index = context, number, index
        self.row = context.tables.shared.row(number)

    @property
    def by_exponent(self) -> bool:
        """Tests whether exponents are free."""
        return "exponent" in self.index.spheres

    @property
    def size(self) -> int:
        """Returns how many numbers X has for each pixel."""
        return 1 + (8 + self.by_exponent) * len(self.context.scene.lights)

    def basis(self, pixels: Int[Array, "*chunks pixels"]) -> Float[Array, "*chunks size pixels"]:
        """Returns X: 1, all u, all h, and light by light the derivatives of u and of h by the
        position, and that of h by the exponent.
        """
        scene, settings = self.context.scene, self.context.settings
        (left,), (top,) = sample_positions(scene, settings)
        ray = sample_rays(scene, settings, pixels, left, top)
        tables = jax.tree.map(lambda x: x[..., None], self.row)
        context = self.context.with_pixel_tables(tables)
        number = self.number.astype(context.tables.id_type)[..., None]
        hit = known_hit(context, ray, jnp.broadcast_to(number, pixels.shape))
        u, h, slopes = [], [], []
        for k, place in enumerate(scene.lights.position):

            def terms(place: Array, exponent: Array, k: int = k) -> tuple[Array, Array]:
                shadows = settings.needs.shadows_of(k)
                return light_terms_at(context, ray, hit, vec(place), shadows, exponent)

            exponent = self.row.materials.exponent[0][..., None]
            by_place = lambda e, at=place, n=exponent, terms=terms: jax.jvp(
                lambda place: terms(place, n), (at,), (e,)
            )
            identity = jnp.eye(3, dtype=scene.dtype)
            value, slope = jax.vmap(by_place, out_axes=(None, 0))(identity)
            u.append(value[0])
            h.append(value[1])
            slopes += [*slope[0], *slope[1]]
            if self.by_exponent:
                by = lambda n, at=place, terms=terms: terms(at, n)[1]
                slopes.append(jax.jvp(by, (exponent,), (jnp.ones_like(exponent),))[1])
        return jnp.stack([jnp.ones(pixels.shape, scene.dtype), *u, *h, *slopes], axis=-2)

    def factors(self, free: Free | None = None) -> Float[Array, "3 terms"]:
        """Returns the factors of 1, all u and all h, whose sum the colours are.

        **Arguments:** `free`: other values of what is free.
        """
        free = self._free() if free is None else free
        columns = {name: x for name, x in free.items() if name in TABLE_COLUMNS}
        row, scene = self.row, self.context.scene
        if columns:
            at_columns = lambda row: [TABLE_COLUMNS[name](row) for name in columns]
            row = eqx.tree_at(at_columns, row, list(columns.values()))
        context = self.context.with_pixel_tables(row)
        if "light_color" in free:
            lights = eqx.tree_at(lambda lights: lights.color, scene.lights, free["light_color"])
            context = context.with_lights(lights)
        hit = Hit(self.number.astype(context.tables.id_type), jnp.array(False))
        nothing = zeros((), scene.dtype)
        nowhere = Surface(nothing, nothing, nothing.x)  # textures, which ask where, there are none

        def color(terms: Float[Array, "2 lights"]) -> Float[Array, " 3"]:
            light_by_light = iter(terms.T)
            sums = sum_lights(context, (), lambda *_: tuple(next(light_by_light)))
            seen = local_color(context, hit, nowhere, sums)
            return jnp.stack([seen.x, seen.y, seen.z])

        dark = jnp.zeros((2, len(scene.lights)), scene.dtype)
        return jnp.concatenate([color(dark)[:, None], jax.jacrev(color)(dark).reshape(3, -1)], 1)

    def _free(self) -> Free:
        """Returns the values of what is free, in the order of `ParameterIndex.each`."""
        row = {name: TABLE_COLUMNS[name](self.row) for name in self.index.spheres}
        return row | {name: LIGHTS[name](self.context.scene) for name in self.index.lights}

    def by_columns(
        self, sums: Gram
    ) -> tuple[Float[Array, "columns columns"], Float[Array, " columns"], Float[Array, ""]]:
        """Returns J^T J, J^T r and the cost of the object's pixels."""
        coefficients = self._coefficients()
        inner = jnp.einsum("acx,cxy->acy", coefficients, sums[:, :-1, :-1])
        square = jnp.einsum("acy,bcy->ab", inner, coefficients)
        gradient = jnp.einsum("acx,cx->a", coefficients, sums[:, :-1, -1])
        return square, gradient, jnp.sum(sums[:, -1, -1]) / 2

    def _coefficients(self) -> Float[Array, "columns 3 size"]:
        """Returns what the rows of J are as multiples of X; columns as in `ParameterIndex.each`."""
        start, count = self._free(), len(self.context.scene.lights)

        def of_free(free: Free) -> Float[Array, "3 size"]:
            """Returns the coefficients of X; its derivatives have some as what is free moves."""
            factors = self.factors(free)
            u, h = factors[:, 1 : 1 + count, None], factors[:, 1 + count :, None]
            moved = {name: x - lax.stop_gradient(start[name]) for name, x in free.items()}
            places = moved.get("light_position", jnp.zeros((count, 3), factors.dtype))[None]
            each = [u * places, h * places]
            if self.by_exponent:
                each.append(h * moved["exponent"][None, None])
            slopes = jnp.concatenate(each, axis=2).reshape(3, -1)
            return jnp.concatenate([factors, slopes], axis=1)

        by = jax.jacrev(of_free)(start)
        parts = [x.reshape(3, self.size, -1) for name in start for x in jax.tree.leaves(by[name])]
        none = jnp.zeros((3, self.size, 0), self.context.dtype)
        return jnp.moveaxis(jnp.concatenate([none, *parts], axis=2), 2, 0)
