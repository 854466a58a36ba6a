"""What rays see: their first hits, and what their paths see from the first bounce on.

Each bounce has two halves. The discrete one finds, without derivatives, which objects are met; the
smooth one follows the path along these and adds their colours (`paths.py`). Of the few paths of
pixels with edges both are done at once (`followed`).
"""

import math
from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int, Int8

from ..antialiasing.edge_mask import RayCone, edge_mask
from ..base.types import Ids, Index, Mask
from ..base.vec import Vec, zeros
from ..scene.camera import Ray
from ..scene.scene import Scene
from ..scene.settings import RenderSettings
from ..tracing.path import Path, continues, next_path, shade_path
from ..tracing.queries import closest_hit
from ..tracing.tables import Hit, SceneTables
from ..xla.barriers import compute_once
from ..xla.compaction import add_where
from ..xla.rematerialization import remat, save_residuals

T = TypeVar("T")
U = TypeVar("U")

Add = Callable[[Any, Mask, Callable, Any], Any]
"""One of `_add_all` and `_add_rows`."""

# Paths are followed beyond their first hit this many at a time, in rows of so many neighbours: to
# look up each of them takes ten times as long.
CHUNK, SIDE = 1 << 13, 16


def ray_radiance(
    scene: Scene,
    world: SceneTables,
    ray: Ray,
    settings: RenderSettings,
    cone: RayCone | None = None,
) -> tuple[Vec, Mask]:
    """The colour that each ray from the eye sees, and whether an edge may run through its pixel.

    **Arguments:** `cone`: how wide the pixels are, None to look for no edges, which are looked for
    at the first two hits.
    """
    hit = closest_hit(world, ray, settings.needs)
    one = jnp.ones_like(ray.direction.x)
    first = Path(ray, hit, one, jnp.full(one.shape, True), cone)
    edge = jnp.full(one.shape, False)
    if cone is not None:
        edge = edge_mask(world, scene.lights.position, ray, cone, hit, None, settings)
    color = shade_path(scene, world, first, settings)
    if settings.bounces == 0:
        return color, edge

    def path(seen: tuple[Vec, Mask], choices: Int[Array, ""]) -> tuple[tuple[Vec, Mask], None]:
        return _further(scene, world, first, *seen, settings, choices), None

    return _sequences(path, (color, edge), settings)


def trace_path(scene: Scene, world: SceneTables, path: Path, settings: RenderSettings) -> Vec:
    """What a few paths see from where they are, bounce by bounce; 0 where there are none.

    `radiance` finds all hits first, as paths are many and few go on; to do the work of each bounce
    at once is a third as much to compile.

    **Arguments:** `path`: just after a hit, which it leaves.
    """
    needs = settings.needs

    def sequence(color: Vec, choices: Int[Array, ""]) -> tuple[Vec, None]:
        def bounce(state: tuple[Path, Vec], number: Index) -> tuple[tuple[Path, Vec], None]:
            def go_on(path: Path, color: Vec) -> tuple[Path, Vec]:
                hit = closest_hit(world, path.ray, needs, path.hit)
                path = eqx.tree_at(lambda p: p.hit, path, hit)
                counts = (choices >> number == 0).astype(scene.dtype)
                color = color + shade_path(scene, world, path, settings) * counts
                return next_path(world, path, needs, choices >> number & 1), color

            stay = lambda *state: state
            return lax.cond(jnp.any(state[0].alive), go_on, stay, *state), None

        numbers = jnp.arange(settings.bounces + 1, dtype=jnp.int32)
        return lax.scan(bounce, (path, color), numbers)[0][1], None

    black = zeros(path.alive.shape, scene.dtype)
    return _sequences(sequence, black, settings)


