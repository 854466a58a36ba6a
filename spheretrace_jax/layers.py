"""Pixels with edges in them: layers from front to back, each counted by the area it covers.

A layer is an object that covers a part of the pixel's box. Its colour is that of the mean surface
of that part; shadows cover a part of it likewise. Areas of different edges are multiplied, as if
independent: exact where one edge runs through a pixel, a few pixels per picture are off where two
cross. Edges are covered at the first hit and as they are seen in the first reflection or behind
the first bubble; what is seen after a second one is point-sampled.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from ._types import Index, Mask, Plane
from .appearance import background, local_color
from .camera import Ray
from .coverage import Region, disc_region, half_plane, half_plane_region, share
from .intersect import perpendicular
from .needs import Needs
from .options import Options
from .paths import Path, next_path, radiance
from .penumbra import unoccluded_part
from .phases import fetch, keep, over
from .scene import Scene
from .shading import HIGHLIGHTS, lambert, power, toward_light
from .varying import Varying
from .vec import Vec, dot, norm, safe_sqrt, unit, where, zeros
from .visibility import row
from .world import Hit, Material, Surface, World, surface_at

#: Layers of one pixel; the last one is taken to cover all that is left of it.
MOST_LAYERS = 8


class Layer(eqx.Module):
    """What shows in a pixel, the discrete half."""

    hit: Hit
    t: Plane  #: how deep it lies
    behind: Hit | None  #: the layer behind it, where surfaces may cut one another


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
    needs, black = options.needs, zeros(alive.shape, scene.dtype)
    layers, shown = _peel(world, beam, needs, alive, leaving)

    def layer(layer: Layer, shown: Mask) -> tuple[Region, Vec]:
        def see() -> tuple[Region, Vec]:
            outline, reach = keep(covered(world, beam, layer, needs))
            color = layer_color(scene, world, beam, layer.hit, reach, options, shown, leaving)
            part = jnp.where(shown, outline.part, 0)
            return Region(part, outline.right, outline.down), where(shown, color, black)

        nothing = Region(black.x, black.x, black.x), black
        return lax.cond(jnp.any(shown), see, lambda: nothing)

    outlines, colors = lax.map(lambda x: jax.checkpoint(layer)(*x), (layers, shown))
    front, back = (jax.tree.map(lambda x, s=s: x[s], outlines) for s in (slice(-1), slice(1, None)))
    parts = jnp.concatenate([outlines.part[:1], share(front, back)])
    if len(shown) == MOST_LAYERS:
        parts = parts.at[-1].set(jnp.where(shown[-1], 1, parts[-1]))
    # what passes all layers in front, and in the end all there are
    passed = jnp.cumprod(1 - parts, axis=0)
    weight = parts * jnp.concatenate([jnp.ones_like(passed[:1]), passed[:-1]])
    color = jax.tree.map(lambda c: jnp.sum(c * weight, axis=0), colors)
    if not needs.background:
        return color
    seen = where(alive, background(scene, beam.value.direction), black)
    return color + seen * passed[-1]


def _peel(
    world: World, beam: Varying[Ray], needs: Needs, alive: Mask, leaving: Hit | None
) -> tuple[Layer, Mask]:
    """The layers from front to back, stacked, and which pixels have them; without derivatives."""
    world, beam = jax.lax.stop_gradient((world, beam))
    none = Hit(jnp.full(alive.shape, -1, world.id_type), jnp.full(alive.shape, False))
    start = Layer(
        none, jnp.zeros(alive.shape, world.window.dtype), none if needs.crossings else None
    )

    def further(state: tuple[Layer, Mask], number: Int[Array, ""]) -> tuple:
        def next_() -> tuple[Layer, Mask, Mask]:
            layer = keep(next_layer(world, beam, needs, state[0], leaving))
            some = state[1] & (layer.hit.id >= 0)
            outline, _ = covered(world, beam, layer, needs)
            return layer, some, some & (outline.part < 1)

        def stop() -> tuple[Layer, Mask, Mask]:
            return state[0], state[1], state[1]

        layer, some, more = lax.cond(jnp.any(state[1]), next_, stop)
        return (layer, more), (layer, some)

    most = min(MOST_LAYERS, world.spheres + world.planes + 1)
    return lax.scan(further, (start, alive), jnp.arange(most, dtype=jnp.int32))[1]


def next_layer(
    world: World, beam: Varying[Ray], needs: Needs, last: Layer, leaving: Hit | None
) -> Layer:
    """The nearest object behind the last layer that covers any part of the pixel."""
    shape = last.t.shape

    def enter(best: tuple, i, t: Plane, covers: Mask, inside: Mask) -> tuple:
        """Keeps the nearest two."""
        after = (t > last.t) | (t == last.t) & (i > last.hit.id)
        covers = covers & after & (t > 0)
        (t1, i1, in1), (t2, i2, in2) = best
        nearest, second = covers & (t < t1), covers & (t < t2)
        pick = lambda mask, new, old: tuple(
            jnp.where(mask, a, b) for a, b in zip(new, old, strict=True)
        )
        new = (t, i, inside)
        moved = pick(nearest, (t1, i1, in1), pick(second, new, (t2, i2, in2)))
        return pick(nearest, new, (t1, i1, in1)), moved

    def sphere(i, best: tuple) -> tuple:
        ball = row(world.balls, i)
        foot = beam.map(lambda ray: perpendicular(ray.origin, ray.direction, ball.center))
        along, q = foot.value
        reach = (norm(foot.dx[1]) + norm(foot.dy[1])) / 2
        square = ball.radius * ball.radius - dot(q, q)
        half_chord = safe_sqrt(square)
        near, far = along - half_chord, along + half_chord
        covers = norm(q) < ball.radius + reach
        own = jnp.full(shape, False) if leaving is None else leaving.id == i
        if not needs.inside:
            return enter(best, i, near, covers & ~own, jnp.full(shape, False))
        inside = (near <= 0) & (square > 0)
        if leaving is not None:
            covers, inside = covers & (~own | leaving.inside), inside | own
        return enter(best, i, jnp.where(inside, far, near), covers, inside)

    def plane(i, best: tuple) -> tuple:
        flat = row(world.flats, i)
        slope = beam.map(lambda ray: dot(ray.direction, flat.normal))
        away = dot(flat.point - beam.value.origin, flat.normal)
        side = jnp.where(away < 0, -1, 1).astype(away.dtype)
        reach = (jnp.abs(slope.dx) + jnp.abs(slope.dy)) / 2
        toward = side * slope.value
        t = jnp.abs(away) / jnp.maximum(toward, jnp.where(reach > 0, 0.1 * reach, 1))
        covers = (toward > -reach) & (away != 0)
        number = i + world.spheres
        if leaving is not None:
            covers = covers & (leaving.id != number)
        return enter(best, number, t, covers, jnp.full(shape, False))

    dtype = world.id_type
    none = (
        jnp.full(shape, jnp.inf, beam.value.direction.x.dtype),
        jnp.full(shape, -1, jnp.int32),
        jnp.full(shape, False),
    )
    best = over(world.spheres, sphere, (none, none), unroll=0)
    if needs.planes:
        best = over(world.planes, plane, best, unroll=0)
    (t, number, inside), (_, second, second_inside) = best
    behind = Hit(second.astype(dtype), second_inside) if needs.crossings else None
    return Layer(Hit(number.astype(dtype), inside), t, behind)


def covered(world: World, beam: Varying[Ray], layer: Layer, needs: Needs) -> tuple[Region, Plane]:
    """How a layer fills the pixel, and how far its edge function varies (`surface_at`)."""
    outline, reach = _outline(world, beam, layer.hit, needs)
    if layer.behind is None:
        return outline, reach
    other, other_reach = _outline(world, beam, layer.behind, needs)

    def ahead(ray: Ray) -> Plane:
        depth = lambda hit, reach: dot(
            surface_at(world, ray, hit, needs, reach).point - ray.origin, ray.direction
        )
        return depth(layer.behind, other_reach) - depth(layer.hit, reach)

    f = beam.map(ahead)
    hidden = other.part * (1 - half_plane(f.value, f.dx, f.dy))
    shows = jnp.where(layer.behind.id >= 0, 1 - hidden, 1)
    return Region(outline.part * shows, outline.right, outline.down), reach


def _outline(world: World, beam: Varying[Ray], hit: Hit, needs: Needs) -> tuple[Region, Plane]:
    """What of a pixel is inside an object's silhouette; all of it, if there is none."""
    ball = fetch(world.balls, hit.id)
    is_ball = (hit.id >= 0) & (hit.id < world.spheres)
    q = beam.map(lambda ray: perpendicular(ray.origin, ray.direction, ball.center)[1])
    radius = jnp.where(ball.radius > 0, ball.radius, 1)
    inside = disc_region(q, beam.value.direction, radius)
    part = jnp.where(is_ball & ~hit.inside, inside.part, 1)
    outline = Region(part, inside.right, inside.down)
    reach = safe_sqrt((dot(q.dx, q.dx) + dot(q.dy, q.dy)) / 8)
    if needs.planes:
        flat = fetch(world.flats, hit.id - world.spheres)
        slope = beam.map(lambda ray: dot(ray.direction, flat.normal))
        away = dot(flat.point - beam.value.origin, flat.normal)
        side = jnp.where(away < 0, -1, 1).astype(away.dtype)
        level = half_plane_region(jax.tree.map(lambda s: s * side, slope))
        level_reach = safe_sqrt(slope.dx * slope.dx + slope.dy * slope.dy) / 2
        pick = lambda a, b: jnp.where(hit.id >= world.spheres, a, b)
        outline, reach = jax.tree.map(pick, (level, level_reach), (outline, reach))
    return outline, reach


