"""Why a number may not show in any picture: what is known without looking at J^T J."""

from collections.abc import Callable, Collection, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, PyTree

from ..camera import view_frame
from ..options import Options
from ..render import rays_through, sample_places
from ..scene import Scene
from ..shading import lambert, toward_light
from ..vec import vec
from ..visibility import nearest, unoccluded
from ..world import build_world, surface_at
from .parameters import LIGHTS, SPHERES
from .problem import Problem

Numbers = dict[str, Any]
"""Free parameters by name, or how they change."""

Places = dict[str, np.ndarray]
"""Where their numbers are in the unknowns."""

Move = Callable[[int], Numbers]
"""From the number of a picture to how some of its free parameters change."""

CHANNELS = ("red", "green", "blue")

# Lights are at one place if no coordinates differ by more than this part of the largest.
_ONE_PLACE = 1e-6


def names_of(problem: Problem) -> list[str]:
    """What each unknown is, in the order of `ravel_pytree`."""
    names = []
    for name, arrays in placed(problem).items():
        for k, array in enumerate(arrays):
            picture = _of(k) if name in problem.own else ""
            indices = np.ndindex(array.shape)
            names += [f"{_object(name, index)}{picture}" for index in indices]
    return names


def _object(name: str, index: tuple[int, ...]) -> str:
    if name in SPHERES:
        return f"sphere {index[0] + 1}'s {name}"
    if name in LIGHTS:
        return f"light {index[0] + 1}'s {name.removeprefix('light_')}"
    return f"the {CHANNELS[index[0]]} exposure" if name == "exposure" else f"the camera's {name}"


def _double(x: Array) -> np.ndarray:
    return np.asarray(x, np.float64)


def _of(picture: int) -> str:
    return f" of picture {picture + 1}"


def placed(problem: Problem) -> dict[str, list[np.ndarray]]:
    """Where each name's numbers are in the vector of unknowns, in their shape.

    An array for each picture for what pictures have of their own, else one.
    """
    start, end, places = problem.start(), 0, {}
    for name in sorted(start):
        places[name] = []
        for array in start[name] if name in problem.own else [start[name]]:
            size = int(np.size(array))
            places[name].append(np.arange(end, end + size).reshape(np.shape(array)))
            end += size
    return places


class Reason(eqx.Module):
    """A sentence that may be true."""

    sentence: str
    directions: Float[np.ndarray, "free directions"]  #: of the unknowns, which do not show then
    certain: bool = False  #: whether it is true whatever J says, but for its own errors


def reasons(
    problem: Problem,
    values: PyTree,
    hidden: Bool[np.ndarray, " free"],
    slopes: list[Float[np.ndarray, "_ free"]],
) -> Iterator[Reason]:
    """What may be true, and is if its directions do not show.

    **Arguments:** `hidden`: which unknowns no picture depends on. `slopes`: of each picture's
    free parameters the derivatives by the unknowns.
    """
    point = _Point(problem, values, hidden)
    unit, left, names = np.eye(hidden.size), hidden.copy(), np.asarray(names_of(problem))
    for sentence, at in (*_hidden_spheres(point), *_hidden_lights(point)):
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


class Shown(eqx.Module):
    """What a picture's rays from the eye meet."""

    seen: Bool[ArrayLike, " objects"]  #: which objects
    counts: Bool[ArrayLike, " objects"]  #: which of them where the target counts
    lit: Bool[ArrayLike, "lights objects"]  #: which of these each light reaches there


class _Point:
    """What there is, and what is seen of it, at some values of the unknowns."""

    def __init__(self, problem: Problem, values: PyTree, hidden: np.ndarray):
        self.own, self.hidden = problem.own, hidden
        self.free = problem.parameters[0].free
        self.places = placed(problem)
        self.scenes = [scene for scene, _ in problem.place(values)]
        each = zip(self.scenes, problem.options, problem.targets, strict=True)
        self.shown = [jax.tree.map(np.asarray, _shown(s, o, t.weight)) for s, o, t in each]
        #: the pictures' free parameters
        self.natural = [
            jax.tree.map(_double, p.natural(problem.of_picture(values, k)))
            for k, p in enumerate(problem.parameters)
        ]

    @property
    def every(self) -> list[int]:
        """The numbers of all pictures."""
        return list(range(len(self.scenes)))

    def apart(self, *names: str) -> list[tuple[str, list[int]]]:
        """The pictures one by one if all the names are their own, else together: in words, and
        their numbers.
        """
        own = set(names) <= self.own
        return [(_of(k), [k]) for k in self.every] if own else [("", self.every)]

    @property
    def nothing_stays(self) -> bool:
        """Whether the world is free to move with the eye: all that has a place or axes is free."""
        scene = self.scenes[0]
        fixed = len(scene.planes) or scene.back_plane or scene.sky or any(scene.spheres.pic)
        lights = "light_position" in self.free or not len(scene.lights)
        return "center" in self.free and lights and not fixed and len(self.scenes) == 1

    def unseen(self, at: list[int]) -> list[int]:
        """The lights that reach nothing that is seen in some pictures."""
        lit = np.any([self.shown[k].lit.any(axis=1) for k in at], axis=0)
        return np.flatnonzero(~lit).tolist()

    def row(self, names: Collection[str], k: int, i: int) -> Places:
        """Where an object's numbers are in the unknowns of picture k, by name."""
        return {n: np.atleast_1d(self.places[n][k][i]) for n in sorted(names)}

    def change(self, move: Move) -> Float[np.ndarray, " natural"]:
        """How all free parameters of all pictures change, in the order of their layouts."""
        moved = [(move(k), natural) for k, natural in enumerate(self.natural)]
        parts = [m.get(n, np.zeros_like(natural[n])) for m, natural in moved for n in self.free]
        return np.concatenate([np.ravel(part) for part in parts])