def _sequences(
    seen: Callable[[T, Int[Array, ""]], tuple[T, None]], start: T, settings: RenderSettings
) -> T:
    """What all sequences of choices see.

    Where objects both reflect and transmit, a path is a sequence of choices, bit b of a number:
    reflect (0) or go straight on (1) at hit b. Sequences share beginnings, so hit b counts only in
    the one that chooses 0 from there on.
    """
    if not settings.needs.branching:
        return seen(start, jnp.zeros((), jnp.int32))[0]
    numbers = jnp.arange(1 << settings.bounces, dtype=jnp.int32)
    return lax.scan(jax.checkpoint(seen), start, numbers)[0]


def _further(
    scene: Scene,
    world: SceneTables,
    first: Path,
    color: Vec,
    edge: Mask,
    settings: RenderSettings,
    choices: Int[Array, ""],
) -> tuple[Vec, Mask]:
    """Adds what paths see from their first bounce on, and the edges at that.

    Of a picture's paths half may go on, and fewer meet anything then: only these are followed, and
    only those shaded (a gradient of three bounces takes 70 ms, not 150).
    """
    needs, shape, add, laid = settings.needs, edge.shape, _add_all, edge.shape
    # in a fit's Jacobian pixels have tables and lights of their own; they are few
    if edge.size > CHUNK and world.own is None:
        add, laid = _add_rows, (-1, math.gcd(edge.size, SIDE))
    place = lambda x: jnp.broadcast_to(x, shape).reshape(laid)
    first, color, edge = jax.tree.map(place, (first, color, edge))

    on = compute_once(lambda: continues(world, first, needs, choices & 1), world.window)
    hits, edges = save_residuals(_follow(scene, world, first, on, settings, choices, add))

    @remat
    def shaded(given: tuple[Path, Hit], counts: Mask) -> Vec:
        path, hits = given
        path = eqx.tree_at(lambda p: p.alive, path, path.alive & counts)
        return _shaded(scene, world, path, hits, settings, choices)

    meets = on if needs.background else jnp.any(hits.id >= 0, axis=1)
    bare = eqx.tree_at(lambda p: p.cone, first, None, is_leaf=lambda x: x is None)
    color = add(color, meets, shaded, (bare, hits))
    return jax.tree.map(lambda x: x.reshape(shape), (color, edge | edges))


def _add_all(values: T, marked: Mask, work: Callable[[U, Mask], T], given: U) -> T:
    """`values` with those of `work` added, if any are marked.

    **Arguments:** `work`: from what is given of some pixels, and which of them are marked.
    """
    add = lambda: jax.tree.map(jnp.add, values, work(given, marked))
    return lax.cond(jnp.any(marked), add, lambda: values)


