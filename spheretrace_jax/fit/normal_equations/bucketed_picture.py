"""A picture and its target, bucket by bucket: what pixels see, and their part of the target."""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ...base.types import Ids, Index, Mask
from ...base.vec import Vec, zeros
from ...rendering.pixel_filter import NEIGHBOURS
from ...rendering.samples import point_radiance, sample_positions, sample_rays
from ...tracing.context import TraceContext
from ...tracing.material import background_color
from ...tracing.path import first_path, shade_path
from ...tracing.queries import known_hit
from ..model.target import Target
from .parameter_index import ParameterIndex
from .pixel_buckets import PixelBuckets

T = TypeVar("T")

Look = Callable[..., Vec]
"""From a context, pixels, which of them count, and a position in them to the colours seen."""


class BucketedPicture(eqx.Module):
    """A scene's picture and its target, bucket by bucket."""

    context: TraceContext
    target: Target
    exposure: Float[Array, " 3"]
    buckets: PixelBuckets
    weights: Float[Array, "5 pixels"] | None  #: of `NEIGHBOURS`; None for pixels that are points
    index: ParameterIndex = eqx.field(static=True)

    def near(self, look: Look, context: TraceContext, pixels: Ids, alive: Mask) -> Vec:
        """Returns the mean of some pixels and, by the pixel filter, a little of their neighbours.

        Says the same as `pixel_filter.filter_pixels`.
        """
        mean = partial(mean_of_samples, look, context, pixels, alive)
        if self.weights is None:
            return mean()
        neighbours = (*jnp.asarray(NEIGHBOURS, context.dtype), self.weights[:, pixels])
        return _sum(lambda x: mean((x[0], x[1])) * x[2], neighbours)

    def fold(
        self, label: Index, step: Callable[[T, Ids, Mask, Target], T], start: T, count: int
    ) -> T:
        """Folds `step` over a bucket's pixels, `count` at a time.

        **Arguments:** `step`: from the state so far, pixels, which of them count, and their part of
        the target, of shape `(1, count, 3)`, to the next state.
        """
        begin, end = self.buckets.bounds(label)
        numbers = jnp.arange(count, dtype=jnp.int32)

        def body(k: Index, state: T) -> T:
            first = begin + k * count
            alive = first + numbers < end
            pixels = lax.dynamic_slice(self.buckets.order, (first,), (count,))
            return step(state, pixels, alive, self.target_at(pixels[None], alive[None]))

        return lax.fori_loop(0, -((begin - end) // count), body, start)

    def target_at(
        self, pixels: Int[Array, "rows count"], alive: Bool[Array, "rows count"]
    ) -> Target:
        """Returns the part of the target of some pixels, of which some count."""
        take = lambda x: x.reshape(-1, 3).at[pixels].get(mode="promise_in_bounds")
        weight = jnp.where(alive[..., None], take(self.target.weight), 0)
        return Target(take(self.target.image), weight, self.target.noise, self.target.loss)


def look_by_ray(context: TraceContext, pixels: Ids, alive: Mask, *position: Array) -> Vec:
    """Returns what one ray sees of pixels."""
    del alive
    return point_radiance(context, pixels, *position)


def look_at_sky(context: TraceContext, pixels: Ids, alive: Mask, *position: Array) -> Vec:
    """Returns the background that pixels show."""
    del alive
    black = zeros(pixels.shape, context.dtype)
    if not context.needs.background:
        return black
    ray = sample_rays(context.scene, context.settings, pixels, *position)
    return black + background_color(context.scene, ray.direction)


def look_at_object(
    id_: Int[Array, ""], context: TraceContext, pixels: Ids, alive: Mask, *position: Array
) -> Vec:
    """Returns what pixels see that are known to show one object."""
    ray = sample_rays(context.scene, context.settings, pixels, *position)
    hit = known_hit(context, ray, jnp.broadcast_to(id_, pixels.shape))
    return shade_path(context, first_path(ray, hit, alive))


def mean_of_samples(
    look: Look,
    context: TraceContext,
    pixels: Ids,
    alive: Mask,
    shift: tuple[Array, Array] | None = None,
) -> Vec:
    """Returns the mean of some pixels' samples. **Arguments:** `shift`: how far beside them."""
    left, top = sample_positions(context.scene, context.settings)
    if shift is not None:
        left, top = left + shift[0], top + shift[1]
    see = lambda position: look(context, pixels, alive, *position)
    return _sum(see, (left, top)) * (1 / context.settings.samples**2)


def _sum(term: Callable[[Any], Vec], rows: Any) -> Vec:
    """Sums a term over the rows of arrays."""
    first = term(jax.tree.map(lambda x: x[0], rows))
    rest = jax.tree.map(lambda x: x[1:], rows)
    if not jax.tree.leaves(rest)[0].size:
        return first
    add = lambda total, x: (total + term(x), None)
    return lax.scan(jax.checkpoint(add), first, rest)[0]
