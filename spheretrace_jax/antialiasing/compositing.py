"""What a beam sees: layers from front to back, each counted by the area it covers.

What is seen of a layer is what lies inside its own outline and outside those in front of it, and
what is lit of that lies outside of shadows: convex polygons with exact areas (`halfplane.py`). Its
colour is that of the mean surface of the part inside its outline.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool

from ..base.safe_math import clamp, larger, smaller
from ..base.types import Index, Mask, PixelArray
from ..base.vec import Vec, dot, where, zeros
from ..rendering.wavefront import trace_path
from ..scene.camera import Ray, unit_ray
from ..scene.needs import Needs
from ..scene.scene import Scene
from ..scene.settings import RenderSettings
from ..tracing.material import background_color, local_color, sum_lights
from ..tracing.path import Path, next_path
from ..tracing.shading import HIGHLIGHTS, ends_abruptly, lambert, power, toward_light
from ..tracing.tables import Hit, SceneTables, Surface, chord_range, mean_root, mean_surface_at
from ..xla.barriers import barrier
from ..xla.rematerialization import remat
from .coverage import half_plane_area
from .depth_peeling import MOST_LAYERS, peel_layers
from .differential import Differential
from .polygon import Polygon, clip_pixel, clipped_area, contain_pixel, whole_pixel
from .shadow_edges import lit_coverage
from .silhouette import (
    SilhouetteDistance,
    mean_surface,
    silhouette_distance,
    silhouette_region,
    surface_crossing,
)

#: Outlines in front of a layer that are cut out of it: those next before it.
FRONTS = 3


class Layers(eqx.Module):
    """The layers that a beam meets, from front to back, in arrays of one row for each."""

    hit: Hit
    shown: Mask  #: in which pixels there is such a layer
    part: PixelArray  #: how much of the pixel it covers, 0..1

    def layer(self, number: Index) -> "Layers":
        """One of them."""
        return jax.tree.map(lambda x: x[number], self)


def composite_layers(
    scene: Scene,
    world: SceneTables,
    beam: Differential[Ray],
    settings: RenderSettings,
    alive: Mask,
    leaving: Hit | None = None,
    follow: Bool[Array, ""] | None = None,
) -> tuple[Vec, Layers]:
    """The mean colour that pixels see, and in which layers.

    **Arguments:** `beam`: the ray through the pixel's centre and how it varies. `alive`: which
    pixels there are; others are 0. `leaving`: the hit that the rays start from, None for the eye.
    `follow`: whether the ray at the centre is followed on from what it meets, None for never.
    """
    needs, one = settings.needs, jnp.ones(alive.shape, scene.dtype)
    layers, shown = peel_layers(world, beam, needs, alive, leaving)
    last = jnp.arange(len(shown)) == MOST_LAYERS - 1

    def add(state: tuple, x: tuple) -> tuple:
        layer, shown, last = x
        only = lambda part: jnp.where(shown, part, 0)

        # traced again inside of the branch, which else hands on all that it keeps for the reverse
        # pass, or as many zeros
        # left: what of the pixel no layer has yet; given: what the layer before, where they cut one
        # another, left to this one; fronts: where the layers before it are not
        @remat
        def see(color: Vec, left: PixelArray, given: PixelArray, fronts: tuple) -> tuple:
            rim = silhouette_distance(world, beam, layer.hit, needs)
            own = barrier(silhouette_region(world, beam, layer.hit, rim))
            given_next = jnp.zeros_like(left)
            visible, behind = clip_pixel(own.edge, *fronts), ~own.edge
            part = jnp.where(contain_pixel(fronts), own.part, visible.area) + given
            if layer.behind is not None:
                surface = mean_surface(world, beam, layer.hit, rim, needs)
                cut = barrier(surface_crossing(world, beam, surface, layer.behind, needs))
                # the next one shows outside this outline or beyond the cut: of the two half-planes
                # that which holds more of it stands for both, and the rest is given to it
                inside = clipped_area(*visible.sides, cut.region.edge, ~cut.ahead)
                outside = clipped_area(~own.edge, *fronts, cut.region.edge, cut.ahead)
                part = part - inside
                visible = clip_pixel(*visible.sides, cut.ahead)
                behind = where(inside > outside, ~cut.ahead, behind)
                given_next = smaller(inside, outside)
            part = only(jnp.where(last, left, clamp(part, 0, left)))
            seen = layer_radiance(
                scene, world, beam, layer.hit, rim, visible, settings, shown, follow
            )
            color = color + where(shown, seen * part, zeros(part.shape, part.dtype))
            behind = where(shown, behind, whole_pixel(part))
            return (color, left - part, only(given_next), (behind, *fronts[:-1])), part

        stay = lambda *state: (state, jnp.zeros_like(one))
        return lax.cond(jnp.any(shown), see, stay, *state)

    start = zeros(alive.shape, scene.dtype), one, 0 * one, (whole_pixel(one),) * FRONTS
    (color, left, _, _), part = lax.scan(add, start, (layers, shown, last))
    seen = Layers(layers.hit, shown, part)
    if not needs.background:
        return color, seen
    sky = background_color(scene, beam.value.direction)
    return color + where(alive, sky * left, zeros(alive.shape, scene.dtype)), seen


def layer_radiance(
    scene: Scene,
    world: SceneTables,
    beam: Differential[Ray],
    hit: Hit,
    rim: SilhouetteDistance,
    visible: Polygon,
    settings: RenderSettings,
    alive: Mask,
    follow: Bool[Array, ""] | None,
) -> Vec:
    """The mean colour of the part of a pixel in which a layer is visible."""
    needs, ray = settings.needs, beam.value
    surface = mean_surface_at(world, ray, rim.q.value, hit, needs, rim.reach)
    terms = partial(_terms, world, beam, hit, rim, surface, visible, settings)
    # shadow edges are half of what is compiled: once, not for each light (of three 6.1, not 8.7 s)
    sums = barrier(sum_lights(scene, hit.id.shape, needs, terms, most=1))
    color = local_color(scene, world, hit, surface, needs, sums)
    if follow is None:
        return color

    def further(color: Vec, choice: Index) -> tuple[Vec, None]:
        path = secondary_path(world, ray, surface, hit, alive, needs, choice)
        return color + trace_path(scene, world, path, settings), None

    def all_ways() -> Vec:
        if not needs.branching:
            return further(color, jnp.zeros((), jnp.int32))[0]
        return lax.scan(remat(further), color, jnp.arange(2, dtype=jnp.int32))[0]

    return lax.cond(follow, all_ways, lambda: color)


def secondary_path(
    world: SceneTables,
    ray: Ray,
    surface: Surface,
    hit: Hit,
    alive: Mask,
    needs: Needs,
    choice: Index,
) -> Path:
    """The path mirrored in a mean surface, or straight on, as `next_path` says."""
    path = Path(ray, hit, jnp.ones(alive.shape, surface.facing.dtype), alive, None)
    path = next_path(world, path, needs, choice, surface)
    # the mean normal of a sphere as small as the pixel is shorter than 1
    return eqx.tree_at(lambda p: p.ray, path, unit_ray(path.ray))


def _terms(
    world: SceneTables,
    beam: Differential[Ray],
    hit: Hit,
    rim: SilhouetteDistance,
    surface: Surface,
    visible: Polygon,
    settings: RenderSettings,
    light: Vec,
    shadows: bool,
) -> tuple[PixelArray, PixelArray]:
    """N.L and the highlight of one light, each over the part of what is visible that it reaches.

    The highlight ends abruptly where N.L = 0, which is an edge too.

    **Arguments:** `shadows`: whether objects may stand in the light's way.
    """
    needs, ray = settings.needs, beam.value
    to_light = toward_light(surface, light)
    cosine, lit = lambert(surface, to_light), hit.id >= 0
    part = lit.astype(cosine.dtype)
    if shadows:
        part = part * lit_coverage(world, beam, rim.reach, visible, hit, light, needs)
    diffuse = _mean_lambert(world, ray, hit, rim, cosine, to_light) * part
    if not needs.highlights:
        return diffuse, jnp.zeros_like(diffuse)

    def front() -> PixelArray:
        def toward(both: tuple[Ray, Vec]) -> PixelArray:
            surface = mean_surface_at(world, *both, hit, needs, rim.reach)
            return lambert(surface, toward_light(surface, light))

        f = beam.beside(rim.q).map(toward)
        return half_plane_area(f.value, f.dx, f.dy)

    abrupt = lit & ends_abruptly(settings.highlight, to_light, ray.direction)
    part = part * lax.cond(jnp.any(abrupt), front, lambda: (cosine > 0).astype(part.dtype))
    exponent = world.material(hit.id, lambda m: m.exponent)
    shine = power(HIGHLIGHTS[settings.highlight](surface, to_light, ray.direction), exponent)
    return diffuse, shine * part


def _mean_lambert(
    world: SceneTables,
    ray: Ray,
    hit: Hit,
    rim: SilhouetteDistance,
    cosine: PixelArray,
    to_light: Vec,
) -> PixelArray:
    """The mean of max(N.L, 0), where N.L = 0 may run along the rim of a sphere.

    There N.L depends on half the chord above all, and linearly: N = (-q - h D)/R.

    **Arguments:** `cosine`: the mean of N.L.
    """
    ball = world.ball(hit.id)
    radius = jnp.where(ball.radius > 0, ball.radius, 1)
    low, high = chord_range(rim.q.value, radius, rim.reach)
    slope = -dot(ray.direction, to_light) / radius
    h = mean_root(low, high) - cosine / jnp.where(slope == 0, 1, slope)
    # the integrand vanishes there, so that moving it changes nothing
    zero = jnp.clip(*lax.stop_gradient((h, low, high)))
    start, end = jnp.where(slope > 0, zero, low), jnp.where(slope > 0, high, zero)
    whole = high * high - low * low
    mixed = (hit.id < world.spheres) & (low < zero) & (zero < high) & (slope != 0)
    lit = (end * end - start * start) / jnp.where(mixed, whole, 1)
    mean = cosine + slope * (mean_root(start, end) - mean_root(low, high))
    return jnp.where(mixed, lit * mean, larger(cosine, 0))
