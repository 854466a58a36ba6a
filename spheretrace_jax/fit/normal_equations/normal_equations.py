"""The normal equations of a fit, J^T J and J^T r, without ever holding the Jacobian J.

Most pixels show one object: their rows of J have that object's columns and those of the lights and
the camera, whatever the number of spheres. They are summed object by object. Only pixels that show
several objects, at edges and in mirrors, have columns for every object.
"""

from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ...base.types import Ids, Index, Mask, Picture, widest_float
from ...base.vec import Vec
from ...rendering.pixel_filter import filter_weights
from ...rendering.samples import (
    area_radiance,
    render_samples,
)
from ...scene.scene import Scene
from ...scene.settings import RenderSettings
from ...tracing.context import build_context
from ...xla.sharding import on_devices, pad_rows
from ..model.target import Target
from .bucketed_picture import (
    BucketedPicture,
    look_at_object,
    look_at_sky,
    look_by_ray,
    mean_of_samples,
)
from .chain_rule import by_parameters
from .gbuffer import GBuffer
from .jacobian_rows import ColorAndRows, color_and_rows
from .parameter_index import ParameterIndex
from .pixel_buckets import EDGE, MOST, SEVERAL, STILL, bucket_pixels
from .shading_equations import ShadingEquations

# Pixels per chunk, of those that show one object, and of those that show several. Larger chunks
# waste more in the last, half-empty one; smaller ones cost more overhead. A geometry step of the
# nine spheres takes 77 ms at 256 x 256 and 23 at 51 x 51; with 4096 and 2048 it takes 125 and 100.
MOST_ALONE, MOST_MIXED = 1 << 10, 1 << 8

# Chunks of pixels that show several objects are so small that their part of the Jacobian has no
# more numbers than this per channel, 12 MB in float64; but no smaller than the second number, in
# pixels.
MOST_NUMBERS, LEAST_MIXED = 1 << 19, 64


class NormalEquations(eqx.Module):
    """A residual r and its Jacobian J, as far as a Gauss-Newton step needs them."""

    square: Float[Array, "free free"]  #: J^T J
    gradient: Float[Array, " free"]  #: J^T r
    cost: Float[Array, ""]  #: r.r / 2
    #: each picture where its target counts
    pictures: tuple[Picture, ...] = ()

    def plus(
        self,
        columns: Int[Array, " columns"],
        square: Float[Array, "columns columns"],
        gradient: Float[Array, " columns"],
        cost: Float[Array, ""],
    ) -> "NormalEquations":
        """Adds a part by some of the free parameters; columns out of bounds are none."""
        at = columns[:, None], columns[None, :]
        return NormalEquations(
            self.square.at[at].add(square, mode="drop"),
            self.gradient.at[columns].add(gradient, mode="drop"),
            self.cost + cost,
            self.pictures,
        )

    def with_seen(self, pixels: Ids, seen: Float[Array, "3 pixels"]) -> "NormalEquations":
        """Returns the same with the colours of some pixels of the picture."""
        (picture,) = self.pictures
        flat = picture.reshape(-1, 3).at[pixels].set(seen.T, mode="drop")
        return eqx.tree_at(lambda n: n.pictures[0], self, flat.reshape(picture.shape))


def normal_equations(
    scene: Scene,
    exposure: Float[Array, " 3"],
    target: Target,
    index: ParameterIndex,
    settings: RenderSettings,
    buffer: GBuffer | None = None,
) -> NormalEquations:
    """Sums J^T J, J^T r and the cost in one pass over the picture, by the free parameters.

    **Arguments:** `exposure`: what the picture is multiplied by, per channel. `index`: which
    parameters are free and their order. `buffer`: the picture's shading samples, if geometry and
    camera are fixed; without them pixels are traced at every step.
    """
    if buffer is not None:
        return _of_samples(scene, exposure, target, index, settings, buffer)
    if settings.sharding is None:
        return _of_rows(scene, exposure, target, index, settings)

    def of_device(whole: tuple, rows: tuple) -> NormalEquations:
        (scene, exposure, noise, settings), (image, weight) = whole, rows
        target_ = Target(image, weight, noise, target.loss)
        found = _of_rows(scene, exposure, target_, index, settings)
        whole_rows = lambda p: lax.all_gather(p, settings.rows.axes, tiled=True)
        pictures = tuple(map(whole_rows, found.pictures))
        sums = lax.psum(eqx.tree_at(lambda n: n.pictures, found, ()), settings.rows.axes)
        return eqx.tree_at(lambda n: n.pictures, sums, pictures)

    whole = scene, exposure, target.noise, settings.of_device
    # rows beyond the picture weigh nothing
    rows = tuple(pad_rows(x, settings.sharding) for x in (target.image, target.weight))
    found = on_devices(of_device, settings.sharding, whole, rows, joined=True)
    return eqx.tree_at(
        lambda n: n.pictures, found, tuple(p[: settings.height] for p in found.pictures)
    )


def _of_samples(
    scene: Scene,
    exposure: Float[Array, " 3"],
    target: Target,
    index: ParameterIndex,
    settings: RenderSettings,
    buffer: GBuffer,
) -> NormalEquations:
    """Sums by shading the samples of a picture."""

    buffer = eqx.tree_at(lambda b: b.fixed, buffer, [])  # which has no axis for strips

    def of_strips(whole: tuple, buffer: GBuffer) -> NormalEquations:
        scene, exposure, target, settings = whole
        context = build_context(scene, settings, accelerated=False)
        equations = ShadingEquations(context, target, exposure, index)
        sums = equations.sums(buffer, settings.width * settings.height)
        sums = lax.psum(sums, settings.rows.axes) if settings.rows.axes else sums
        picture = sums.seen.reshape(target.image.shape)
        residual = target.residual(picture, exposure).astype(sums.products.dtype)
        cost = jnp.sum(residual**2) / 2
        return NormalEquations(*by_parameters(equations, sums), cost, (picture,))

    if settings.sharding is None:
        return of_strips((scene, exposure, target, settings), buffer)
    whole = scene, exposure, target, settings.of_device
    return on_devices(of_strips, settings.sharding, whole, buffer, joined=True)


