"""Why a number may not show in any picture: what is known without looking at J^T J."""

from collections.abc import Callable, Collection, Iterator
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, PyTree

from ...scene.camera import view_frame
from ..model.parameters import LIGHTS
from ..problem.labels import CHANNELS, joined, labels_of
from ..problem.problem import Problem
from .evidence import Evidence, Move, Numbers
from .null_columns import null_light_columns, null_sphere_columns

# Lights are at one place if no coordinates differ by more than this part of the largest.
_ONE_PLACE = 1e-6


class Reason(eqx.Module):
    """A sentence that may be true."""

    sentence: str
    directions: Float[np.ndarray, "free directions"]  #: of the unknowns, which do not show then
    certain: bool = False  #: whether it is true whatever J says, but for its own errors


def null_space_reasons(
    problem: Problem,
    values: PyTree,
    hidden: Bool[np.ndarray, " free"],
    slopes: list[Float[np.ndarray, "_ free"]],
) -> Iterator[Reason]:
    """What may be true, and is if its directions do not show.

    **Arguments:** `hidden`: which unknowns no picture depends on. `slopes`: of each picture's
    free parameters the derivatives by the unknowns.
    """
    point = Evidence(problem, values, hidden)
    unit, left, names = np.eye(hidden.size), hidden.copy(), labels_of(problem)
    for sentence, at in (*null_sphere_columns(point), *null_light_columns(point)):
        left[at] = False
        yield Reason(sentence, unit[:, at])
    for name in dict.fromkeys(names[left]):
        yield Reason(f"{name} is not determined", unit[:, left & (names == name)])

    slope = np.concatenate(slopes)
    length = np.linalg.norm(slope, axis=0)
    slope = slope / np.where(length > 0, length, 1)
    # nearly diagonal, so that its square loses no digits
    back = np.linalg.solve(slope.T @ slope + np.diag(1.0 * (length == 0)), slope.T)
    back = back / np.where(length > 0, length, 1)[:, None]
    for of in (_scales, _lights, _world):
        for sentence, moves in of(point):
            directions = back @ np.stack([point.change(move) for move in moves], axis=1)
            # what does not show at all has had a sentence of its own
            directions = np.where(hidden[:, None], 0, directions)
            yield Reason(sentence, directions, certain=of is _world and point.nothing_stays)


def _scales(point: Evidence) -> Iterator[tuple[str, list[Move]]]:
    """Colours, coefficients and exposures that grow as others shrink, in proportion."""
    free = set(point.free)

    def grow(up: str, down: Collection[str], at: list[int], *part: Any) -> Move:
        """**Arguments:** `at`: in which pictures. `part`: the indices of what takes part."""

        def only(x: np.ndarray) -> np.ndarray:
            some = np.zeros_like(x)
            some[part] = x[part]
            return some

        def move(k: int) -> Numbers:
            if k not in at:
                return {}
            natural = point.natural[k]
            return {up: only(natural[up])} | {n: -only(natural[n]) for n in down}

        return move

    for i in range(len(point.scenes[0].spheres)) if "color" in free else ():
        mine = point.row({"ka", "kd"} & free, 0, i)
        names = [n for n, at in mine.items() if not point.hidden[at].any()]
        if names:
            yield (
                f"sphere {i + 1}: the scale of color against {joined(names)} is not determined",
                [grow("color", names, point.every, i)],
            )
    what = {
        "exposure": "the exposure",
        "light_color": "the lights' color",
        "color": "the spheres' color",
    }
    pairs = (("exposure", "light_color"), ("exposure", "color"), ("light_color", "color"))
    for up, down in pairs:
        for of, at in point.apart(up, down) if {up, down} <= free else ():
            for c, channel in enumerate(CHANNELS):
                yield (
                    f"{what[up]} against {what[down]} is not determined in {channel}{of}",
                    [grow(up, [down], at, ..., c)],
                )
    # what follows from those above says nothing new
    weights = sorted({"ka", "kd", "ks"} & free)
    for up in ("light_color", "exposure"):
        if up in free and weights:
            yield (
                f"{what[up]} against the spheres' {joined(weights)} is not determined",
                [grow(up, weights, point.every, ...)],
            )


