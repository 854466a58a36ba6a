"""Candidate lists: pixels list a few spheres that pass a cheap test, then test these fully.

All pixels of a loop take as many steps as the slowest. So the steps of a search are cheap, what is
costly is done only for what the lists hold, and pixels with about as many steps go together.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..base.types import Ids, Mask, PixelArray
from ..base.vec import Vec
from ..xla.gather import take_pixels
from .binning import T, Visitor

# Candidates of a pixel that are listed before they are tested. More of them cost more for pixels
# with few; fewer of them start the search again more often.
_LISTED = 8

# Pixels that search together. A step of 256 takes 6 us, one of 2048 25.
_GROUP = 1 << 8


class Found(NamedTuple):
    """What one step of a search finds."""

    next: Ids  #: where the search goes on, -1 where it ends
    sphere: Ids  #: the number of the sphere that was found, -1 for none
    distance: PixelArray  #: the least distance at which the sphere may matter


class Search(NamedTuple):
    """Searches of pixels for spheres, in steps that find one sphere or none.

    A step finds each sphere once, and of those as near the ones of smaller numbers first.
    """

    #: from `own`, the places of searches, and the distance from which on nothing matters
    step: Callable[[Any, Ids, PixelArray], Found]
    #: from numbers of spheres to their centres, radii (nan for number -1) and ids
    sphere: Callable[[Ids], tuple[Vec, PixelArray, Ids]]
    #: from a pixel's state to the distance from which on no sphere changes the state
    max_distance: Callable[[Any], PixelArray]
    own: Any  #: what `step` is told of each pixel
    start: Ids  #: where searches start, -1 for none
    length: Ids  #: about how many steps they take
    #: whether the nearest spheres come first; else places are numbers of spheres, in whose order
    #: they come, so that a search goes on where its list was full
    sorts: bool = True


class _List(NamedTuple):
    """The next spheres of each pixel in order, and the distance from which they matter."""

    sphere: Int[Array, "listed *pixels"]  #: -1 for none
    distance: Float[Array, "listed *pixels"]  #: infinite for none


class _Last(NamedTuple):
    """The last sphere of each pixel's list, and whether there may be more after it."""

    more: Mask
    sphere: Ids
    distance: PixelArray


def visit_listed(search: Search, visitor: Visitor, rays: Any, state: T) -> T:
    """Lets pixels test the spheres that searches find; see `Bins.visit`.

    **Arguments:** `rays`: what `visitor` is told of pixels. Of it, of `search.own` and of the
    state, arrays whose last axis is as long as there are pixels have one number for each.
    """
    count = search.start.size
    size = min(_GROUP, count)
    bits = (count - 1).bit_length()
    most = (1 << (31 - bits)) - 1
    lanes = jnp.arange(count, dtype=jnp.int32)
    lanes = jnp.sort(jnp.minimum(search.length, most) << bits | lanes) & ((1 << bits) - 1)
    groups = jnp.pad(lanes, (0, -count % size), constant_values=count).reshape(-1, size)

    def visit_group(state: T, lanes: Ids) -> tuple[T, None]:
        at = jnp.minimum(lanes, count - 1)
        own, start, rays_, before = take_pixels((search.own, search.start, rays, state), at, count)
        mine = search._replace(own=own, start=jnp.where(lanes < count, start, -1))
        visit = lambda state: _visit(mine, visitor, rays_, state)
        after = lax.cond(jnp.any(mine.start >= 0), visit, lambda state: state, before)
        put = lambda x, new: x.at[..., lanes].set(new, mode="drop", unique_indices=True)
        return jax.tree.map(put, state, after), None

    return lax.scan(visit_group, state, groups)[0]


def _visit(search: Search, visitor: Visitor, rays: Any, state: T) -> T:
    """Lets one group of pixels test the spheres that their searches find."""

    def test(now: tuple[_Last, T]) -> tuple[_Last, T]:
        last, state = now
        listed = _list_next(search, last, search.max_distance(state))
        most = jnp.max(jnp.sum(listed.sphere >= 0, axis=0, dtype=jnp.int32))
        add = lambda k, state: visitor(rays, *search.sphere(listed.sphere[k]), state)
        state = lax.fori_loop(0, most, add, state)
        sphere, distance = listed.sphere[-1], listed.distance[-1]
        more = (sphere >= 0) & (distance <= search.max_distance(state))
        return _Last(more, sphere, distance), state

    proceed = lambda now: jnp.any(now[0].more)
    none = jnp.full_like(search.max_distance(state), -jnp.inf)
    last = _Last(search.start >= 0, jnp.full_like(search.start, -1), none)
    return lax.while_loop(proceed, test, (last, state))[1]


def _list_next(search: Search, after: _Last, max_distance: PixelArray) -> _List:
    """Lists the next spheres after the last ones that were listed."""

    def proceed(now: tuple[Ids, _List]) -> Bool[Array, ""]:
        return jnp.any(now[0] >= 0)

    def go_on(now: tuple[Ids, _List]) -> tuple[Ids, _List]:
        place, listed = now
        active, limit = place >= 0, jnp.minimum(listed.distance[-1], max_distance)
        found = search.step(search.own, jnp.maximum(place, 0), limit)
        new = active & (found.sphere >= 0)
        if search.sorts:
            tie = (found.distance == after.distance) & (found.sphere > after.sphere)
            new = new & ((found.distance > after.distance) | tie)
        distance = found.distance if search.sorts else jnp.zeros_like(found.distance)
        listed = _insert(listed, found.sphere, jnp.where(new, distance, jnp.inf))
        if not search.sorts:
            active = active & (listed.sphere[-1] < 0)
        return jnp.where(active, found.next, -1), listed

    start = search.start if search.sorts else jnp.maximum(search.start, after.sphere + 1)
    start = jnp.where(after.more, start, -1)
    none = jnp.full((_LISTED, *start.shape), -1, start.dtype)
    empty = _List(none, jnp.full(none.shape, jnp.inf, after.distance.dtype))
    return lax.while_loop(proceed, go_on, (start, empty))[1]


def _insert(listed: _List, sphere: Ids, distance: PixelArray) -> _List:
    """Inserts a sphere into lists sorted by distance, after those as near; infinite: nowhere."""
    sphere, distance = sphere[None], distance[None]
    shifted = lambda x, first: jnp.concatenate([jnp.full_like(x[:1], first), x[:-1]])
    before, previous = shifted(listed.sphere, -1), shifted(listed.distance, -jnp.inf)
    stays, here = listed.distance <= distance, previous <= distance
    return _List(
        jnp.where(stays, listed.sphere, jnp.where(here, sphere, before)),
        jnp.where(stays, listed.distance, jnp.maximum(previous, distance)),
    )
