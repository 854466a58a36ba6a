"""Reasons for the null space of J: directions that may not show, known without looking at J^T J."""

import dataclasses
from collections.abc import Iterator

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, PyTree

from ...scene.lights import Lights
from ...scene.parameters import LIGHT_PLACES, rows_of
from ..model.accessors import LIGHTS
from ..problem.labels import CHANNELS, joined, labels_of
from ..problem.problem import Problem
from .evidence import Arrays, Direction, Evidence
from .motion_reasons import exchange_reasons, motion_reasons
from .null_columns import null_light_columns, null_sphere_columns

# The largest difference of two lights' coordinates, as a part of the largest coordinate, up to
# which they are at one place. A larger one names lights that a fit tells apart; a smaller one
# misses those that a fit in float32 brings together.
_ONE_PLACE = 1e-6


class Reason(eqx.Module):
    """A sentence that is true if its directions do not show."""

    sentence: str
    directions: Float[np.ndarray, "free directions"]  #: of the unknowns
    certain: bool = False  #: whether it is true whatever J says, but for the errors of J


def null_space_reasons(
    problem: Problem,
    values: PyTree,
    null: Bool[np.ndarray, " free"],
    jacobians: list[Float[np.ndarray, "_ free"]],
) -> Iterator[Reason]:
    """Yields what may be true, and is if its directions do not show.

    **Arguments:** `null`: which unknowns no picture depends on. `jacobians`: the derivatives of
    each picture's free parameters by the unknowns.
    """
    evidence = Evidence(problem, values, null)
    unit, left, labels = np.eye(null.size), null.copy(), labels_of(problem)
    for sentence, at in (*null_sphere_columns(evidence), *null_light_columns(evidence)):
        left[at] = False
        yield Reason(sentence, unit[:, at])
    for label in dict.fromkeys(labels[left]):
        yield Reason(f"{label} is not determined", unit[:, left & (labels == label)])

    jacobian = np.concatenate(jacobians)
    length = np.linalg.norm(jacobian, axis=0)
    jacobian = jacobian / np.where(length > 0, length, 1)
    # nearly diagonal, so that its square loses no digits
    inverse = np.linalg.solve(jacobian.T @ jacobian + np.diag(1.0 * (length == 0)), jacobian.T)
    inverse = inverse / np.where(length > 0, length, 1)[:, None]
    for reasons in (_scale_reasons, _light_reasons, motion_reasons, exchange_reasons):
        for sentence, directions in reasons(evidence):
            flat = inverse @ np.stack([evidence.flat(d) for d in directions], axis=1)
            # what does not show at all has had a sentence already
            flat = np.where(null[:, None], 0, flat)
            certain = reasons is motion_reasons and evidence.moves_with_eye
            yield Reason(sentence, flat, certain=certain)


@dataclasses.dataclass(frozen=True)
class _Exchange:
    """A direction in which one parameter grows as others shrink, in proportion."""

    evidence: Evidence
    up: str
    down: list[str]
    pictures: list[int]
    index: tuple  #: of the numbers that change, in each parameter's array

    def __call__(self, k: int) -> Arrays:
        if k not in self.pictures:
            return {}
        natural = self.evidence.natural[k]
        shrinking = {n: -self._only(natural[n]) for n in self.down}
        return {self.up: self._only(natural[self.up])} | shrinking

    def _only(self, x: np.ndarray) -> np.ndarray:
        only = np.zeros_like(x)
        only[self.index] = x[self.index]
        return only


def _scale_reasons(evidence: Evidence) -> Iterator[tuple[str, list[Direction]]]:
    """Yields colours, coefficients and exposures that grow as others shrink, in proportion."""
    free = set(evidence.free)
    for i in range(len(evidence.scenes[0].spheres)) if "color" in free else ():
        indices = evidence.indices_of({"ka", "kd"} & free, 0, i)
        names = [n for n, at in indices.items() if not evidence.null[at].any()]
        if names:
            yield (
                f"sphere {i + 1}: the scale of color against {joined(names)} is not determined",
                [_Exchange(evidence, "color", names, evidence.all_pictures, (i,))],
            )
    words = {
        "exposure": "the exposure",
        "light_color": "the lights' color",
        "color": "the spheres' color",
    }
    pairs = (("exposure", "light_color"), ("exposure", "color"), ("light_color", "color"))
    for up, down in pairs:
        for suffix, pictures in evidence.picture_groups(up, down) if {up, down} <= free else ():
            for c, channel in enumerate(CHANNELS):
                yield (
                    f"{words[up]} against {words[down]} is not determined in {channel}{suffix}",
                    [_Exchange(evidence, up, [down], pictures, (..., c))],
                )
    # what follows from the reasons above says nothing new
    weights = sorted({"ka", "kd", "ks"} & free)
    for up in ("light_color", "exposure"):
        if up in free and weights:
            yield (
                f"{words[up]} against the spheres' {joined(weights)} is not determined",
                [_Exchange(evidence, up, weights, evidence.all_pictures, (...,))],
            )


