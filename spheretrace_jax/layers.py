"""Pixels with edges in them: layers from front to back, each counted by the area it covers.

What is seen of a layer is what lies inside its own outline and outside those in front of it, and
what is lit of that lies outside of shadows: convex polygons with exact areas (`halfplane.py`). Its
colour is that of the mean surface of the part inside its outline. Edges are covered at the first
hit and as they are seen in the first reflection or behind the first bubble; what is seen after a
second one is point-sampled.
"""

import dataclasses
from functools import partial

import equinox as eqx
import jax.numpy as jnp
from jax import lax

from ._types import Index, Mask, Plane
from .appearance import background, light_sums, local_color
from .camera import Ray
from .coverage import half_plane
from .halfplane import HalfPlane, common_area, everything, untouched
from .intersect import perpendicular
from .options import Options
from .outlines import crossing, outline_of
from .paths import Path, next_path
from .peel import MOST_LAYERS, peel
from .penumbra import unoccluded_part
from .phases import keep, retrace
from .radiance import radiance
from .scene import Scene
from .shading import HIGHLIGHTS, ends_abruptly, lambert, power, toward_light
from .varying import Varying
from .vec import Vec, dot, unit, where, zeros
from .world import Hit, Surface, World, chord_range, mean_root, surface_at

#: Outlines in front of a layer that are cut out of it: those next before it.
FRONTS = 3


def layered(
    scene: Scene,
    world: World,
    beam: Varying[Ray],
    options: Options,
    alive: Mask,
    leaving: Hit | None = None,
) -> Vec:
    """The mean colour that pixels see.

    **Arguments:** `beam`: the ray through the pixel's centre and how it varies. `alive`: which
    pixels there are; others are 0. `leaving`: the hit that the rays start from, None for the eye.
    """
    needs, one = options.needs, jnp.ones(alive.shape, scene.dtype)
    layers, shown = peel(world, beam, needs, alive, leaving)
    last = jnp.arange(len(shown)) == MOST_LAYERS - 1

    def add(state: tuple, x: tuple) -> tuple:
        layer, shown, last = x
        only = lambda part: jnp.where(shown, part, 0)

        # traced again inside of the branch, which else hands on all that it keeps for the reverse
        # pass, or as many zeros
        # left: what of the pixel no layer has yet; given: what the layer before, where they cut one
        # another, left to this one; fronts: where the layers before it are not
        @retrace
        def see(color: Vec, left: Plane, given: Plane, fronts: tuple) -> tuple:
            outline = keep(outline_of(world, beam, layer.hit, needs))
            own, reach, given_next = outline.region, outline.reach, jnp.zeros_like(left)
            visible, behind = (own.edge, *fronts), ~own.edge
            part = jnp.where(untouched(fronts), own.part, common_area(*visible)) + given
            if layer.behind is not None:
                cut = keep(crossing(world, beam, layer.hit, reach, layer.behind, needs))
                # the next one shows outside this outline or beyond the cut: of the two half-planes
                # that which holds more of it stands for both, and the rest is given to it
                inside = common_area(*visible, cut.region.edge, ~cut.ahead)
                outside = common_area(~own.edge, *fronts, cut.region.edge, cut.ahead)
                part = part - inside
                visible = (*visible, cut.ahead)
                behind = where(inside > outside, ~cut.ahead, behind)
                given_next = jnp.minimum(inside, outside)
            part = only(jnp.where(last, left, jnp.clip(part, 0, left)))
            seen = layer_color(
                scene, world, beam, layer.hit, reach, visible, options, shown, leaving
            )
            color = color + where(shown, seen * part, zeros(part.shape, part.dtype))
            behind = where(shown, behind, everything(part))
            return color, left - part, only(given_next), (behind, *fronts[:-1])

        stay = lambda *state: state
        return lax.cond(jnp.any(shown), see, stay, *state), None

    start = zeros(alive.shape, scene.dtype), one, 0 * one, (everything(one),) * FRONTS
    (color, left, _, _), _ = lax.scan(add, start, (layers, shown, last))
    if not needs.background:
        return color
    seen = background(scene, beam.value.direction)
    return color + where(alive, seen * left, zeros(alive.shape, scene.dtype))


