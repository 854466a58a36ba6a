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

from .._types import Ids
from ..appearance import local_color
from ..options import Options
from ..paths import light_terms_at
from ..phases import UNROLL
from ..render import rays_through, sample_places
from ..scene import Scene
from ..vec import vec, zeros
from ..visibility import hit_of
from ..world import Hit, Own, Surface, World
from .layout import Layout
from .parameters import GEOMETRY
from .rows import OWN

Moments = Float[Array, "3 all all"]
"""For each channel the sums of products of the weighted planes X and the residual."""


def by_moments(layout: Layout, options: Options, lights: int) -> bool:
    """Whether they do: pixels are single rays, and colours linear in the planes."""
    fixed = not GEOMETRY & {*layout.spheres, *layout.camera} and layout.exposure is None
    plain = not options.needs.textures and not options.needs.checkers
    rays = not options.antialias and options.samples == 1
    return fixed and plain and rays and lights <= UNROLL // 4


def moments(
    basis: Float[Array, "size pixels"],
    slope: Float[Array, "3 pixels"],
    residual: Float[Array, "3 pixels"],
) -> Moments:
    """The moments of some pixels. **Arguments:** `slope`: of the residual by the picture."""
    size = len(basis)

    def each() -> Moments:
        rows = jnp.concatenate([slope[:, None] * basis[None], residual[:, None]], axis=1)
        return rows @ jnp.swapaxes(rows, 1, 2)

    def alike() -> Moments:
        rows = jnp.concatenate([slope[:1] * basis, residual])
        square = rows @ rows.T
        at = [jnp.array([*range(size), size + c]) for c in range(3)]
        return jnp.stack([square[i[:, None], i[None, :]] for i in at])

    # where nothing is clipped or masked in some channels only, one product does
    return lax.cond(jnp.all(slope == slope[:1]), alike, each)