@eqx.filter_jit
def _shown(scene: Scene, options: Options, weight: Float[Array, "height width 3"]) -> Shown:
    world, needs = build_world(scene), options.needs
    pixels = jnp.arange(options.width * options.height, dtype=jnp.int32)
    places = sample_places(scene, options)
    ray = rays_through(scene, options, pixels, places[0][0], places[1][0])
    hit = nearest(world, ray, needs)
    surface = surface_at(world, ray, hit, needs)
    some = hit.id >= 0
    counts = some & jnp.any(weight > 0, axis=-1).reshape(-1)
    any_of = lambda mask: jnp.full(scene.objects, False).at[hit.id].max(mask, mode="drop")
    lit = [
        any_of(
            counts
            & (lambert(surface, toward_light(surface, vec(light))) > 0)
            & unoccluded(world, surface.point, hit, vec(light), needs)
        )
        for light in scene.lights.position
    ]
    none = jnp.zeros((0, scene.objects), bool)
    return Shown(any_of(some), any_of(counts), jnp.stack(lit) if lit else none)


def _hidden_spheres(point: _Point) -> Iterator[tuple[str, np.ndarray]]:
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
        if not spheres.color[i].any():
            why.append((f"{who} is black", ("ka", "kd")))
        if spheres.ka[i] == spheres.kd[i] == 0:
            why.append((f"{who} has ka and kd 0", ("color",)))
        if spheres.ks[i] == 0:
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


def _hidden_lights(point: _Point) -> Iterator[tuple[str, np.ndarray]]:
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


def _sentence(why: str, where: Places, hidden: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """That some numbers, of which some are hidden, are not determined, and which are."""
    if where:
        parts = sorted(_part(name, hidden[at]) for name, at in where.items())
        at = np.concatenate(list(where.values()))
        yield f"{why}: {_list(parts)} not determined", at[hidden[at]]


def _part(name: str, hidden: np.ndarray) -> str:
    """What of a parameter is hidden."""
    name = name.removeprefix("light_")
    if name == "color" and not hidden.all():
        return f"color in {_list([c for c, gone in zip(CHANNELS, hidden, strict=True) if gone])}"
    return name


def _scales(point: _Point) -> Iterator[tuple[str, list[Move]]]:
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
                f"sphere {i + 1}: the scale of color against {_list(names)} is not determined",
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
                f"{what[up]} against the spheres' {_list(weights)} is not determined",
                [grow(up, weights, point.every, ...)],
            )


def _lights(point: _Point) -> Iterator[tuple[str, list[Move]]]:
    """Lights of which only what they do together shows."""
    for name in sorted(LIGHTS.keys() & set(point.free)):
        for of, at in point.apart(name):
            for why, group in _alike(point, at):
                who = f"lights {_list([str(i + 1) for i in group])}{of}"
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


def _alike(point: _Point, at: list[int]) -> Iterator[tuple[str, list[int]]]:
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


def _exchange(point: _Point, name: str, at: list[int], one: int, other: int, part: int) -> Move:
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


def _ambient(point: _Point, at: list[int], light: int) -> Move:
    """The ambient light grows by what a light gains, and ka shrinks."""

    def move(k: int) -> Numbers:
        natural = point.natural[k]
        gain = np.zeros_like(natural["light_color"])
        if k in at:
            gain[light] = natural["light_color"].sum(axis=0)
        return {"light_color": gain, "ka": -natural["ka"]}

    return move


def _world(point: _Point) -> Iterator[tuple[str, list[Move]]]:
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


def _list(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