@dataclasses.dataclass(frozen=True)
class _LightExchange:
    """A direction in which one light gains what another loses.

    Positions change in proportion to how bright the other light is.
    """

    evidence: Evidence
    name: str
    pictures: list[int]
    gaining: int
    losing: int
    component: int  #: a colour's channel or a position's coordinate

    def __call__(self, k: int) -> Arrays:
        if k not in self.pictures:
            return {}
        one, other, c = self.gaining, self.losing, self.component
        gain = np.zeros_like(self.evidence.natural[k][self.name])
        bright = np.linalg.norm(np.asarray(self.evidence.scenes[k].lights.color), axis=1)
        gain[one, c], gain[other, c] = 1, -1
        if self.name in LIGHT_PLACES:
            gain[one, c], gain[other, c] = bright[other], -bright[one]
        if self.name == "light_direction":  # a longer one turns less
            gain *= np.linalg.norm(self.evidence.natural[k][self.name], axis=1, keepdims=True)
        return {self.name: gain}


@dataclasses.dataclass(frozen=True)
class _AmbientExchange:
    """A direction in which the ambient light grows by what one light gains, and ka shrinks."""

    evidence: Evidence
    pictures: list[int]
    light: int

    def __call__(self, k: int) -> Arrays:
        natural = self.evidence.natural[k]
        gain = np.zeros_like(natural["light_color"])
        if k in self.pictures:
            gain[self.light] = natural["light_color"].sum(axis=0)
        return {"light_color": gain, "ka": -natural["ka"]}


def _light_reasons(evidence: Evidence) -> Iterator[tuple[str, list[Direction]]]:
    """Yields lights of which only what they do together shows."""
    for name in sorted(LIGHTS.keys() & set(evidence.free)):
        for suffix, pictures in evidence.picture_groups(name):
            for why, group in _alike_lights(evidence, pictures, name):
                lights = f"lights {joined([str(i + 1) for i in group])}{suffix}"
                directions: list[Direction] = [
                    _LightExchange(evidence, name, pictures, group[0], other, c)
                    for other in group[1:]
                    for c in range(3)
                ]
                end = "how they share their color" if name == "light_color" else "how they part"
                yield f"{lights} {why}: {end} is not determined", directions
    if {"light_color", "ka"} <= set(evidence.free):
        for suffix, pictures in evidence.picture_groups("light_color"):
            for i in evidence.idle_lights(pictures)[:1]:
                yield (
                    f"light {i + 1}{suffix} reaches nothing that is seen: its color against the "
                    "spheres' ka is not determined",
                    [_AmbientExchange(evidence, pictures, i)],
                )


def _alike_lights(
    evidence: Evidence, pictures: list[int], name: str
) -> Iterator[tuple[str, list[int]]]:
    """Yields groups of lights that are at one place, or reach nothing that is seen.

    **Arguments:** `name`: the parameter that the lights share: places are those of one kind.
    """
    scene, idle = evidence.scenes[pictures[0]], evidence.idle_lights(pictures)
    positions = np.concatenate([_places(evidence.scenes[k].lights) for k in pictures], axis=1)
    kinds = [name] if name in LIGHT_PLACES else list(LIGHT_PLACES)
    for kind in kinds:
        rows = np.flatnonzero(rows_of(scene, kind)).tolist()
        yield from _one_place(positions, [i for i in rows if i not in idle], kind)
    if name in LIGHT_PLACES:
        idle = [i for i in idle if rows_of(scene, name)[i]]
    if len(idle) > 1:
        yield "reach nothing that is seen", idle


def _places(lights: Lights) -> np.ndarray:
    """Returns the lights' positions, and directions of unit length."""
    places = np.asarray(lights.position, np.float64)
    length = np.linalg.norm(places, axis=1, keepdims=True)
    far = np.asarray(lights.directional, bool)[:, None]
    return places / np.where(far & (length > 0), length, 1)


def _one_place(
    positions: np.ndarray, left: list[int], kind: str
) -> Iterator[tuple[str, list[int]]]:
    """Yields groups of lights at one place. **Arguments:** `left`: the lights to look at."""
    why = "are at one place" if kind == "light_position" else "have one direction"
    while left:
        difference = np.abs(positions[left] - positions[left[0]]).max(axis=1)
        same = difference <= _ONE_PLACE * np.abs(positions[left[0]]).max()
        group = [i for i, s in zip(left, same, strict=True) if s]
        left = [i for i in left if i not in group]
        if len(group) > 1:
            yield why, group
