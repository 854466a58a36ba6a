"""Paths of rays: what a ray sees where it meets an object, and where the path goes on.

Each bounce has two halves. The discrete one finds, without derivatives, which object is met and
which lights reach it; the smooth one evaluates the lecture's formulas with those objects' rows and
is what jax differentiates.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from ._types import Index, Mask, Plane
from .appearance import background, light_sums, local_color
from .camera import Ray
from .edges import Cone, near_edge, onward
from .needs import Needs
from .options import Options
from .phases import materialise, materialise_pair, remember
from .scene import Scene
from .shading import light_terms
from .vec import Vec, grey, reflect, where, zeros
from .visibility import nearest, unoccluded
from .world import Hit, Surface, World, surface_at


class Path(eqx.Module):
    """Where a path is after some bounces."""

    ray: Ray
    hit: Hit  #: what the ray meets
    weight: Plane  #: what its colour counts: the product of the kgr and kt so far
    alive: Mask  #: whether there is a ray at all
    cone: Cone | None  #: how wide the pixel is; None if edges do not matter any more


def radiance(
    scene: Scene,
    world: World,
    ray: Ray,
    options: Options,
    leaving: Hit | None = None,
    alive: Mask | None = None,
    cone: Cone | None = None,
) -> tuple[Vec, Mask]:
    """The colour that each ray sees, and whether an edge may run through its pixel.

    **Arguments:** `leaving`: the hit that the rays start from, None for rays from the eye.
    `alive`: which rays there are. `cone`: how wide the pixels are, None to look for no edges,
    which are looked for at the first two hits.
    """
    hit = nearest(world, ray, options.needs, leaving)
    one = jnp.ones_like(ray.direction.x)
    alive = jnp.full(one.shape, True) if alive is None else alive
    first = Path(ray, hit, one, alive, cone)
    edge = jnp.full(one.shape, False)
    if cone is not None:
        edge = near_edge(world, scene.lights.position, ray, cone, hit, leaving, options)
    if options.bounces == 0:
        return shade(scene, world, first, options)[0], edge
    if options.needs.branching:
        color, more = _branching(scene, world, first, options)
        return color, edge | more
    color, path = shade(scene, world, first, options)
    color, more = _follow(scene, world, path, color, options, jnp.zeros((), jnp.int32))
    return color, edge | more


def _branching(scene: Scene, world: World, first: Path, options: Options) -> tuple[Vec, Mask]:
    """The sum over all paths where objects both reflect and transmit.

    A path is a sequence of choices, bit b of a number: reflect (0) or go straight on (1) at hit b.
    Paths share beginnings, so hit b counts only in the path that chooses 0 from there on.
    """

    def path(total: tuple[Vec, Mask], choices: Int[Array, ""]) -> tuple[tuple[Vec, Mask], None]:
        color, path = shade(scene, world, first, options, choices & 1)
        color = color * (choices == 0).astype(scene.dtype)
        color, edge = _follow(scene, world, path, color, options, choices)
        return (total[0] + color, total[1] | edge), None

    numbers = jnp.arange(1 << options.bounces, dtype=jnp.int32)
    shape = first.weight.shape
    start = zeros(shape, scene.dtype), jnp.full(shape, False)
    return lax.scan(jax.checkpoint(path), start, numbers)[0]


def _follow(
    scene: Scene,
    world: World,
    path: Path,
    color: Vec,
    options: Options,
    choices: Int[Array, ""],
) -> tuple[Vec, Mask]:
    """Adds what a path sees from its first bounce on, as long as any ray of the strip is alive.

    **Returns:** the colour, and whether an edge may run through the pixel at the first bounce.
    """
    lights, cone = scene.lights.position, path.cone
    path = eqx.tree_at(lambda p: p.cone, path, None, is_leaf=lambda x: x is None)

    def look(path: Path, hit: Hit, cone: Cone) -> Mask:
        return path.alive & near_edge(world, lights, path.ray, cone, hit, path.hit, options)

    def bounce(state: tuple, number: Int[Array, ""]) -> tuple[tuple, None]:
        def go_on(path: Path, color: Vec, edge: Mask) -> tuple[Path, Vec, Mask]:
            hit = nearest(world, path.ray, options.needs, path.hit)
            if cone is not None:
                skip = lambda *_: jnp.full(edge.shape, False)
                edge = edge | lax.cond(number == 1, look, skip, path, hit, cone)
            path = eqx.tree_at(lambda p: p.hit, path, hit)
            later = choices >> number
            more, path = shade(scene, world, path, options, later & 1)
            return path, color + more * (later == 0).astype(scene.dtype), edge

        def stop(*state):
            return state

        return lax.cond(jnp.any(state[0].alive), go_on, stop, *state), None

    start = path, color, jnp.full(path.alive.shape, False)
    numbers = jnp.arange(1, options.bounces + 1, dtype=jnp.int32)
    (_, color, edge), _ = lax.scan(bounce, start, numbers)
    return color, edge


def shade(
    scene: Scene,
    world: World,
    path: Path,
    options: Options,
    choice: Index = 0,
) -> tuple[Vec, Path]:
    """What a path's present hit adds to the picture, and the path that goes on from there.

    **Arguments:** `choice`: where an object both reflects and transmits, 0 to reflect.
    """
    needs, ray, hit = options.needs, path.ray, path.hit
    terms = partial(light_terms_at, world, ray, hit, options)
    sums = light_sums(scene, hit.id.shape, needs, terms)

    def seen_color() -> Vec:
        surface = surface_at(world, ray, hit, needs)
        color, seen = local_color(scene, world, hit, surface, needs, sums), path.alive
        if needs.background:
            color = where(hit.id >= 0, color, background(scene, ray.direction))
        else:
            seen = seen & (hit.id >= 0)
        return where(seen, color * path.weight, zeros(path.weight.shape, scene.dtype))

    if needs.colors:
        color = materialise(seen_color, world.window)
    else:
        color = grey(materialise(lambda: seen_color().x, world.window))
    if not needs.bounces:
        return color, path
    surface = surface_at(world, ray, hit, needs)
    return color, next_path(world, path, surface, needs, choice)


def light_terms_at(
    world: World, ray: Ray, hit: Hit, options: Options, light: Vec, shadows: bool
) -> tuple[Plane, Plane]:
    """N.L and the highlight of one light where rays meet objects, 0 where it does not reach.

    **Arguments:** `shadows`: whether objects may stand in its way.
    """
    needs = options.needs
    highlight = options.highlight if needs.highlights else None
    lit = hit.id >= 0
    if shadows:

        def sees_light() -> Mask:
            point = surface_at(world, ray, hit, needs).point
            return unoccluded(world, point, hit, light, needs)

        lit = lit & remember(materialise(sees_light, world.window))

    def terms() -> tuple[Plane, Plane]:
        surface = surface_at(world, ray, hit, needs)
        exponent = world.material(hit.id, lambda m: m.exponent)
        return light_terms(surface, ray.direction, light, exponent, lit, highlight)

    return materialise_pair(terms, world.window) if highlight else terms()


def next_path(
    world: World,
    path: Path,
    surface: Surface,
    needs: Needs,
    choice: Index,
) -> Path:
    """The path mirrored in the surface, or straight on through it, with its weight.

    The ray straight on skips the object (a bubble without refraction); see `nearest`.
    """
    kgr, kt = world.material(path.hit.id, lambda m: (m.kgr, m.kt))
    if not needs.transmission:
        straight, weight = None, kgr
    elif not needs.reflection:
        straight, weight = jnp.full(kt.shape, True), kt
    elif needs.branching:
        straight = jnp.full(kt.shape, choice == 1)
        weight = jnp.where(straight, kt, kgr)
    else:
        straight = lax.stop_gradient(kt) != 0
        weight = jnp.where(straight, kt, kgr)
    weight = path.weight * weight
    alive = path.alive & (path.hit.id >= 0)
    if not needs.dark_paths:
        alive = alive & (lax.stop_gradient(weight) != 0)
    direction = reflect(path.ray.direction, surface.normal)
    hit = path.hit
    if straight is not None:
        direction = where(straight, path.ray.direction, direction)
        hit = Hit(hit.id, hit.inside & ~straight)
    cone = path.cone
    if cone is not None:
        mirrored = jnp.full(weight.shape, True) if straight is None else ~straight
        cone = onward(cone, world, path.ray, path.hit, surface, mirrored)
    return Path(Ray(surface.point, direction), hit, weight, alive, cone)
