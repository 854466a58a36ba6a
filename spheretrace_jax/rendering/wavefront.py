"""The wavefront: what rays from the eye see at their first hit and, bounce by bounce, beyond it.

Each bounce has two halves. The discrete half finds, without derivatives, which objects are met; the
smooth half follows the paths along these objects and adds their colours (`tracing/path.py`). The
few paths of pixels with edges take both at once (`path.trace_path`); a test holds the two together.
"""

import math
from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int, Int8

from ..antialiasing.edge_mask import edge_mask
from ..base.types import Ids, Index, Mask
from ..base.vec import Vec, zeros
from ..scene.camera import Ray
from ..tracing.cone import RayCone
from ..tracing.context import TraceContext
from ..tracing.hit import Hit
from ..tracing.path import Path, continues, first_path, fold_sequences, next_path, shade_path
from ..tracing.queries import closest_hit
from ..xla.compaction import add_where
from ..xla.rematerialization import remat, save_residuals

T = TypeVar("T")
U = TypeVar("U")

Add = Callable[[Any, Mask, Callable, Any], Any]
"""One of `_add_everywhere` and `_add_rows`."""

# Surviving paths are traced this many at a time, in rows of so many neighbours. Smaller chunks pay
# more overhead each; rows of 1 take ten times as long to gather.
CHUNK, ROW = 1 << 13, 16


def ray_radiance(context: TraceContext, ray: Ray, cone: RayCone | None = None) -> tuple[Vec, Mask]:
    """Returns the colour that each ray from the eye sees, and where an edge may run through.

    **Arguments:** `cone`: how wide the pixels are, None to look for no edges. Edges are looked for
    at the first two hits.
    """
    hit = closest_hit(context, ray)
    first = first_path(ray, hit, jnp.full(hit.id.shape, True), cone)
    edge = jnp.full(hit.id.shape, False)
    if cone is not None:
        edge = edge_mask(context, ray, cone, hit)
    color = shade_path(context, first)
    if context.settings.bounces == 0:
        return color, edge

    def add_sequence(seen: tuple[Vec, Mask], choices: Int[Array, ""]) -> tuple:
        return _add_bounces(context, first, seen, choices), None

    return fold_sequences(add_sequence, (color, edge), context.settings)


def _add_bounces(
    context: TraceContext, first: Path, seen: tuple[Vec, Mask], choices: Int[Array, ""]
) -> tuple[Vec, Mask]:
    """Adds what paths see from their first bounce on, and the edges at that bounce.

    Compacts the wavefront: traces only surviving paths and shades only those that hit something (a
    gradient of three bounces takes 70 ms, not 150).
    """
    needs, shape = context.needs, seen[1].shape
    add, laid = _add_everywhere, shape
    # in a fit's Jacobian pixels have tables and lights of their own; they are few
    if seen[1].size > CHUNK and context.pixel_tables is None:
        add, laid = _add_rows, (-1, math.gcd(seen[1].size, ROW))
    lay = lambda x: jnp.broadcast_to(x, shape).reshape(laid)
    first, color, edge = jax.tree.map(lay, (first, *seen))

    alive = context.compute_once(lambda: continues(context, first, choices & 1))
    hits, edges = save_residuals(_Bounces(context, first, choices, add).trace(alive))

    @remat
    def shaded(paths_and_hits: tuple[Path, Hit], counts: Mask) -> Vec:
        path, hits = paths_and_hits
        path = eqx.tree_at(lambda p: p.alive, path, path.alive & counts)
        return _shade_bounces(context, path, hits, choices)

    meets = alive if needs.background else jnp.any(hits.id >= 0, axis=1)
    without_cone = eqx.tree_at(lambda p: p.cone, first, None, is_leaf=lambda x: x is None)
    color = add(color, meets, shaded, (without_cone, hits))
    return jax.tree.map(lambda x: x.reshape(shape), (color, edge | edges))


def _add_everywhere(values: T, mask: Mask, work: Callable[[U, Mask], T], inputs: U) -> T:
    """Adds what `work` returns to `values`, if the mask is set anywhere.

    **Arguments:** `work`: from the inputs of some pixels, and their mask, to values.
    """
    add = lambda: jax.tree.map(jnp.add, values, work(inputs, mask))
    return lax.cond(jnp.any(mask), add, lambda: values)


