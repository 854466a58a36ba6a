"""Why a number may not show at all: its object is not seen, not lit, or takes no part in it."""

from collections.abc import Collection, Iterator

import jax
import numpy as np
from jaxtyping import Bool, Float

from ..model.parameters import LIGHTS, SPHERES
from ..problem.labels import CHANNELS, joined
from .evidence import Evidence, Places

#: What is no more than so many rounding errors of 1 is 0, a column of J in a picture of length 1
#: as well as what multiplies it.
ROUNDING = 1e3


def null_sphere_columns(point: Evidence) -> Iterator[tuple[str, np.ndarray]]:
    """Why numbers of spheres do not show at all, and which."""
    spheres, hidden = jax.tree.map(np.asarray, point.scenes[0].spheres), point.hidden
    names = SPHERES.keys() & set(point.free)
    for i in range(len(spheres)):
        mine, who = point.row(names, 0, i), f"sphere {i + 1}"
        gone = {n: at for n, at in mine.items() if hidden[at].any()}
        if not gone:
            continue
        seen, counts, lit = (
            any(array[i] for array in arrays)
            for arrays in zip(
                *[(s.seen, s.counts, s.lit.any(axis=0)) for s in point.shown], strict=True
            )
        )
        # the first that holds is a number's reason
        why: list[tuple[str, Collection[str]]] = []
        if _zero(spheres.color)[i].all():
            why.append((f"{who} is black", ("ka", "kd")))
        if _zero(spheres.ka)[i] and _zero(spheres.kd)[i]:
            why.append((f"{who} has ka and kd 0", ("color",)))
        if _zero(spheres.ks)[i]:
            why.append((f"{who} has ks 0", ("exponent",)))
        more = names - {n for _, which in why for n in which}
        if not counts and more and all(hidden[at].all() for at in mine.values()):
            where = " where the target counts" if seen else ""
            why = [(f"{who} is not visible{where}", names)]
        # mirrors may show more of it than the rays from the eye do
        shows = lambda name: name in mine and not hidden[mine[name]].any()
        if counts and not lit and not shows("kd"):
            why.append((f"no light reaches what is seen of {who}", ("kd", "ks", "exponent")))
        elif not shows("ks"):
            why.append((f"no highlight is seen on {who}", ("ks", "exponent")))
        why.append((f"what is seen of {who} does not depend on it", names))
        for reason, which in why:
            yield from _sentence(reason, {n: gone.pop(n) for n in which if n in gone}, hidden)


def null_light_columns(point: Evidence) -> Iterator[tuple[str, np.ndarray]]:
    """Which lights do not show, and which of the unknowns these are."""
    for own in (False, True):
        names = [n for n in LIGHTS if n in point.free and (n in point.own) == own]
        for of, at in point.apart(*names) if names else ():
            for i in range(len(point.scenes[at[0]].lights)):
                mine = point.row(names, at[0], i)
                gone = {n: x for n, x in mine.items() if point.hidden[x].any()}
                dark = i in point.unseen(at)
                why = "reaches nothing that is seen" if dark else "does not show"
                yield from _sentence(f"light {i + 1}{of} {why}", gone, point.hidden)


def _zero(x: Float[np.ndarray, "*shape"]) -> Bool[np.ndarray, "*shape"]:
    """Which numbers are 0, as far as a fit that arrived at them can tell."""
    return np.abs(x) <= ROUNDING * np.finfo(x.dtype).eps


def _sentence(why: str, where: Places, hidden: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """That some numbers, of which some are hidden, are not determined, and which are."""
    if where:
        parts = sorted(_part(name, hidden[at]) for name, at in where.items())
        at = np.concatenate(list(where.values()))
        yield f"{why}: {joined(parts)} not determined", at[hidden[at]]


def _part(name: str, hidden: np.ndarray) -> str:
    """What of a parameter is hidden."""
    name = name.removeprefix("light_")
    if name == "color" and not hidden.all():
        return f"color in {joined([c for c, gone in zip(CHANNELS, hidden, strict=True) if gone])}"
    return name
