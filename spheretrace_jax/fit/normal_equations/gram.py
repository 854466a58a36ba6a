"""The pixels that show one object each, by moments of their shading.

With the lecture's C = ka A S + sum_l C_l (kd u_l S + ks h_l), u_l = lit N.L and h_l the highlight,
each row of the Jacobian is made of a few planes X = (1, u_l, h_l and their derivatives by the
light's position and the exponent), the same for all channels, with coefficients that are the same
for all of an object's pixels. So J^T J is made of X X^T, summed over these pixels.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ...base.vec import vec, zeros
from ...rendering.render import rays_through, sample_places
from ...scene.scene import Scene
from ...scene.settings import RenderSettings
from ...tracing.material import MOST_LIGHTS, local_color, sum_lights
from ...tracing.path import light_terms_at
from ...tracing.queries import known_hit
from ...tracing.tables import Hit, PixelTables, SceneTables, Surface
from ..model.parameters import GEOMETRY, LIGHTS
from .jacobian_rows import TABLE_COLUMNS
from .parameter_index import ParameterIndex

Gram = Float[Array, "*chunks 3 all all"]
"""For each channel the sums of products of the weighted planes X and the residual."""

Free = dict[str, Any]
"""Values of what is free, by name: of the object, as tables of one row, and of the lights."""


def uses_gram(layout: ParameterIndex, settings: RenderSettings, lights: int) -> bool:
    """Whether they do: pixels are single rays, and colours linear in the planes."""
    fixed = not GEOMETRY & {*layout.spheres, *layout.camera} and layout.exposure is None
    plain = not settings.needs.textures and not settings.needs.checkers
    rays = not settings.antialias and settings.samples == 1
    return fixed and plain and rays and lights <= MOST_LIGHTS


def gram(
    basis: Float[Array, "*chunks size pixels"],
    slope: list[Float[Array, "*chunks pixels"]],
    residual: list[Float[Array, "*chunks pixels"]],
) -> Gram:
    """The moments of some pixels.

    **Arguments:** `slope`: of the residual by the picture, channel by channel.
    """
    size = basis.shape[-2]
    row = lambda plane: plane[..., None, :]
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
    """How the pixels that show one object are coloured.

    For `basis` there may be several objects, each with pixels of its own.
    """

    scene: Scene
    world: SceneTables
    own: PixelTables  #: the object's row
    number: Int[Array, "*chunks"]
    settings: RenderSettings = eqx.field(static=True)
    layout: ParameterIndex = eqx.field(static=True)

    def __init__(
        self,
        scene: Scene,
        world: SceneTables,
        number: Int[Array, "*chunks"],
        settings: RenderSettings,
        layout: ParameterIndex,
    ):
        self.scene, self.world, self.number = scene, world, number
        self.own = world.tables.row(number)
        self.settings, self.layout = settings, layout

    @property
    def by_exponent(self) -> bool:
        return "exponent" in self.layout.spheres

    @property
    def size(self) -> int:
        """How many planes there are."""
        return 1 + (8 + self.by_exponent) * len(self.scene.lights)

    def basis(self, pixels: Int[Array, "*chunks pixels"]) -> Float[Array, "*chunks size pixels"]:
        """The planes: 1, all u, all h, and light by light the derivatives of u, of h by the
        position, and that of h by the exponent.
        """
        settings, dtype = self.settings, self.scene.dtype
        (left,), (top,) = sample_places(self.scene, settings)
        ray = rays_through(self.scene, settings, pixels, left, top)
        world = self.world.with_own(jax.tree.map(lambda x: x[..., None], self.own))
        number = self.number.astype(world.id_type)[..., None]
        id_ = jnp.broadcast_to(number, pixels.shape)
        hit = known_hit(world, ray, id_, settings.needs)
        u, h, slopes = [], [], []
        for k, place in enumerate(self.scene.lights.position):

            def terms(place: Array, exponent: Array, k: int = k) -> tuple[Array, Array]:
                shadows = settings.needs.shadows_of(k)
                return light_terms_at(world, ray, hit, settings, vec(place), shadows, exponent)

            exponent = self.own.materials.exponent[0][..., None]
            by_place = lambda e, at=place, n=exponent, terms=terms: jax.jvp(
                lambda place: terms(place, n), (at,), (e,)
            )
            value, slope = jax.vmap(by_place, out_axes=(None, 0))(jnp.eye(3, dtype=dtype))
            u.append(value[0])
            h.append(value[1])
            slopes += [*slope[0], *slope[1]]
            if self.by_exponent:
                by = lambda n, at=place, terms=terms: terms(at, n)[1]
                slopes.append(jax.jvp(by, (exponent,), (jnp.ones_like(exponent),))[1])
        return jnp.stack([jnp.ones(pixels.shape, dtype), *u, *h, *slopes], axis=-2)

    def factors(self, free: Free | None = None) -> Float[Array, "3 terms"]:
        """Colours are these times the first planes: 1, all u and all h.

        **Arguments:** `free`: other values of what is free.
        """
        free = self._free() if free is None else free
        columns = {name: x for name, x in free.items() if name in TABLE_COLUMNS}
        own, scene = self.own, self.scene
        if columns:
            at_own = lambda own: [TABLE_COLUMNS[name](own) for name in columns]
            own = eqx.tree_at(at_own, own, list(columns.values()))
        if "light_color" in free:
            scene = eqx.tree_at(lambda s: s.lights.color, scene, free["light_color"])
        world, needs = self.world.with_own(own), self.settings.needs
        hit = Hit(self.number.astype(world.id_type), jnp.array(False))
        nothing = zeros((), scene.dtype)
        nowhere = Surface(nothing, nothing, nothing.x)  # textures, which ask where, there are none

        def color(terms: Float[Array, "2 lights"]) -> Float[Array, " 3"]:
            light_by_light = iter(terms.T)
            sums = sum_lights(scene, (), needs, lambda *_: tuple(next(light_by_light)))
            seen = local_color(scene, world, hit, nowhere, needs, sums)
            return jnp.stack([seen.x, seen.y, seen.z])

        dark = jnp.zeros((2, len(scene.lights)), scene.dtype)
        return jnp.concatenate([color(dark)[:, None], jax.jacrev(color)(dark).reshape(3, -1)], 1)

    def _free(self) -> Free:
        """The values of what is free, in the order of `Layout.each`."""
        own = {name: TABLE_COLUMNS[name](self.own) for name in self.layout.spheres}
        return own | {name: LIGHTS[name](self.scene) for name in self.layout.lights}

    def by_columns(
        self, sums: Gram
    ) -> tuple[Float[Array, "columns columns"], Float[Array, " columns"], Float[Array, ""]]:
        """J^T J, J^T r and the cost of the object's pixels."""
        ways = self._ways()
        inner = jnp.einsum("acx,cxy->acy", ways, sums[:, :-1, :-1])
        square = jnp.einsum("acy,bcy->ab", inner, ways)
        gradient = jnp.einsum("acx,cx->a", ways, sums[:, :-1, -1])
        return square, gradient, jnp.sum(sums[:, -1, -1]) / 2

    def _ways(self) -> Float[Array, "columns 3 size"]:
        """The rows of the Jacobian are these times the planes; columns as in `Layout.each`."""
        start, count = self._free(), len(self.scene.lights)

        def coefficients(free: Free) -> Float[Array, "3 size"]:
            """Those of the planes, of which the slopes have some as what is free moves."""
            factors = self.factors(free)
            u, h = factors[:, 1 : 1 + count, None], factors[:, 1 + count :, None]
            moved = {name: x - lax.stop_gradient(start[name]) for name, x in free.items()}
            places = moved.get("light_position", jnp.zeros((count, 3), factors.dtype))[None]
            each = [u * places, h * places]
            if self.by_exponent:
                each.append(h * moved["exponent"][None, None])
            slopes = jnp.concatenate(each, axis=2).reshape(3, -1)
            return jnp.concatenate([factors, slopes], axis=1)

        by = jax.jacrev(coefficients)(start)
        parts = [x.reshape(3, self.size, -1) for name in start for x in jax.tree.leaves(by[name])]
        none = jnp.zeros((3, self.size, 0), self.scene.dtype)
        return jnp.moveaxis(jnp.concatenate([none, *parts], axis=2), 2, 0)
