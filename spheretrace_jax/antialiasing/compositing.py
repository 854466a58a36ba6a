"""Compositing: the colour of a pixel from its layers, each counted by the area that it covers.

What is seen of a layer is what lies inside its own silhouette and outside those in front of it, and
what is lit of that lies outside of shadows: convex polygons with exact areas (`polygon.py`). A
layer's colour is that of the mean surface of the part inside its silhouette.
"""

from functools import partial
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool

from ..base.safe_math import clamp, larger, smaller
from ..base.types import Ids, Index, Mask, PixelArray
from ..base.vec import Vec, split, where, zeros
from ..scene.camera import Ray, unit_ray
from ..scene.light import Light
from ..tracing.context import TraceContext
from ..tracing.differential import Differential
from ..tracing.fresnel import coat_transmission
from ..tracing.hit import Hit, Surface
from ..tracing.material import background_color, finish_of, local_color, sum_lights
from ..tracing.path import Path, first_path, next_path, trace_path
from ..tracing.shading import HIGHLIGHTS, Finish, lambert, power
from ..tracing.surface import mean_surface_at
from ..xla.barriers import barrier
from ..xla.compaction import add_where
from ..xla.rematerialization import remat
from .coverage import half_plane_area
from .depth_peeling import MOST_LAYERS, Layer, peel_layers
from .polygon import HalfPlane, Polygon, clip_pixel, clipped_area, contain_pixel, whole_pixel
from .shadow_edges import lit_coverage
from .silhouette import (
    SilhouetteDistance,
    mean_surface,
    silhouette_distance,
    silhouette_region,
    surface_crossing,
)

T = TypeVar("T")

#: How many layers in front, the nearest ones, are cut out of a layer. Each more costs one more side
#: of every polygon.
FRONTS = 3

# Least area of a part of a pixel that is told from 0, in eps of its type.
_ROUNDING = 64


class Layers(eqx.Module):
    """The layers of pixels, from front to back, in arrays of one row for each."""

    hit: Hit
    shown: Mask  #: true in pixels that have such a layer
    area: PixelArray  #: the part of the pixel that the layer covers, 0..1


class VisibleLayer(eqx.Module):
    """One layer of pixels, and the polygon in which the layer is visible."""

    ray: Differential[Ray]
    hit: Hit
    distance: SilhouetteDistance
    surface: Surface  #: the mean surface inside the silhouette
    polygon: Polygon


class VisibleLayers(NamedTuple):
    """The layers of pixels in which something shows, from front to back, one row for each."""

    layer: VisibleLayer
    shown: Mask  #: true in pixels that have such a layer
    area: PixelArray  #: the part of the pixel that the layer covers, 0..1

    @property
    def found(self) -> Layers:
        """Returns the layers' hits and areas alone."""
        return Layers(self.layer.hit, self.shown, self.area)


class _State(NamedTuple):
    """What remains of pixels for the layers behind."""

    uncovered: PixelArray  #: the part of the pixel that no layer has yet
    handed_on: PixelArray  #: what the layer in front did not take, where the two cut one another
    outside_fronts: tuple[HalfPlane, ...]  #: the outsides of the silhouettes in front


def composite_layers(
    context: TraceContext,
    ray: Differential[Ray],
    alive: Mask,
    source_hit: Hit | None = None,
    follow: Bool[Array, ""] | None = None,
) -> tuple[Vec, Layers]:
    """Returns the mean colour that pixels see, and their layers.

    **Arguments:** as for `visible_layers`. `follow`: whether the ray at the centre is followed on
    from what it meets, None for never.
    """
    layers, uncovered = visible_layers(context, ray, alive, source_hit)
    count = alive.size
    black = zeros((layers.shown.size,), context.dtype)

    def radiance(places: Ids, shown: Mask) -> Vec:
        number, pixel = places // count, places % count
        layer, _, area = rows_at(layers, number, pixel, count)
        seen = layer_radiance(context.at_pixels(pixel), layer, shown, follow)
        return where(shown, seen * area, zeros(shown.shape, context.dtype))

    # of most pixels one or two layers show: the shown ones are shaded together, whatever their
    # number, so many at a time as there are pixels
    colors = add_where(black, layers.shown.reshape(-1), radiance, count, rematerialize=True)
    color = jax.tree.map(lambda x: jnp.sum(x.reshape(-1, count), axis=0), colors)
    if context.needs.background:
        sky = background_color(context.scene, ray.value.direction)
        color = color + where(alive, sky * uncovered, zeros(alive.shape, context.dtype))
    return color, layers.found