def layer_color(
    scene: Scene,
    world: World,
    beam: Varying[Ray],
    hit: Hit,
    reach: Plane,
    visible: tuple[HalfPlane, ...],
    options: Options,
    alive: Mask,
    leaving: Hit | None,
) -> Vec:
    """The mean colour of the part of a pixel in which a layer is visible."""
    needs, ray = options.needs, beam.value
    mean_surface = lambda ray: surface_at(world, ray, hit, needs, reach)
    surface = mean_surface(ray)
    terms = partial(_terms, world, beam, reach, hit, surface, visible, options)
    sums = light_sums(scene, hit.id.shape, needs, terms)
    color = local_color(scene, world, hit, surface, needs, sums)
    if not options.bounces:
        return color
    later = dataclasses.replace(options, bounces=options.bounces - 1)

    def choose(choice: Index) -> Vec:
        def onward(ray: Ray, surface: Surface) -> Path:
            path = Path(ray, hit, jnp.ones_like(reach), alive, None)
            path = next_path(world, path, needs, choice, surface)
            # the mean normal of a sphere as small as the pixel is shorter than 1
            mirrored = Ray(path.ray.origin, unit(path.ray.direction))
            return eqx.tree_at(lambda p: p.ray, path, mirrored)

        path = onward(ray, surface)
        if leaving is None:
            further = beam.map(lambda ray: onward(ray, mean_surface(ray)).ray)
            seen = layered(scene, world, further, later, path.alive, path.hit)
        else:
            seen = radiance(scene, world, path.ray, later, path.hit, path.alive)[0]
            seen = where(path.alive, seen, zeros(alive.shape, scene.dtype))
        return seen * path.weight

    if not needs.branching:
        return color + choose(0)
    add = lambda total, choice: (total + choose(choice), None)
    return lax.scan(retrace(add), color, jnp.arange(2, dtype=jnp.int32))[0]


def _terms(
    world: World,
    beam: Varying[Ray],
    reach: Plane,
    hit: Hit,
    surface: Surface,
    visible: tuple[HalfPlane, ...],
    options: Options,
    light: Vec,
    shadows: bool,
) -> tuple[Plane, Plane]:
    """N.L and the highlight of one light, each over the part of what is visible that it reaches.

    The highlight ends abruptly where N.L = 0, which is an edge too.

    **Arguments:** `shadows`: whether objects may stand in the light's way.
    """
    needs, ray = options.needs, beam.value
    to_light = toward_light(surface, light)
    cosine, lit = lambert(surface, to_light), hit.id >= 0
    part = lit.astype(cosine.dtype)
    if shadows:
        part = part * unoccluded_part(world, beam, reach, visible, hit, light, needs)
    diffuse = _mean_lambert(world, ray, hit, reach, cosine, to_light) * part
    if not needs.highlights:
        return diffuse, jnp.zeros_like(diffuse)

    def front() -> Plane:
        surface = beam.map(lambda ray: surface_at(world, ray, hit, needs, reach))
        f = surface.map(lambda surface: lambert(surface, toward_light(surface, light)))
        return half_plane(f.value, f.dx, f.dy)

    abrupt = lit & ends_abruptly(options.highlight, to_light, ray.direction)
    part = part * lax.cond(jnp.any(abrupt), front, lambda: (cosine > 0).astype(part.dtype))
    exponent = world.material(hit.id, lambda m: m.exponent)
    shine = power(HIGHLIGHTS[options.highlight](surface, to_light, ray.direction), exponent)
    return diffuse, shine * part


def _mean_lambert(
    world: World, ray: Ray, hit: Hit, reach: Plane, cosine: Plane, to_light: Vec
) -> Plane:
    """The mean of max(N.L, 0), where N.L = 0 may run along the rim of a sphere.

    There N.L depends on half the chord above all, and linearly: N = (-q - h D)/R.

    **Arguments:** `reach`: as for `world.surface_at`. `cosine`: the mean of N.L.
    """
    ball = world.ball(hit.id)
    _, q = perpendicular(ray.origin, ray.direction, ball.center)
    radius = jnp.where(ball.radius > 0, ball.radius, 1)
    low, high = chord_range(q, radius, reach)
    slope = -dot(ray.direction, to_light) / radius
    h = mean_root(low, high) - cosine / jnp.where(slope == 0, 1, slope)
    # the integrand vanishes there, so that moving it changes nothing
    zero = lax.stop_gradient(jnp.clip(h, low, high))
    start, end = jnp.where(slope > 0, zero, low), jnp.where(slope > 0, high, zero)
    whole = high * high - low * low
    mixed = (hit.id < world.spheres) & (low < zero) & (zero < high) & (slope != 0)
    lit = (end * end - start * start) / jnp.where(mixed, whole, 1)
    mean = cosine + slope * (mean_root(start, end) - mean_root(low, high))
    return jnp.where(mixed, lit * mean, jnp.maximum(cosine, 0))