def _add_rows(values: T, mask: Mask, work: Callable[[U, Mask], T], inputs: U) -> T:
    """Adds what `work` returns to `values`, only in rows of pixels with the mask set.

    **Arguments:** as for `_add_everywhere`.
    """

    def work_on_rows(rows: Ids, counts: Mask) -> T:
        take = lambda x: x.at[rows].get(mode="promise_in_bounds")
        inputs_, mask_ = jax.tree.map(take, (inputs, mask))
        return work(inputs_, mask_ & counts[:, None])

    return add_where(values, jnp.any(mask, axis=1), work_on_rows, CHUNK // mask.shape[1])


class _Found(eqx.Module):
    """The hits of a bounce, as numbers that are 0 where paths are not followed."""

    id: Ids  #: one more than the number of the object hit
    inside: Int8[Array, "*pixels"]
    alive: Int8[Array, "*pixels"]  #: 1 where the path goes on
    edge: Int8[Array, "*pixels"]  #: 1 where an edge may run through the pixel


class _Bounces(eqx.Module):
    """The discrete half: finds what paths hit from their first bounce on, without derivatives.

    Of paths only their hits are kept, from which the paths are found again at each bounce.
    """

    context: TraceContext
    first: Path
    choices: Int[Array, ""]
    add: Add = eqx.field(static=True)  #: how to work only on paths that are alive

    def trace(self, alive: Mask) -> tuple[Hit, Mask]:
        """Traces the paths that are alive.

        **Returns:** the hits, with an axis for the bounces after the first one, and where an edge
        may run through the pixel at the first bounce.
        """
        self = lax.stop_gradient(self)
        count = self.context.settings.bounces + 1
        room = lambda x: jnp.zeros((len(x), count, *x.shape[1:]), x.dtype).at[:, 0].set(x)
        start = jax.tree.map(room, self.first.hit), alive, jnp.full(alive.shape, False)
        # no bound method: `scan` hashes its function, and a module of arrays has no hash
        bounce = lambda state, number: self._bounce(state, number)
        (hits, _, edge), _ = lax.scan(bounce, start, jnp.arange(1, count, dtype=jnp.int32))
        return jax.tree.map(lambda x: x[:, 1:], hits), edge

    def _bounce(self, state: tuple[Hit, Mask, Mask], number: Index) -> tuple[tuple, None]:
        hits, alive, edge = state
        work = lambda inputs, alive: self._find(number, inputs, alive)
        none = jnp.zeros(alive.shape, jnp.int8)
        nothing = _Found(jnp.zeros_like(self.first.hit.id), none, none, none)
        new = self.add(nothing, alive, work, (self.first, hits))
        put = lambda all_, one: all_.at[:, number].set(one, mode="drop")
        hits = jax.tree.map(put, hits, Hit(new.id - 1, new.inside > 0))
        return (hits, new.alive > 0, edge | (new.edge > 0)), None

    def _find(self, number: Index, paths_and_hits: tuple[Path, Hit], alive: Mask) -> _Found:
        """Finds the hits of one bounce."""
        context, (path, hits) = self.context, paths_and_hits
        path = eqx.tree_at(lambda p: p.alive, path, alive)
        path = self._path_after(number, path, hits)
        hit = closest_hit(context, path.ray, path.hit)
        edge = jnp.full(alive.shape, False)
        if (cone := path.cone) is not None:
            look = lambda: edge_mask(context, path.ray, cone, hit, path.hit, alive)
            edge = lax.cond(number == 1, look, lambda: edge)
        path = eqx.tree_at(lambda p: p.hit, path, hit)
        further = continues(context, path, self.choices >> number & 1)
        one = lambda mask: (mask & alive).astype(jnp.int8)
        return _Found(jnp.where(alive, hit.id + 1, 0), one(hit.inside), one(further), one(edge))

    def _path_after(self, number: Index, path: Path, hits: Hit) -> Path:
        """Returns paths after so many of their hits."""

        def step(path: Path, known: tuple[Index, Hit]) -> tuple[Path, None]:
            k, hit = known

            def go_on(path: Path) -> Path:
                path = eqx.tree_at(lambda p: p.hit, path, hit)
                return next_path(self.context, path, self.choices >> k & 1)

            return lax.cond(k < number, go_on, lambda path: path, path), None

        hits = jax.tree.map(lambda x: jnp.moveaxis(x[:, :-1], 1, 0), hits)
        numbers = jnp.arange(self.context.settings.bounces, dtype=jnp.int32)
        return lax.scan(step, path, (numbers, hits))[0]


def _shade_bounces(context: TraceContext, path: Path, hits: Hit, choices: Int[Array, ""]) -> Vec:
    """Returns what paths see from their first bounce on: the smooth half.

    **Arguments:** `hits`: those of `_Bounces.trace`.
    """
    needs = context.needs

    def bounce(state: tuple[Path, Vec], known: tuple[Index, Hit]) -> tuple[tuple[Path, Vec], None]:
        number, hit = known
        choice = choices >> (number - 1) & 1

        def go_on(path: Path, color: Vec) -> tuple[Path, Vec]:
            path = next_path(context, path, choice)
            path = eqx.tree_at(lambda p: p.hit, path, hit)
            adds = (choices >> number == 0).astype(context.dtype)  # see `fold_sequences`
            return path, color + shade_path(context, path) * adds

        stop = lambda path, color: (eqx.tree_at(lambda p: p.hit, path, hit), color)
        alive = continues(context, state[0], choice) if needs.background else hit.id >= 0
        return lax.cond(jnp.any(alive), go_on, stop, *state), None

    numbers = jnp.arange(1, context.settings.bounces + 1, dtype=jnp.int32)
    hits = jax.tree.map(lambda x: jnp.moveaxis(x, 1, 0), hits)
    start = path, zeros(path.alive.shape, context.dtype)
    return lax.scan(bounce, start, (numbers, hits))[0][1]