def rows_at(rows: T, number: Ids, pixel: Ids, count: int) -> T:
    """Returns what some rows of pixel arrays hold for some pixels.

    **Arguments:** `rows`: a pytree of arrays of shape `(rows, ..., count)`, or `(rows, ..., 1)`
    where pixels share it.
    """

    def take(x: Array) -> Array:
        at = pixel if x.shape[-1] == count else jnp.zeros_like(pixel)
        taken = jnp.moveaxis(x, -1, 1).at[number, at].get(mode="promise_in_bounds")
        return jnp.moveaxis(taken, 0, -1)

    return jax.tree.map(take, rows)


def visible_layers(
    context: TraceContext, ray: Differential[Ray], alive: Mask, source_hit: Hit | None = None
) -> tuple[VisibleLayers, PixelArray]:
    """Returns the layers that show in pixels, and the part of each pixel that none covers.

    **Arguments:** `ray`: through the pixel's centre, with its differentials. `alive`: true where
    there is a pixel. `source_hit`: the hit that the rays start from, None for the eye.
    """
    one = jnp.ones(alive.shape, context.dtype)
    layers, shown = peel_layers(context, ray, alive, source_hit)
    last = jnp.arange(len(shown)) == MOST_LAYERS - 1

    def add_layer(state: _State, inputs: tuple[Layer, Mask, Mask]) -> tuple[_State, VisibleLayers]:
        @remat
        def add(state: _State) -> tuple[_State, VisibleLayers]:
            return _clip_layer(context, ray, state, *inputs)

        nothing = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(add, state)[1])
        return lax.cond(jnp.any(inputs[1]), add, lambda state: (state, nothing), state)

    start = _State(one, 0 * one, (whole_pixel(one),) * FRONTS)
    state, visible = lax.scan(add_layer, start, (layers, shown, last))
    return visible, state.uncovered


def _clip_layer(
    context: TraceContext,
    ray: Differential[Ray],
    state: _State,
    layer: Layer,
    shown: Mask,
    last: Mask,
) -> tuple[_State, VisibleLayers]:
    """Clips one layer to where it shows, and what is behind to the rest of the pixel."""
    uncovered, handed_on, fronts = state
    only = lambda area: jnp.where(shown, area, 0)
    distance = silhouette_distance(context, ray, layer.hit)
    region = barrier(silhouette_region(context, ray.value, layer.hit, distance))
    hand_on = jnp.zeros_like(uncovered)
    visible, behind = clip_pixel(region.edge, *fronts), ~region.edge
    area = jnp.where(contain_pixel(fronts), region.area, visible.area) + handed_on
    if layer.behind is not None:
        surface = mean_surface(context, ray, layer.hit, distance)
        cut = barrier(surface_crossing(context, ray, surface, layer.behind))
        # the next one shows outside this silhouette or beyond the cut: of the two half-planes that
        # which holds more of it stands for both, and the rest is given to it
        inside = clipped_area(*visible.sides, cut.region.edge, ~cut.ahead)
        outside = clipped_area(~region.edge, *fronts, cut.region.edge, cut.ahead)
        area = area - inside
        visible = clip_pixel(*visible.sides, cut.ahead)
        # an area that is a rounding error does not decide, as the half-planes may be far apart
        behind = where(
            inside > outside + _ROUNDING * float(jnp.finfo(area.dtype).eps), ~cut.ahead, behind
        )
        hand_on = smaller(inside, outside)
    area = only(jnp.where(last, uncovered, clamp(area, 0, uncovered)))
    mean = mean_surface_at(context, ray.value, distance.q.value, layer.hit, distance.extent)
    pixel = VisibleLayer(ray, layer.hit, distance, mean, visible)
    behind = where(shown, behind, whole_pixel(area))
    state = _State(uncovered - area, only(hand_on), (behind, *fronts[:-1]))
    # what layers in front hide wholly is not shaded, nor looked on from
    return state, VisibleLayers(pixel, shown & (area > 0), area)


def layer_radiance(
    context: TraceContext, layer: VisibleLayer, alive: Mask, follow: Bool[Array, ""] | None
) -> Vec:
    """Returns the mean colour of the part of a pixel in which a layer is visible.

    **Arguments:** `alive`: true in pixels that have the layer. `follow`: as for
    `composite_layers`.
    """
    terms = partial(layer_light_terms, context, layer)
    # shadow edges are half of what is compiled: once, not for each light (of three 6.1, not 8.7 s)
    sums = barrier(sum_lights(context, layer.hit.id.shape, terms, most=1))
    color = local_color(context, layer.hit, layer.surface, sums)
    if follow is None:
        return color

    def add_way(color: Vec, choice: Index) -> tuple[Vec, None]:
        path = secondary_path(context, layer.ray.value, layer.surface, layer.hit, alive, choice)
        return color + trace_path(context, split(path)), None

    def add_all_ways() -> Vec:
        if not context.needs.branching:
            return add_way(color, jnp.zeros((), jnp.int32))[0]
        return lax.scan(remat(add_way), color, jnp.arange(2, dtype=jnp.int32))[0]

    return lax.cond(follow, add_all_ways, lambda: color)