def _lights(point: Evidence) -> Iterator[tuple[str, list[Move]]]:
    """Lights of which only what they do together shows."""
    for name in sorted(LIGHTS.keys() & set(point.free)):
        for of, at in point.apart(name):
            for why, group in _alike(point, at):
                who = f"lights {joined([str(i + 1) for i in group])}{of}"
                moves = [
                    _exchange(point, name, at, group[0], other, c)
                    for other in group[1:]
                    for c in range(3)
                ]
                end = "how they share their color" if name == "light_color" else "how they part"
                yield f"{who} {why}: {end} is not determined", moves
    if {"light_color", "ka"} <= set(point.free):
        for of, at in point.apart("light_color"):
            for i in point.unseen(at)[:1]:
                yield (
                    f"light {i + 1}{of} reaches nothing that is seen: its color against the "
                    "spheres' ka is not determined",
                    [_ambient(point, at, i)],
                )


def _alike(point: Evidence, at: list[int]) -> Iterator[tuple[str, list[int]]]:
    """Lights that are at one place, or of which none reaches what is seen, in some pictures."""
    place = np.concatenate([np.asarray(point.scenes[k].lights.position) for k in at], axis=1)
    left = [i for i in range(len(place)) if i not in point.unseen(at)]
    while left:
        apart = np.abs(place[left] - place[left[0]]).max(axis=1)
        same = apart <= _ONE_PLACE * np.abs(place[left[0]]).max()
        group = [i for i, s in zip(left, same, strict=True) if s]
        left = [i for i in left if i not in group]
        if len(group) > 1:
            yield "are at one place", group
    if len(point.unseen(at)) > 1:
        yield "reach nothing that is seen", point.unseen(at)


def _exchange(point: Evidence, name: str, at: list[int], one: int, other: int, part: int) -> Move:
    """What one light gains the other loses; of places, in proportion to how bright they are."""

    def move(k: int) -> Numbers:
        if k not in at:
            return {}
        gain = np.zeros_like(point.natural[k][name])
        bright = np.linalg.norm(np.asarray(point.scenes[k].lights.color), axis=1)
        gain[one, part], gain[other, part] = 1, -1
        if name == "light_position":
            gain[one, part], gain[other, part] = bright[other], -bright[one]
        return {name: gain}

    return move


def _ambient(point: Evidence, at: list[int], light: int) -> Move:
    """The ambient light grows by what a light gains, and ka shrinks."""

    def move(k: int) -> Numbers:
        natural = point.natural[k]
        gain = np.zeros_like(natural["light_color"])
        if k in at:
            gain[light] = natural["light_color"].sum(axis=0)
        return {"light_color": gain, "ka": -natural["ka"]}

    return move


def _world(point: Evidence) -> Iterator[tuple[str, list[Move]]]:
    """Everything that moves together with the eye, or grows."""
    row = lambda v: np.array([[v.x, v.y, v.z]], float)
    frames = [view_frame(scene.camera) for scene in point.scenes]
    back = [-row(frame.forward) for frame in frames]
    mu = [float(scene.camera.mu) for scene in point.scenes]
    free = set(point.free)

    def everything(place: Callable[[np.ndarray, int], np.ndarray], **others: Callable) -> Move:
        """**Arguments:** `place`: how places change, in a picture. `others`: how others do."""
        changes = dict.fromkeys(("center", "light_position"), place) | others

        def move(k: int) -> Numbers:
            return {n: changes[n](point.natural[k][n], k) for n in changes.keys() & free}

        return move

    def grown(around: Callable[[int], float]) -> Move:
        """**Arguments:** `around`: the centre's place on a picture's axis, from the origin."""
        return everything(
            lambda x, k: x - around(k) * back[k],
            radius=lambda x, k: x,
            mu=lambda x, k: x - around(k),
        )

    scale = "the scale of the world is not determined"
    if "radius" in free:
        yield scale, [grown(lambda k: mu[k])]
    moves = {
        "mu": lambda x, k: np.broadcast_to(back[k], x.shape),
        "theta": lambda x, k: np.cross([[0.0, 0, 1]], x),
        "phi": lambda x, k: np.cross(row(frames[k].right), x),
    }
    for name, place in moves.items():
        if name in free:
            yield (
                f"the camera's {name} against the world is not determined",
                [everything(place, **{name: lambda x, k: np.ones_like(x)})],
            )
    if {"radius", "mu"} <= free:
        # around where a plane stays, or what several eyes look at
        planes = point.scenes[0].planes
        feet = [
            float(np.dot(p, n) / slope)
            for p, n in zip(np.asarray(planes.point), np.asarray(planes.normal), strict=True)
            if (slope := (back[0] @ n)[0])
        ]
        for t in (*feet, 0.0):
            yield scale, [grown(lambda k, t=t: t)]