class Shading(eqx.Module):
    """How the pixels that show one object are coloured."""

    scene: Scene
    world: World
    own: Own  #: the object's row
    number: Int[Array, ""]
    options: Options = eqx.field(static=True)
    layout: Layout = eqx.field(static=True)

    def __init__(
        self, scene: Scene, world: World, number: Int[Array, ""], options: Options, layout: Layout
    ):
        self.scene, self.world, self.number = scene, world, number
        self.own = world.tables.row(number)
        self.options, self.layout = options, layout

    @property
    def by_exponent(self) -> bool:
        return "exponent" in self.layout.spheres

    @property
    def size(self) -> int:
        """How many planes there are."""
        return 1 + (8 + self.by_exponent) * len(self.scene.lights)

    def basis(self, pixels: Ids) -> Float[Array, "size pixels"]:
        """The planes: 1, all u, all h, and light by light the derivatives of u, of h by the
        position, and that of h by the exponent.
        """
        options, dtype = self.options, self.scene.dtype
        (left,), (top,) = sample_places(self.scene, options)
        ray = rays_through(self.scene, options, pixels, left, top)
        world = self.world.with_own(jax.tree.map(lambda x: x[..., None], self.own))
        id_ = jnp.full(pixels.shape, self.number.astype(world.id_type))
        hit = hit_of(world, ray, id_, options.needs)
        u, h, slopes = [], [], []
        for k, place in enumerate(self.scene.lights.position):

            def terms(place: Array, exponent: Array, k: int = k) -> tuple[Array, Array]:
                shadows = options.needs.shadows_of(k)
                return light_terms_at(world, ray, hit, options, vec(place), shadows, exponent)

            exponent = self.own.materials.exponent[0]
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
        return jnp.stack([jnp.ones(pixels.shape, dtype), *u, *h, *slopes])

    def factors(self) -> Float[Array, "3 terms"]:
        """Colours are these times the first planes: 1, all u and all h."""
        return self._factors(self._smooth())

    def _smooth(self) -> tuple[list[Any], Float[Array, "lights 3"]]:
        """What colours depend on besides the planes: the free of the object's own, the lights'
        colours.
        """
        return [OWN[name](self.own) for name in self.layout.spheres], self.scene.lights.color

    def _factors(
        self, smooth: tuple[list[Any], Float[Array, "lights 3"]]
    ) -> Float[Array, "3 terms"]:
        """`factors` as a function of what `_smooth` gives."""
        columns, colors = smooth
        own, scene = self.own, self.scene
        if columns:
            at_own = lambda own: [OWN[name](own) for name in self.layout.spheres]
            own = eqx.tree_at(at_own, own, columns)
        scene = eqx.tree_at(lambda s: s.lights.color, scene, colors)
        world = self.world.with_own(own)
        hit = Hit(self.number.astype(world.id_type), jnp.array(False))
        nothing = zeros((), scene.dtype)
        nowhere = Surface(nothing, nothing, nothing.x)  # textures, which ask where, there are none
        count = len(colors)

        def color(terms: Float[Array, " terms"]) -> Float[Array, " 3"]:
            sums = [nothing, nothing]
            for k in range(count):
                sums[0] = sums[0] + vec(colors[k]) * terms[k]
                sums[1] = sums[1] + vec(colors[k]) * terms[count + k]
            seen = local_color(scene, world, hit, nowhere, self.options.needs, (sums[0], sums[1]))
            return jnp.stack([seen.x, seen.y, seen.z])

        dark = jnp.zeros(2 * count, scene.dtype)
        return jnp.concatenate([color(dark)[:, None], jax.jacrev(color)(dark)], axis=1)

    def by_columns(
        self, sums: Moments
    ) -> tuple[Float[Array, "columns columns"], Float[Array, " columns"], Float[Array, ""]]:
        """J^T J, J^T r and the cost of the object's pixels."""
        ways = self._ways()
        inner = jnp.einsum("acx,cxy->acy", ways, sums[:, :-1, :-1])
        square = jnp.einsum("acy,bcy->ab", inner, ways)
        gradient = jnp.einsum("acx,cx->a", ways, sums[:, :-1, -1])
        return square, gradient, jnp.sum(sums[:, -1, -1]) / 2

    def _ways(self) -> Float[Array, "columns 3 size"]:
        """The rows of the Jacobian are these times the planes; columns as in `Layout.each`."""
        factors = self.factors()
        slopes, by_color = jax.jacrev(self._factors)(self._smooth())
        count, each = len(self.scene.lights), 6 + self.by_exponent
        none = jnp.zeros((1, 3, self.size), factors.dtype)
        at_u = lambda k, j: 1 + 2 * count + each * k + j
        at_h = lambda k, j: at_u(k, j) + 3

        def own(slope: Float[Array, "3 terms *shape"]) -> Float[Array, "numbers 3 size"]:
            slope = jnp.moveaxis(slope.reshape(*factors.shape, -1), -1, 0)
            return jnp.pad(slope, ((0, 0), (0, 0), (0, self.size - factors.shape[1])))

        def of_exponent() -> Float[Array, "1 3 size"]:
            way = none
            for k in range(count):
                way = way.at[0, :, at_h(k, 3)].set(factors[:, 1 + count + k])
            return way

        parts = []
        for name, slope in zip(self.layout.spheres, slopes, strict=True):
            vectors = jax.tree.leaves(slope)
            parts += [of_exponent()] if name == "exponent" else [own(x) for x in vectors]
        for name in self.layout.lights:
            if name == "light_color":
                parts.append(own(by_color))
                continue
            for k in range(count):
                for j in range(3):
                    way = none.at[0, :, at_u(k, j)].set(factors[:, 1 + k])
                    parts.append(way.at[0, :, at_h(k, j)].set(factors[:, 1 + count + k]))
        return jnp.concatenate([jnp.zeros((0, 3, self.size), factors.dtype), *parts])