def secondary_path(
    context: TraceContext, ray: Ray, surface: Surface, hit: Hit, alive: Mask, choice: Index | Ids
) -> Path:
    """Returns the path mirrored in a mean surface, or straight on, as `next_path` says."""
    path = next_path(context, first_path(ray, hit, alive), choice, surface)
    # the mean normal of a sphere as small as the pixel is shorter than 1
    return eqx.tree_at(lambda p: p.ray, path, unit_ray(path.ray))


def layer_light_terms(
    context: TraceContext,
    layer: VisibleLayer,
    light: Light,
    shadows: bool,
    finish: Finish | None = None,
) -> tuple[PixelArray, PixelArray]:
    """Returns N.L and the highlight of one light, each over the part that the light reaches.

    The highlight ends abruptly where N.L = 0, which is an edge too.

    **Arguments:** `shadows`: false where no object can stand in the light's way. `finish`: None
    for that of the objects.
    """
    ray, hit, surface, distance = layer.ray.value, layer.hit, layer.surface, layer.distance
    highlight = HIGHLIGHTS[context.settings.highlight]
    to_light = light.direction(surface.point)
    cosine, lit = lambert(surface, to_light), hit.id >= 0
    part = lit.astype(cosine.dtype)
    if shadows:
        part = part * lit_coverage(context, layer.ray, distance.extent, layer.polygon, hit, light)
    finish = finish_of(context, hit.id) if finish is None else finish
    diffuse = _mean_lambert(context, layer, cosine, to_light) * part
    faded = partial(light.faded, surface.point)
    if finish.ior is not None:
        diffuse = diffuse * _mean_coat(context, layer, cosine, to_light, finish.ior)
    if finish.exponent is None:
        return faded(diffuse), jnp.zeros_like(diffuse)

    def front_area() -> PixelArray:
        f = layer.ray.paired_with(distance.q).map(
            lambda both: _cosine_at(context, *both, layer, light)
        )
        return half_plane_area(f.value, f.dx, f.dy)

    abrupt = lit & highlight.ends_abruptly(to_light, ray.direction)
    front = lambda: (cosine > 0).astype(part.dtype)
    part = part * lax.cond(jnp.any(abrupt), front_area, front)
    shine = power(highlight.cosine(surface, to_light, ray.direction), finish.exponent)
    return faded(diffuse), faded(shine * part)


def _cosine_at(
    context: TraceContext, ray: Ray, q: Vec, layer: VisibleLayer, light: Light
) -> PixelArray:
    """Returns N.L of the mean surface that another ray of the pixel sees."""
    surface = mean_surface_at(context, ray, q, layer.hit, layer.distance.extent)
    return lambert(surface, light.direction(surface.point))


def _mean_lambert(
    context: TraceContext, layer: VisibleLayer, cosine: PixelArray, to_light: Vec
) -> PixelArray:
    """Returns the mean of max(N.L, 0), where N.L = 0 may run along the rim of a sphere.

    **Arguments:** `cosine`: the mean of N.L.
    """
    ray, hit, distance = layer.ray.value, layer.hit, layer.distance
    mean, mixed = context.sphere(hit.id).mean_lambert(
        ray, distance.q.value, distance.extent, cosine, to_light
    )
    mixed = mixed & ~context.tables.is_plane(hit.id)
    return jnp.where(mixed, mean, larger(cosine, 0))


def _mean_coat(
    context: TraceContext, layer: VisibleLayer, cosine: PixelArray, to_light: Vec, ior: PixelArray
) -> PixelArray:
    """Returns the part of a pixel's max(N.L, 0) that a coat lets through.

    **Arguments:** as for `_mean_lambert`.
    """
    ray, hit, distance = layer.ray.value, layer.hit, layer.distance
    points = context.sphere(hit.id).rim_cosines(
        ray, distance.q.value, distance.extent, cosine, to_light
    )
    through, lit = jnp.zeros_like(cosine), jnp.zeros_like(cosine)
    for cos_light, cos_view in points:
        part = larger(cos_light, 0)
        through, lit = through + part * coat_transmission(cos_light, cos_view, ior), lit + part
    mixed = (lit > 0) & ~context.tables.is_plane(hit.id)
    even = coat_transmission(cosine, layer.surface.cos_view, ior)
    return jnp.where(mixed, through / jnp.where(mixed, lit, 1), even)
