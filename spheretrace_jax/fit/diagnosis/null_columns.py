"""Null columns of J: unknowns that do not show at all, and why.

Their object is not seen or not lit, or a number that multiplies them is 0.
"""

from collections.abc import Collection, Iterator

import jax
import numpy as np
from jaxtyping import Bool, Float

from ..model.accessors import LIGHTS, SPHERES
from ..problem.labels import CHANNELS, joined
from .evidence import Evidence, Indices

#: The size, in rounding errors of 1, up to which a number is 0: a column of J in a picture of norm
#: 1, and what multiplies it. A picture's sums round by fewer; what is 1,000 times as large shows.
ROUNDING = 1e3


def null_sphere_columns(evidence: Evidence) -> Iterator[tuple[str, np.ndarray]]:
    """Yields why numbers of spheres do not show at all, and their indices."""
    spheres, null = jax.tree.map(np.asarray, evidence.scenes[0].spheres), evidence.null
    names = SPHERES.keys() & set(evidence.free)
    for i in range(len(spheres)):
        indices, sphere = evidence.indices_of(names, 0, i), f"sphere {i + 1}"
        left = {n: at for n, at in indices.items() if null[at].any()}
        if not left:
            continue
        seen, counts, lit = (
            any(array[i] for array in arrays)
            for arrays in zip(
                *[(s.seen, s.counts, s.lit.any(axis=0)) for s in evidence.visible], strict=True
            )
        )
        # the first that holds is a number's reason
        reasons: list[tuple[str, Collection[str]]] = []
        if _zero(spheres.color)[i].all():
            reasons.append((f"{sphere} is black", ("ka", "kd", "ior")))
        if _zero(spheres.ka)[i] and _zero(spheres.kd)[i]:
            reasons.append((f"{sphere} has ka and kd 0", ("color",)))
        if _zero(spheres.kd)[i]:
            reasons.append((f"{sphere} has kd 0", ("ior",)))
        if _zero(spheres.ks)[i]:
            reasons.append((f"{sphere} has ks 0", ("exponent",)))
        others = names - {n for _, of_reason in reasons for n in of_reason}
        if not counts and others and all(null[at].all() for at in indices.values()):
            where = " where the target counts" if seen else ""
            reasons = [(f"{sphere} is not visible{where}", names)]
        # mirrors may show more of the sphere than the rays from the eye do
        shows = lambda name, at=indices: name in at and not null[at[name]].any()
        if counts and not lit and not shows("kd"):
            why = f"no light reaches what is seen of {sphere}"
            reasons.append((why, ("kd", "ks", "exponent", "ior")))
        elif not shows("ks"):
            reasons.append((f"no highlight is seen on {sphere}", ("ks", "exponent")))
        if _zero(spheres.ior - 1)[i]:
            reasons.append(
                (
                    f"{sphere} has ior 1 (no coat), of which pictures change only to second order",
                    ("ior",),
                )
            )
        reasons.append((f"what is seen of {sphere} does not depend on it", names))
        for why, of_reason in reasons:
            taken = {n: left.pop(n) for n in of_reason if n in left}
            yield from _sentence(why, taken, null)


def null_light_columns(evidence: Evidence) -> Iterator[tuple[str, np.ndarray]]:
    """Yields why numbers of lights do not show at all, and their indices."""
    null = evidence.null
    for apart in (False, True):
        names = [n for n in LIGHTS if n in evidence.free and (n in evidence.per_picture) == apart]
        for suffix, pictures in evidence.picture_groups(*names) if names else ():
            for i in range(len(evidence.scenes[pictures[0]].lights)):
                indices = evidence.indices_of(names, pictures[0], i)
                columns = {n: at for n, at in indices.items() if null[at].any()}
                idle = i in evidence.idle_lights(pictures)
                why = "reaches nothing that is seen" if idle else "does not show"
                yield from _sentence(f"light {i + 1}{suffix} {why}", columns, null)


def _zero(x: Float[np.ndarray, "*shape"]) -> Bool[np.ndarray, "*shape"]:
    """Returns which numbers are 0, as far as a fit that arrived at them can tell."""
    return np.abs(x) <= ROUNDING * np.finfo(x.dtype).eps


def _sentence(why: str, indices: Indices, null: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Yields that numbers, of which not all may be null, are not determined; and the null ones."""
    if indices:
        words = sorted(_null_words(name, null[at]) for name, at in indices.items())
        at = np.concatenate(list(indices.values()))
        yield f"{why}: {joined(words)} not determined", at[null[at]]


def _null_words(name: str, null: np.ndarray) -> str:
    """Returns words for the numbers of a parameter that are null."""
    name = name.removeprefix("light_")
    if name == "color" and len(null) == len(CHANNELS) and not null.all():
        return f"color in {joined([c for c, gone in zip(CHANNELS, null, strict=True) if gone])}"
    return name