def layer_color(
    scene: Scene,
    world: World,
    beam: Varying[Ray],
    hit: Hit,
    reach: Plane,
    options: Options,
    alive: Mask,
    leaving: Hit | None,
) -> Vec:
    """The mean colour of the part of a pixel that a layer covers."""
    needs, ray = options.needs, beam.value
    mean_surface = lambda ray: surface_at(world, ray, hit, needs, reach)
    surface = beam.map(mean_surface)
    material = fetch(world.materials, hit.id)
    terms = lambda light: _terms(world, ray, hit, surface, material, light, options)
    color = local_color(scene, world, hit, surface.value, material, needs, terms)
    if not options.bounces:
        return color
    later = dataclasses.replace(options, bounces=options.bounces - 1)

    def choose(choice: Index) -> Vec:
        def onward(ray: Ray, surface: Surface) -> Path:
            path = Path(ray, hit, jnp.ones_like(reach), alive, None)
            path = next_path(world, path, surface, material, needs, choice)
            # the mean normal of a sphere as small as the pixel is shorter than 1
            mirrored = Ray(path.ray.origin, unit(path.ray.direction))
            return eqx.tree_at(lambda p: p.ray, path, mirrored)

        path = onward(ray, surface.value)
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
    return lax.scan(jax.checkpoint(add), color, jnp.arange(2, dtype=jnp.int32))[0]


def _terms(
    world: World,
    ray: Ray,
    hit: Hit,
    surface: Varying[Surface],
    material: Material,
    light: Vec,
    options: Options,
) -> tuple[Plane, Plane]:
    """N.L and the highlight of one light, each over the part of the pixel where the light reaches.

    The highlight ends abruptly where N.L = 0, which is an edge too.
    """
    needs = options.needs
    to_light = toward_light(surface.value, light)
    cosine = surface.map(lambda s: lambert(s, toward_light(s, light)))
    part = (hit.id >= 0).astype(cosine.value.dtype)
    if needs.shadows:
        point = surface.map(lambda s: s.point)
        part = part * unoccluded_part(world, point, hit, light, needs)
    diffuse = jnp.maximum(cosine.value, 0) * part
    if not needs.highlights:
        return diffuse, jnp.zeros_like(diffuse)
    towards_eye = HIGHLIGHTS[options.highlight](surface.value, to_light, ray.direction)
    shine = power(towards_eye, material.exponent)
    return diffuse, shine * part * half_plane(cosine.value, cosine.dx, cosine.dy)