def _of_rows(
    scene: Scene,
    exposure: Float[Array, " 3"],
    target: Target,
    index: ParameterIndex,
    settings: RenderSettings,
) -> NormalEquations:
    """Sums the part of the rows that are to be computed. **Arguments:** `target`: of these rows."""
    context = build_context(scene, settings, accelerated=settings.antialias)
    # only the mask is used, so that XLA drops all else
    edge = render_samples(context, cover=False)[1] if settings.antialias else None
    context = context.unaccelerated()
    buckets = bucket_pixels(context, index, target.counts, edge)
    weights = None if edge is None else filter_weights(edge, settings, scene.dtype)
    picture = BucketedPicture(context, target, exposure, buckets, weights, index)
    n, dtype = index.size, widest_float(scene.dtype)
    sums = jnp.zeros((n, n), dtype), jnp.zeros(n, dtype), jnp.zeros((), dtype)
    normal = NormalEquations(*sums, (jnp.zeros_like(target.image),))
    normal = _add_single(_add_still(normal, picture), picture)
    # with edges covered, pixels whose samples differ have edges
    if settings.bounces or (settings.samples > 1 and not settings.antialias):
        normal = _add_mixed(normal, picture, SEVERAL, partial(picture.near, look_by_ray))
    if settings.antialias:
        normal = _add_mixed(normal, picture, EDGE, partial(mean_of_samples, area_radiance))
    return normal


def _add_bucket(
    normal: NormalEquations,
    picture: BucketedPicture,
    label: Index,
    columns: Int[Array, " columns"],
    look: Callable[[Ids, Mask], ColorAndRows],
    count: int,
) -> NormalEquations:
    """Adds the part of the pixels of one bucket, `count` at a time.

    **Arguments:** `columns`: which of the free parameters the rows are of; out of bounds: none.
    `look`: for some pixels, of which some count.
    """

    def add_chunk(
        normal: NormalEquations, pixels: Ids, alive: Mask, target: Target
    ) -> NormalEquations:
        seen, rows = look(pixels, alive)
        residual = target.residual(seen.T[None], picture.exposure)[0].T
        by_picture, by_exposure = target.slopes(seen.T[None], picture.exposure)
        parts = [rows(by_picture[0].T)]
        if picture.index.exposure is not None:
            parts.append(jnp.eye(3, dtype=seen.dtype)[:, :, None] * by_exposure[0].T[None])
        # with the residual as one more column all products are one
        both = jnp.concatenate([*parts, residual[None]]).astype(normal.cost.dtype)
        both = both.reshape(len(both), -1)
        products = both @ both.T
        square, gradient = products[:-1, :-1], products[:-1, -1]
        at = jnp.where(alive, pixels, picture.buckets.order.size)
        return normal.plus(columns, square, gradient, products[-1, -1] / 2).with_seen(at, seen)

    return picture.fold(label, add_chunk, normal, count)


def _add_still(normal: NormalEquations, picture: BucketedPicture) -> NormalEquations:
    """Adds the background that does not move."""

    def seen(pixels: Ids, alive: Mask) -> Float[Array, "3 pixels"]:
        color = picture.near(look_at_sky, picture.context, pixels, alive)
        return jnp.stack([color.x, color.y, color.z])

    none = lambda slope: jnp.zeros((0, *slope.shape), slope.dtype)
    look = lambda pixels, alive: (seen(pixels, alive), none)
    exposure = picture.index.exposure
    columns = jnp.zeros(0, jnp.int32) if exposure is None else jnp.asarray(exposure)
    return _add_bucket(normal, picture, STILL, columns, look, MOST)


def _add_single(normal: NormalEquations, picture: BucketedPicture) -> NormalEquations:
    """Adds the pixels that show one object each, object by object."""
    context, index = picture.context, picture.index
    tables = context.tables

    def add_object(number: Int[Array, ""], normal: NormalEquations) -> NormalEquations:
        row = tables.shared.row(number)
        id_ = jnp.where(number < tables.object_count, number, -1).astype(tables.id_type)

        def look(pixels: Ids, alive: Mask) -> ColorAndRows:
            see = partial(picture.near, partial(look_at_object, id_), pixels=pixels, alive=alive)
            return color_and_rows(see, context, row, index, pixels.size)

        return _add_bucket(
            normal, picture, number, jnp.asarray(index.each)[number], look, MOST_ALONE
        )

    return lax.fori_loop(0, len(index.each), add_object, normal)


def _add_mixed(
    normal: NormalEquations, picture: BucketedPicture, kind: int, mean: Callable[..., Vec]
) -> NormalEquations:
    """Adds the pixels that show several objects, of one kind.

    **Arguments:** `kind`: `SEVERAL` or `EDGE`. `mean`: from a context, pixels and which of them
    count to the colours seen.
    """
    context, index = picture.context, picture.index

    def look(pixels: Ids, alive: Mask) -> ColorAndRows:
        see = partial(mean, pixels=pixels, alive=alive)
        return color_and_rows(see, context, context.tables.shared, index, pixels.size)

    columns = jnp.asarray(index.all)
    count = max(LEAST_MIXED, min(MOST_MIXED, MOST_NUMBERS // columns.size))
    return _add_bucket(normal, picture, len(index.each) + kind, columns, look, count)
