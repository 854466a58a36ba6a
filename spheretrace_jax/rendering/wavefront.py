"""Wavefront path tracing: first hits, then the radiance along reflected and transmitted paths.

Each bounce has two halves. The discrete half finds, without derivatives, the objects that paths
hit. The smooth half retraces the paths along these hits and adds their colours (`tracing/path.py`).
For the few paths of pixels with edges, `trace_path` does both halves at once.
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
"""One of `_add_all` and `_add_rows`: how to work on the surviving paths only."""

# Paths per chunk of the compacted wavefront, and neighbouring pixels per gathered row. Larger
# chunks and rows trace more dead paths. To gather each path alone takes ten times as long as rows.
CHUNK, SIDE = 1 << 13, 16


def ray_radiance(
    scene: Scene,
    world: SceneTables,
    ray: Ray,
    settings: RenderSettings,
    cone: RayCone | None = None,
) -> tuple[Vec, Mask]:
    """Computes the radiance along each primary ray, and the edge mask.

    **Arguments:** `cone`: the pixels' cones, to detect edges at the first two hits; None to skip
    the detection.

    **Returns:** the colours, and the mask of pixels through which an edge may run.
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
    """Traces a few paths bounce by bounce and returns their radiance; 0 for dead paths.

    `ray_radiance` finds all hits first, because its paths are many and few survive. Here both
    halves of a bounce run at once, which is a third as much to compile.

    **Arguments:** `path`: paths that leave their current hit.
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
    """Accumulates the radiance of all sequences of choices at branching hits.

    Where objects both reflect and transmit, a path is a sequence of choices, the bits of a number:
    reflect (0) or transmit (1) at hit b. Sequences share prefixes, so that hit b counts only in the
    sequence with choices 0 from bit b on.
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
    """Adds the radiance of all bounces after the first hit, and the edges at the first bounce.

    Compacts the wavefront: traces only surviving paths and shades only those that hit something.
    Half of a picture's paths may survive, and fewer of them hit anything (a gradient of three
    bounces takes 70 ms, not 150).
    """
    needs, shape, add, laid = settings.needs, edge.shape, _add_all, edge.shape
    # a fit's Jacobian has tables and lights per pixel, but few pixels: no compaction
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
    """Adds the values of `work` on all pixels, unless no pixel is marked.

    **Arguments:** `work`: from the inputs of pixels and the mask of marked pixels to their values.
    """
    add = lambda: jax.tree.map(jnp.add, values, work(given, marked))
    return lax.cond(jnp.any(marked), add, lambda: values)


def _add_rows(values: T, marked: Mask, work: Callable[[U, Mask], T], given: U) -> T:
    """Adds the values of `work` on the rows that contain marked pixels (stream compaction)."""

    def some(places: Ids, counts: Mask) -> T:
        take = lambda x: x.at[places].get(mode="promise_in_bounds")
        given_, marked_ = jax.tree.map(take, (given, marked))
        return work(given_, marked_ & counts[:, None])

    return add_where(values, jnp.any(marked, axis=1), some, CHUNK // marked.shape[1])


class _Found(eqx.Module):
    """The hits of paths at one bounce, as integers that are 0 for dead paths (for `add_where`)."""

    id: Ids  #: one more than the id of the object hit
    inside: Int8[Array, "*pixels"]
    on: Int8[Array, "*pixels"]  #: 1 if the path survives
    edge: Int8[Array, "*pixels"]  #: 1 if an edge may run through the pixel


def _follow(
    scene: Scene,
    world: SceneTables,
    first: Path,
    on: Mask,
    settings: RenderSettings,
    choices: Int[Array, ""],
    add: Add,
) -> tuple[Hit, Mask]:
    """Traces the hits of paths from their first bounce on; the discrete half, no derivatives.

    Only hits are stored; each bounce retraces the paths from their hits.

    **Arguments:** `on`: the mask of surviving paths. `add`: works on these paths only.

    **Returns:** the hits, with an axis for the bounces from the first on. Also the mask of pixels
    through which an edge may run at the first bounce.
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
    """Retraces paths along their first `number` hits."""

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
    """Shades paths along their hits from the first bounce on; the smooth half.

    **Arguments:** `hits`: from `_follow`.
    """
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