def _add_rows(values: T, marked: Mask, work: Callable[[U, Mask], T], given: U) -> T:
    """The same, but only rows of pixels are worked on in which some are marked."""

    def some(places: Ids, counts: Mask) -> T:
        take = lambda x: x.at[places].get(mode="promise_in_bounds")
        given_, marked_ = jax.tree.map(take, (given, marked))
        return work(given_, marked_ & counts[:, None])

    return add_where(values, jnp.any(marked, axis=1), some, CHUNK // marked.shape[1])


class _Found(eqx.Module):
    """What is found of paths at a bounce, as numbers that are 0 where they are not followed."""

    id: Ids  #: one more than the number of the object hit
    inside: Int8[Array, "*pixels"]
    on: Int8[Array, "*pixels"]  #: whether the path goes on
    edge: Int8[Array, "*pixels"]  #: whether an edge may run through the pixel


def _follow(
    scene: Scene,
    world: SceneTables,
    first: Path,
    on: Mask,
    settings: RenderSettings,
    choices: Int[Array, ""],
    add: Add,
) -> tuple[Hit, Mask]:
    """What paths hit from their first bounce on; without derivatives.

    What is kept of paths are their hits, from which they are found again at each bounce.

    **Arguments:** `on`: which paths go on. `add`: how to work on these only.

    **Returns:** the hits, with an axis for the bounces after the first one, and whether an edge may
    run through the pixel at the first bounce.
    """
    needs, lights = settings.needs, scene.lights.position
    world, first, lights = lax.stop_gradient((world, first, lights))

    def found(number: Index, path: Path, hits: Hit, on: Mask) -> _Found:
        path = eqx.tree_at(lambda p: p.alive, path, on)
        path = _after(world, path, hits, number, settings, choices)
        hit = closest_hit(world, path.ray, needs, path.hit)
        edge = jnp.full(on.shape, False)
        if (cone := path.cone) is not None:
            look = lambda: edge_mask(world, lights, path.ray, cone, hit, path.hit, settings)
            edge = lax.cond(number == 1, look, lambda: edge)
        path = eqx.tree_at(lambda p: p.hit, path, hit)
        further = continues(world, path, needs, choices >> number & 1)
        one = lambda mask: (mask & on).astype(jnp.int8)
        return _Found(jnp.where(on, hit.id + 1, 0), one(hit.inside), one(further), one(edge))

    def bounce(state: tuple[Hit, Mask, Mask], number: Index) -> tuple[tuple, None]:
        hits, on, edge = state
        work = lambda given, on: found(number, given[0], given[1], on)
        none = jnp.zeros(on.shape, jnp.int8)
        new = add(_Found(jnp.zeros_like(first.hit.id), none, none, none), on, work, (first, hits))
        put = lambda all_, one: all_.at[:, number].set(one, mode="drop")
        hits = jax.tree.map(put, hits, Hit(new.id - 1, new.inside > 0))
        return (hits, new.on > 0, edge | (new.edge > 0)), None

    count = settings.bounces + 1
    room = lambda x: jnp.zeros((len(x), count, *x.shape[1:]), x.dtype).at[:, 0].set(x)
    start = jax.tree.map(room, first.hit), on, jnp.full(on.shape, False)
    (hits, _, edge), _ = lax.scan(bounce, start, jnp.arange(1, count, dtype=jnp.int32))
    return jax.tree.map(lambda x: x[:, 1:], hits), edge


def _after(
    world: SceneTables,
    path: Path,
    hits: Hit,
    number: Index,
    settings: RenderSettings,
    choices: Int[Array, ""],
) -> Path:
    """A path after so many of its hits."""

    def step(path: Path, known: tuple[Index, Hit]) -> tuple[Path, None]:
        k, hit = known

        def on(path: Path) -> Path:
            path = eqx.tree_at(lambda p: p.hit, path, hit)
            return next_path(world, path, settings.needs, choices >> k & 1)

        return lax.cond(k < number, on, lambda path: path, path), None

    hits = jax.tree.map(lambda x: jnp.moveaxis(x[:, :-1], 1, 0), hits)
    return lax.scan(step, path, (jnp.arange(settings.bounces, dtype=jnp.int32), hits))[0]


def _shaded(
    scene: Scene,
    world: SceneTables,
    path: Path,
    hits: Hit,
    settings: RenderSettings,
    choices: Int[Array, ""],
) -> Vec:
    """What paths see from their first bounce on. **Arguments:** `hits`: those of `_follow`."""
    needs = settings.needs

    def bounce(state: tuple[Path, Vec], known: tuple[Index, Hit]) -> tuple[tuple[Path, Vec], None]:
        number, hit = known
        choice = choices >> (number - 1) & 1

        def go_on(path: Path, color: Vec) -> tuple[Path, Vec]:
            path = next_path(world, path, needs, choice)
            path = eqx.tree_at(lambda p: p.hit, path, hit)
            counts = (choices >> number == 0).astype(scene.dtype)
            return path, color + shade_path(scene, world, path, settings) * counts

        stop = lambda path, color: (eqx.tree_at(lambda p: p.hit, path, hit), color)
        on = continues(world, state[0], needs, choice) if needs.background else hit.id >= 0
        return lax.cond(jnp.any(on), go_on, stop, *state), None

    numbers = jnp.arange(1, settings.bounces + 1, dtype=jnp.int32)
    hits = jax.tree.map(lambda x: jnp.moveaxis(x, 1, 0), hits)
    start = path, zeros(path.alive.shape, scene.dtype)
    return lax.scan(bounce, start, (numbers, hits))[0][1]
