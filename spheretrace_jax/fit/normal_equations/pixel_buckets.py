"""Pixel buckets: pixels sorted by what they show, so that those with the same columns are together.

A bucket for each object, for the background if it moves, for pixels that show several objects, and
for those with edges.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from ...base.types import Ids, Mask
from ...rendering.samples import sample_positions, sample_rays
from ...tracing.context import TraceContext
from ...tracing.queries import closest_hit
from ...xla.loops import STRIP_PIXELS, keep_loop_parallel
from .parameter_index import ParameterIndex

#: The bucket before those of the objects and of a background that moves (`ParameterIndex.each`):
#: pixels that nothing free moves. Those after them: pixels that show several objects, those with
#: edges, and those that do not count.
STILL, SEVERAL, EDGE, NONE = -1, 0, 1, 2

#: The most pixels of a bucket that are looked at at once.
MOST = 1 << 12


class PixelBuckets(eqx.Module):
    """The pixels, bucket by bucket."""

    order: Int[Array, " padded"]  #: bucket by bucket; then `MOST` zeros
    starts: Int[Array, " buckets"]  #: where each begins, from that of `STILL` on, and the end

    def bounds(
        self, label: Int[Array, "*labels"] | int
    ) -> tuple[Int[Array, "*labels"], Int[Array, "*labels"]]:
        """Returns where a bucket begins and ends, or several do."""
        return self.starts[label - STILL], self.starts[label - STILL + 1]


def bucket_pixels(
    context: TraceContext,
    index: ParameterIndex,
    counts: Mask | None = None,
    edge: Mask | None = None,
) -> PixelBuckets:
    """Sorts pixels into buckets, without derivatives.

    **Arguments:** `context`: not accelerated, as pixels are in no strip. `counts`: which pixels do,
    by default all. `edge`: where there may be edges.
    """
    label = _labels(context, index)
    if edge is not None:
        label = jnp.where(edge.reshape(-1), len(index.each) + EDGE, label)
    if counts is not None:
        label = jnp.where(counts.reshape(-1), label, len(index.each) + NONE)
    order = _sorted(label - STILL, len(index.each) + NONE - STILL + 1)
    numbers = jnp.arange(STILL, len(index.each) + NONE + 1, dtype=label.dtype)
    starts = jnp.searchsorted(label[order], numbers, side="left").astype(jnp.int32)
    return PixelBuckets(jnp.pad(order, (0, MOST)), starts)


def _sorted(label: Int[Array, " pixels"], labels: int) -> Int[Array, " pixels"]:
    """Sorts pixels by label.

    One number that holds label and pixel sorts 6 times faster than two numbers.
    """
    if labels * label.size >= 1 << 32:
        return jnp.argsort(label, stable=True).astype(jnp.int32)
    size, pixels = jnp.uint32(label.size), jnp.arange(label.size, dtype=jnp.uint32)
    return (jnp.sort(label.astype(jnp.uint32) * size + pixels) % size).astype(jnp.int32)


def _labels(context: TraceContext, index: ParameterIndex) -> Int[Array, " pixels"]:
    """Returns the label of each pixel's bucket, edges left aside."""
    context = lax.stop_gradient(context)
    settings, objects = context.settings, context.tables.object_count
    sky = objects if index.camera and context.scene.sky is not None else STILL
    path_ends = _path_ends(context)
    positions = sample_positions(context.scene, settings)
    size = settings.width * settings.rows.count
    strips = -(-size // STRIP_PIXELS)
    strip = -(-size // strips)

    def label(first: Int[Array, ""]) -> Ids:
        pixels = keep_loop_parallel(first) + jnp.arange(strip, dtype=jnp.int32)

        def first_hit(position: tuple) -> Ids:
            ray = sample_rays(context.scene, settings, pixels, *position)
            return closest_hit(context, ray).id.astype(jnp.int32)

        seen = first_hit(jax.tree.map(lambda p: p[0], positions))
        same = jnp.full(seen.shape, True)
        if settings.samples > 1:
            add = lambda same, position: (same & (first_hit(position) == seen), None)
            same, _ = lax.scan(add, same, jax.tree.map(lambda p: p[1:], positions))
        alone = jnp.where(seen >= 0, seen, sky)
        return jnp.where(same & path_ends[seen], alone, len(index.each) + SEVERAL)

    return lax.map(label, strip * jnp.arange(strips, dtype=jnp.int32)).reshape(-1)[:size]


def _path_ends(context: TraceContext) -> Bool[Array, " labels"]:
    """Tests at which objects paths end; the last entry is for no object, -1."""
    objects, materials = context.tables.object_count, context.tables.materials
    if not context.settings.bounces:
        return jnp.full(objects + 1, True)
    if context.needs.dark_paths:
        return jnp.arange(objects + 1) >= objects
    return jnp.append((materials.kgr == 0) & (materials.kt == 0), True)
