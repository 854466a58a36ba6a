"""The normal equations of a fit, J^T J and J^T r, without ever holding the Jacobian J.

Most pixels show one object: their rows of J have that object's columns and those of the lights and
the camera, whatever the number of spheres. They are summed object by object. Only pixels that show
several, at edges and in mirrors, have columns for every object.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._types import Ids, Index, Mask
from ..options import Options
from ..paths import Path, shade
from ..phases import STRIP_PIXELS, keep, nth_marked
from ..render import (
    area_seen,
    averaged,
    bend_part,
    point_seen,
    rays_through,
    sample_places,
    sampled,
    smooth_beside,
)
from ..scene import Scene
from ..vec import Vec
from ..visibility import hit_of, nearest
from ..world import Own, World, build_world
from .layout import Layout
from .rows import Rows, jacobian_rows
from .target import Target

# Pixels that show one object are looked at this many at a time; others so many that their part of
# the Jacobian has at most so many numbers, 12 MB in float64.
PIXELS, MOST_NUMBERS = 1 << 12, 1 << 19


# A pixel and its neighbours left, right, above and below: how far to the right, and down.
_BESIDE = (0, -1, 1, 0, 0), (0, 0, 0, -1, 1)


Look = Callable[..., Vec]
"""What pixels see: of a scene, its world, pixels, which of them count, and a place in them."""


class Normal(eqx.Module):
    """A residual r and its Jacobian J, as far as a Gauss-Newton step needs them."""

    square: Float[Array, "free free"]  #: J^T J
    gradient: Float[Array, " free"]  #: J^T r
    cost: Float[Array, ""]  #: r.r / 2


def normal_equations(
    scene: Scene,
    exposure: Float[Array, " 3"],
    target: Target,
    layout: Layout,
    options: Options,
) -> Normal:
    """J^T J, J^T r and the cost in one pass over the picture, by the free parameters themselves.

    **Arguments:** `exposure`: what the picture is multiplied by, per channel. `layout`: which
    parameters are free and their order.
    """
    world, n = build_world(scene), layout.size
    color, edge = sampled(scene, options)
    picture = averaged(color, edge, options)
    residual = target.residual(picture, exposure)
    by_picture, by_exposure = target.slopes(picture, exposure)
    listed = lambda v: v.reshape(-1, 3)
    sums = _Sums(
        listed(residual),
        listed(by_picture),
        listed(by_exposure) if layout.exposure is not None else None,
    )
    normal = Normal(
        jnp.zeros((n, n), scene.dtype), jnp.zeros(n, scene.dtype), jnp.sum(residual**2) / 2
    )
    if layout.exposure is not None:
        at = layout.exposure
        own = normal.square.at[at, at].set(jnp.sum(by_exposure**2, axis=(0, 1)))
        pushed = jnp.sum(by_exposure * residual, axis=(0, 1))
        normal = Normal(own, normal.gradient.at[at].set(pushed), normal.cost)

    label = _labels(scene, world, layout, options).reshape(-1)
    several, edge_ = world.spheres + world.planes + 1, edge.reshape(-1)
    weights = _weights(edge, options, scene.dtype)
    normal = _add_single(
        normal, scene, world, sums, jnp.where(edge_, -1, label), layout, options, weights
    )
    if options.bounces or (options.samples > 1 and not options.antialias):
        look = partial(_near, weights=weights, options=options, look=_through(options))
        normal = _add_mixed(normal, scene, world, sums, (label == several) & ~edge_, layout, look)
    if options.antialias:
        look = partial(_mean, options=options, look=_over(options))
        normal = _add_mixed(normal, scene, world, sums, edge_, layout, look)
    return normal


class _Sums(eqx.Module):
    """What the rows of a picture's Jacobian are multiplied by, of all pixels."""

    residual: Float[Array, "pixels 3"]
    slope: Float[Array, "pixels 3"]  #: its derivative by the picture
    by_exposure: Float[Array, "pixels 3"] | None  #: that by the exposure

    def add(
        self,
        normal: Normal,
        marked: Bool[Array, " pixels"],
        columns: Int[Array, " columns"],
        rows: Callable[[Ids, Mask], Rows],
        layout: Layout,
        count: int,
    ) -> Normal:
        """Adds the part of the pixels that are marked, `count` at a time.

        **Arguments:** `rows`: the rows of the Jacobian for some pixels, of which some count.
        `columns`: which of the free parameters these are; out of bounds: none.
        """
        total, place = nth_marked(marked)
        numbers = jnp.arange(count, dtype=jnp.int32)
        at = columns[:, None], columns[None, :]

        def some(k: Index, normal: Normal) -> Normal:
            alive = numbers + k * count < total
            pixels = jnp.where(alive, place(numbers + k * count), 0)
            take = lambda list_: list_.at[pixels].get(mode="promise_in_bounds").T
            pick = lambda list_: jnp.where(alive[None], take(list_), 0)
            row = keep(rows(pixels, alive))
            by = row * pick(self.slope)[None]
            flat = by.reshape(len(by), -1)
            square = normal.square.at[at].add(flat @ flat.T, mode="drop")
            pushed = flat @ pick(self.residual).reshape(-1)
            gradient = normal.gradient.at[columns].add(pushed, mode="drop")
            if layout.exposure is not None and self.by_exposure is not None:
                cross = jnp.sum(by * pick(self.by_exposure)[None], axis=-1)
                to = jnp.asarray(layout.exposure)
                square = square.at[columns[:, None], to[None, :]].add(cross, mode="drop")
                square = square.at[to[:, None], columns[None, :]].add(cross.T, mode="drop")
            return Normal(square, gradient, normal.cost)

        return lax.fori_loop(0, -(-total // count), some, normal)


def _add_single(
    normal: Normal,
    scene: Scene,
    world: World,
    sums: _Sums,
    label: Int[Array, " pixels"],
    layout: Layout,
    options: Options,
    weights: Float[Array, "5 pixels"] | None,
) -> Normal:
    """Adds the pixels that show one object each, object by object. **Arguments:** `label`: it."""
    tables, objects = Own(world.balls, world.materials), world.spheres + world.planes
    # their paths end where they begin
    options_ = dataclasses.replace(options, bounces=0)

    def object_(number: Int[Array, ""], normal: Normal) -> Normal:
        own = jax.tree.map(lambda t: t[jnp.minimum(number, len(t) - 1)][None], tables)
        id_ = jnp.where(number < objects, number, -1).astype(world.id_type)

        def look(scene: Scene, world: World, pixels: Ids, alive: Mask, *at: Array) -> Vec:
            ray = rays_through(scene, options, pixels, *at)
            hit = hit_of(world, ray, jnp.broadcast_to(id_, pixels.shape), options.needs)
            path = Path(ray, hit, jnp.ones(pixels.shape, scene.dtype), alive, None)
            return shade(scene, world, path, options_)[0]

        def rows(pixels: Ids, alive: Mask) -> Rows:
            see = partial(
                _near, pixels=pixels, alive=alive, weights=weights, options=options, look=look
            )
            return jacobian_rows(see, scene, world, own, layout, pixels.size)

        columns = jnp.asarray(layout.each)[number]
        return sums.add(normal, label == number, columns, rows, layout, PIXELS)

    return lax.fori_loop(0, len(layout.each), object_, normal)


def _add_mixed(
    normal: Normal,
    scene: Scene,
    world: World,
    sums: _Sums,
    mixed: Bool[Array, " pixels"],
    layout: Layout,
    look: Callable[..., Vec],
) -> Normal:
    """Adds the pixels that show several objects."""
    tables = Own(world.balls, world.materials)

    def rows(pixels: Ids, alive: Mask) -> Rows:
        see = partial(look, pixels=pixels, alive=alive)
        return jacobian_rows(see, scene, world, tables, layout, pixels.size)

    columns = jnp.asarray(layout.all)
    count = max(64, min(PIXELS // 2, MOST_NUMBERS // columns.size))
    return sums.add(normal, mixed, columns, rows, layout, count)


def _through(options: Options) -> Look:
    """What one ray sees."""
    return lambda scene, world, pixels, alive, *at: point_seen(scene, world, options, pixels, *at)


def _over(options: Options) -> Look:
    """What a sample's area sees."""
    return lambda scene, world, pixels, alive, *at: area_seen(
        scene, world, options, pixels, alive, *at
    )


def _mean(
    scene: Scene,
    world: World,
    pixels: Ids,
    alive: Mask,
    options: Options,
    look: Look,
    shift: tuple[Array, Array] | None = None,
) -> Vec:
    """The mean of some pixels' samples. **Arguments:** `shift`: how far beside them."""
    left, top = sample_places(scene, options)
    if shift is not None:
        left, top = left + shift[0], top + shift[1]
    see = lambda at: look(scene, world, pixels, alive, *at)
    return _sum(see, (left, top)) * (1 / options.samples**2)


def _near(
    scene: Scene,
    world: World,
    pixels: Ids,
    alive: Mask,
    weights: Float[Array, "5 pixels"] | None,
    options: Options,
    look: Look,
) -> Vec:
    """The mean of some pixels and, as `render.averaged` says, a little of their neighbours."""
    mean = partial(_mean, scene, world, pixels, alive, options, look)
    if weights is None:
        return mean()
    beside = (*jnp.asarray(_BESIDE, scene.dtype), weights[:, pixels])
    return _sum(lambda x: mean((x[0], x[1])) * x[2], beside)


def _sum(term: Callable[[Any], Vec], over: Any) -> Vec:
    """The sum of a term over the rows of arrays."""
    first = term(jax.tree.map(lambda x: x[0], over))
    rest = jax.tree.map(lambda x: x[1:], over)
    if not jax.tree.leaves(rest)[0].size:
        return first
    add = lambda total, x: (total + term(x), None)
    return lax.scan(jax.checkpoint(add), first, rest)[0]


def _weights(edge: Mask, options: Options, dtype: np.dtype) -> Float[Array, "5 pixels"] | None:
    """What a pixel and those of `_BESIDE` count in its mean; None for pixels that are points."""
    if not options.antialias:
        return None
    across, down = (bend_part(options) * m.astype(dtype) for m in smooth_beside(edge))
    return jnp.stack([1 - 2 * across - 2 * down, across, across, down, down]).reshape(5, -1)


def _labels(scene: Scene, world: World, layout: Layout, options: Options) -> Int[Array, " pixels"]:
    """The number of the object that each pixel shows; one more than the last for the background,
    two for several objects; -1 for a background that no free parameter moves.
    """
    objects = world.spheres + world.planes
    materials = jax.lax.stop_gradient(world.materials)
    ends = jnp.full(objects + 1, True)
    if options.bounces and options.needs.dark_paths:
        ends = jnp.arange(objects + 1) >= objects
    elif options.bounces:
        ends = jnp.append((materials.kgr == 0) & (materials.kt == 0), True)
    sky = objects if layout.camera and scene.sky is not None else -1
    places = sample_places(scene, options)

    def label(pixels: Ids) -> Ids:
        def sample(place: tuple) -> Ids:
            ray = rays_through(scene, options, pixels, *place)
            return nearest(world, ray, options.needs).id.astype(jnp.int32)

        first = sample(jax.tree.map(lambda p: p[0], places))
        same = jnp.full(first.shape, True)
        if options.samples > 1:
            add = lambda same, place: (same & (sample(place) == first), None)
            same, _ = lax.scan(add, same, jax.tree.map(lambda p: p[1:], places))
        alone = jnp.where(first >= 0, first, sky)
        return jnp.where(same & ends[first], alone, objects + 1)

    size = options.width * options.height
    strips = -(-size // STRIP_PIXELS)
    strip = -(-size // strips)
    pixels = jnp.arange(strips * strip, dtype=jnp.int32).reshape(strips, strip)
    return lax.map(label, pixels).reshape(-1)[:size]
