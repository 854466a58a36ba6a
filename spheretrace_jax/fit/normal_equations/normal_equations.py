"""The normal equations of a fit, J^T J and J^T r, without ever holding the Jacobian J.

Most pixels show one object: their rows of J have that object's columns and those of the lights and
the camera, whatever the number of spheres. They are summed object by object. Only pixels that show
several, at edges and in mirrors, have columns for every object.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ...base.types import Ids, Index, Mask
from ...base.vec import Vec, zeros
from ...rendering.render import (
    area_seen,
    bend_part,
    point_seen,
    rays_through,
    sample_places,
    sampled,
    smooth_beside,
)
from ...scene.scene import Scene
from ...scene.settings import RenderSettings
from ...tracing.material import background_color
from ...tracing.path import Path, shade_path
from ...tracing.queries import known_hit
from ...tracing.tables import SceneTables, build_tables
from ...xla.compaction import prefix_sum
from ...xla.sharding import on_devices, padded
from ..model.target import Target
from .gram import Gram, LinearShading, gram, uses_gram
from .jacobian_rows import ColorAndRows, color_and_rows
from .parameter_index import ParameterIndex
from .pixel_buckets import EDGE, MOST, SEVERAL, STILL, PixelBuckets, bucket_pixels

T = TypeVar("T")

# Pixels of one object, and those that show several, are looked at so many at a time, or else what
# is left of the last time costs more than many times do: a step of the nine spheres' geometry at
# 256 x 256 takes 77 ms, of its 51 x 51 boxes 23; with 4096 and 2048 125 and 100.
MOST_ALONE, MOST_MIXED = 1 << 10, 1 << 8

# Chunks of `MOST` pixels of one object are looked at so many side by side where there are moments
# of them: loops over 4096 pixels alone are run by one thread.
BESIDE = 8

# Of pixels that show several objects no more than have a part of the Jacobian of so many numbers,
# 12 MB in float64.
MOST_NUMBERS = 1 << 19

# A pixel and its neighbours left, right, above and below: how far to the right, and down.
_BESIDE = (0, -1, 1, 0, 0), (0, 0, 0, -1, 1)

Look = Callable[..., Vec]
"""What pixels see: of a scene, its world, pixels, which of them count, and a place in them."""


class NormalEquations(eqx.Module):
    """A residual r and its Jacobian J, as far as a Gauss-Newton step needs them."""

    square: Float[Array, "free free"]  #: J^T J
    gradient: Float[Array, " free"]  #: J^T r
    cost: Float[Array, ""]  #: r.r / 2

    def plus(
        self,
        columns: Int[Array, " columns"],
        square: Float[Array, "columns columns"],
        gradient: Float[Array, " columns"],
        cost: Float[Array, ""],
    ) -> "NormalEquations":
        """With a part added of some of the free parameters; those out of bounds are none."""
        at = columns[:, None], columns[None, :]
        return NormalEquations(
            self.square.at[at].add(square, mode="drop"),
            self.gradient.at[columns].add(gradient, mode="drop"),
            self.cost + cost,
        )


def normal_equations(
    scene: Scene,
    exposure: Float[Array, " 3"],
    target: Target,
    layout: ParameterIndex,
    settings: RenderSettings,
    lists: PixelBuckets | None = None,
) -> NormalEquations:
    """J^T J, J^T r and the cost in one pass over the picture, by the free parameters themselves.

    **Arguments:** `exposure`: what the picture is multiplied by, per channel. `layout`: which
    parameters are free and their order. `lists`: what pixels show, if it is known; by device.
    """
    if settings.sharding is None:
        return _of_rows(scene, exposure, target, layout, settings, lists)

    def own(whole: tuple, own: tuple) -> NormalEquations:
        (scene, exposure, noise, part), (image, weight, lists) = whole, own
        mine = Target(image, weight, noise, target.loss)
        return lax.psum(_of_rows(scene, exposure, mine, layout, part, lists), part.rows.axes)

    whole = scene, exposure, target.noise, settings.of_device
    # rows beyond the picture weigh nothing
    image, weight = (padded(x, settings.sharding) for x in (target.image, target.weight))
    return on_devices(own, settings.sharding, whole, (image, weight, lists), joined=True)


def _of_rows(
    scene: Scene,
    exposure: Float[Array, " 3"],
    target: Target,
    layout: ParameterIndex,
    settings: RenderSettings,
    lists: PixelBuckets | None,
) -> NormalEquations:
    """The part of the rows that are to be computed. **Arguments:** `target`: of these rows."""
    world = build_tables(scene)
    edge = sampled(scene, settings)[1] if settings.antialias else None
    if lists is None:
        lists = bucket_pixels(scene, layout, settings, target.counts, edge)
    weights = None if edge is None else _weights(edge, settings, scene.dtype)
    picture = _Picture(scene, world, target, exposure, lists, weights, layout, settings)
    n, dtype = layout.size, scene.dtype
    normal = NormalEquations(jnp.zeros((n, n), dtype), jnp.zeros(n, dtype), jnp.zeros((), dtype))
    normal = _add_single(_add_still(normal, picture), picture)
    if settings.bounces or (settings.samples > 1 and not settings.antialias):
        normal = _add_mixed(normal, picture, SEVERAL, partial(picture.near, _through(settings)))
    if settings.antialias:
        normal = _add_mixed(normal, picture, EDGE, partial(_mean, _over(settings), settings))
    return normal


class _Picture(eqx.Module):
    """A scene's picture and its target, list by list."""

    scene: Scene
    world: SceneTables
    target: Target
    exposure: Float[Array, " 3"]
    lists: PixelBuckets
    weights: Float[Array, "5 pixels"] | None  #: of `_BESIDE`; None for pixels that are points
    layout: ParameterIndex = eqx.field(static=True)
    settings: RenderSettings

    def near(self, look: Look, scene: Scene, world: SceneTables, pixels: Ids, alive: Mask) -> Vec:
        """The mean of some pixels and, as `render.averaged` says, a little of their neighbours."""
        mean = partial(_mean, look, self.settings, scene, world, pixels, alive)
        if self.weights is None:
            return mean()
        beside = (*jnp.asarray(_BESIDE, scene.dtype), self.weights[:, pixels])
        return _sum(lambda x: mean((x[0], x[1])) * x[2], beside)

    def add(
        self,
        normal: NormalEquations,
        label: Index,
        columns: Int[Array, " columns"],
        look: Callable[[Ids, Mask], ColorAndRows],
        count: int,
    ) -> NormalEquations:
        """Adds the part of the pixels of one list, `count` at a time.

        **Arguments:** `columns`: which of the free parameters the rows are of; out of bounds: none.
        `look`: for some pixels, of which some count.
        """

        def some(
            normal: NormalEquations, pixels: Ids, alive: Mask, target: Target
        ) -> NormalEquations:
            seen, rows = look(pixels, alive)
            residual = target.residual(seen.T[None], self.exposure)[0].T
            by_picture, by_exposure = target.slopes(seen.T[None], self.exposure)
            parts = [rows(by_picture[0].T)]
            if self.layout.exposure is not None:
                parts.append(jnp.eye(3, dtype=seen.dtype)[:, :, None] * by_exposure[0].T[None])
            # with the residual as one more column all products are one
            both = jnp.concatenate([*parts, residual[None]])
            both = both.reshape(len(both), -1)
            products = both @ both.T
            square, gradient = products[:-1, :-1], products[:-1, -1]
            return normal.plus(columns, square, gradient, products[-1, -1] / 2)

        return self.over(label, some, normal, count)

    def over(
        self, label: Index, some: Callable[[T, Ids, Mask, Target], T], start: T, count: int
    ) -> T:
        """What a loop over a list's pixels comes to, `count` at a time.

        **Arguments:** `some`: from what it came to so far, pixels, which of them count, and their
        part of the target, of shape `(1, count, 3)`.
        """
        begin, end = self.lists.bounds(label)
        numbers = jnp.arange(count, dtype=jnp.int32)

        def body(k: Index, state: T) -> T:
            first = begin + k * count
            alive = first + numbers < end
            pixels = lax.dynamic_slice(self.lists.order, (first,), (count,))
            return some(state, pixels, alive, self.target_at(pixels[None], alive[None]))

        return lax.fori_loop(0, -((begin - end) // count), body, start)

    def target_at(
        self, pixels: Int[Array, "rows count"], alive: Bool[Array, "rows count"]
    ) -> Target:
        """The part of the target of some pixels, of which some count."""
        take = lambda x: x.reshape(-1, 3).at[pixels].get(mode="promise_in_bounds")
        weight = jnp.where(alive[..., None], take(self.target.weight), 0)
        return Target(take(self.target.image), weight, self.target.noise, self.target.loss)


def _add_still(normal: NormalEquations, picture: _Picture) -> NormalEquations:
    """Adds the background that does not move."""
    settings = picture.settings

    def sky(scene: Scene, world: SceneTables, pixels: Ids, alive: Mask, *at: Array) -> Vec:
        black = zeros(pixels.shape, scene.dtype)
        if not settings.needs.background:
            return black
        return black + background_color(scene, rays_through(scene, settings, pixels, *at).direction)

    def seen(pixels: Ids, alive: Mask) -> Float[Array, "3 pixels"]:
        color = picture.near(sky, picture.scene, picture.world, pixels, alive)
        return jnp.stack([color.x, color.y, color.z])

    def squared(squares: Array, pixels: Ids, alive: Mask, target: Target) -> Array:
        return squares + target.residual(seen(pixels, alive).T[None], picture.exposure) ** 2

    if picture.layout.exposure is None:
        # added up place by place, and only then all: 9.4 ms, where 10.3 if chunk by chunk
        start = jnp.zeros((1, MOST, 3), picture.scene.dtype)
        cost = jnp.sum(picture.over(STILL, squared, start, MOST)) / 2
        return eqx.tree_at(lambda n: n.cost, normal, normal.cost + cost)
    none = lambda slope: jnp.zeros((0, *slope.shape), slope.dtype)
    look = lambda pixels, alive: (seen(pixels, alive), none)
    return picture.add(normal, STILL, jnp.asarray(picture.layout.exposure), look, MOST)


def _add_single(normal: NormalEquations, picture: _Picture) -> NormalEquations:
    """Adds the pixels that show one object each, object by object."""
    world, layout, settings = picture.world, picture.layout, picture.settings
    if uses_gram(layout, settings, len(picture.scene.lights)):
        return _add_moments(normal, picture)
    objects = world.spheres + world.planes

    def object_(number: Int[Array, ""], normal: NormalEquations) -> NormalEquations:
        own = world.tables.row(number)
        id_ = jnp.where(number < objects, number, -1).astype(world.id_type)

        def surface(scene: Scene, world: SceneTables, pixels: Ids, alive: Mask, *at: Array) -> Vec:
            ray = rays_through(scene, settings, pixels, *at)
            hit = known_hit(world, ray, jnp.broadcast_to(id_, pixels.shape), settings.needs)
            path = Path(ray, hit, jnp.ones(pixels.shape, scene.dtype), alive, None)
            return shade_path(scene, world, path, settings)

        def look(pixels: Ids, alive: Mask) -> ColorAndRows:
            see = partial(picture.near, surface, pixels=pixels, alive=alive)
            return color_and_rows(see, picture.scene, world, own, layout, pixels.size)

        return picture.add(normal, number, jnp.asarray(layout.each)[number], look, MOST_ALONE)

    return lax.fori_loop(0, len(layout.each), object_, normal)


def _add_moments(normal: NormalEquations, picture: _Picture) -> NormalEquations:
    """The same where moments of the shading do, for chunks of several objects side by side."""
    scene, world, layout = picture.scene, picture.world, picture.layout
    count = len(layout.each) - 1
    begin, end = picture.lists.bounds(jnp.arange(count, dtype=jnp.int32))
    chunks = -((begin - end) // MOST)
    ends = prefix_sum(chunks)
    # of small pictures fewer, or the last of them are mostly empty
    beside = max(1, min(BESIDE, picture.lists.order.size // (8 * MOST)))
    shading = lambda number: LinearShading(scene, world, number, picture.settings, layout)

    def some(k: Index, sums: Gram) -> Gram:
        chunk = k * beside + jnp.arange(beside, dtype=jnp.int32)
        number = jnp.searchsorted(ends, chunk, side="right").astype(jnp.int32)
        number = jnp.minimum(number, count - 1)
        first = begin[number] + (chunk - (ends - chunks)[number]) * MOST
        place = first[:, None] + jnp.arange(MOST, dtype=jnp.int32)[None]
        pixels = picture.lists.order.at[place].get(mode="clip")
        target = picture.target_at(pixels, place < end[number][:, None])
        basis = shading(number).basis(pixels)
        factors = jax.vmap(lambda number: shading(number).factors())(number)
        # term by term: for a product of matrices, and channel by channel for `moments`, all of it
        # would be copied (10.3 ms, not 11.3)
        first, *terms = (
            basis[:, k, :, None] * factors[:, None, :, k] for k in range(factors.shape[2])
        )
        seen = sum(terms, first)
        residual = target.residual(seen, picture.exposure)
        slope, _ = target.slopes(seen, picture.exposure)
        split = lambda x: [x[..., c] for c in range(3)]
        return sums.at[number].add(gram(basis, split(slope), split(residual)))

    def object_(number: Index, normal: NormalEquations) -> NormalEquations:
        added = shading(number).by_columns(sums[number])
        return normal.plus(jnp.asarray(layout.each)[number], *added)

    size = shading(jnp.int32(0)).size + 1
    sums = jnp.zeros((count, 3, size, size), scene.dtype)
    sums = lax.fori_loop(0, -(-ends[-1] // beside), some, sums)
    return lax.fori_loop(0, count, object_, normal)


def _add_mixed(
    normal: NormalEquations, picture: _Picture, kind: int, mean: Callable[..., Vec]
) -> NormalEquations:
    """Adds the pixels that show several objects, of one kind.

    **Arguments:** `mean`: what they see.
    """
    scene, world, layout = picture.scene, picture.world, picture.layout

    def look(pixels: Ids, alive: Mask) -> ColorAndRows:
        see = partial(mean, pixels=pixels, alive=alive)
        return color_and_rows(see, scene, world, world.tables, layout, pixels.size)

    columns = jnp.asarray(layout.all)
    count = max(64, min(MOST_MIXED, MOST_NUMBERS // columns.size))
    return picture.add(normal, len(layout.each) + kind, columns, look, count)


def _through(settings: RenderSettings) -> Look:
    """What one ray sees."""
    return lambda scene, world, pixels, alive, *at: point_seen(scene, world, settings, pixels, *at)


def _over(settings: RenderSettings) -> Look:
    """What a sample's area sees."""
    return lambda scene, world, pixels, alive, *at: area_seen(
        scene, world, settings, pixels, alive, *at
    )


def _mean(
    look: Look,
    settings: RenderSettings,
    scene: Scene,
    world: SceneTables,
    pixels: Ids,
    alive: Mask,
    shift: tuple[Array, Array] | None = None,
) -> Vec:
    """The mean of some pixels' samples. **Arguments:** `shift`: how far beside them."""
    left, top = sample_places(scene, settings)
    if shift is not None:
        left, top = left + shift[0], top + shift[1]
    see = lambda at: look(scene, world, pixels, alive, *at)
    return _sum(see, (left, top)) * (1 / settings.samples**2)


def _sum(term: Callable[[Any], Vec], over: Any) -> Vec:
    """The sum of a term over the rows of arrays."""
    first = term(jax.tree.map(lambda x: x[0], over))
    rest = jax.tree.map(lambda x: x[1:], over)
    if not jax.tree.leaves(rest)[0].size:
        return first
    add = lambda total, x: (total + term(x), None)
    return lax.scan(jax.checkpoint(add), first, rest)[0]


def _weights(edge: Mask, settings: RenderSettings, dtype: np.dtype) -> Float[Array, "5 pixels"]:
    """What a pixel and those of `_BESIDE` count in its mean."""
    across, down = (bend_part(settings) * m.astype(dtype) for m in smooth_beside(edge, settings))
    return jnp.stack([1 - 2 * across - 2 * down, across, across, down, down]).reshape(5, -1)
