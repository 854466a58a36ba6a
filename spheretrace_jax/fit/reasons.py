"""Why a number may not show in any picture: what is known without looking at J^T J.

Each reason is a sentence and the directions of the unknowns that do not show if it is true.
"""

from collections.abc import Callable, Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree

from ..camera import view_frame
from ..options import Options
from ..render import rays_through, sample_places
from ..scene import Scene
from ..shading import lambert, toward_light
from ..vec import vec
from ..visibility import nearest, unoccluded
from ..world import build_world, surface_at
from .normal import Normal
from .parameters import LIGHTS, SPHERES, Values
from .problem import Problem

Directions = Float[np.ndarray, "free directions"]
Move = dict[str, Array]

CHANNELS = ("red", "green", "blue")


def names_of(problem: Problem) -> list[str]:
    """What each unknown is, in the order of `ravel_pytree`."""
    start, names = problem.start(), []
    for name in sorted(start):
        own = name in problem.own
        for k, array in enumerate(start[name] if own else [start[name]]):
            picture = f" of picture {k + 1}" if own else ""
            indices = np.ndindex(np.shape(array))
            names += [f"{_object(name, index)}{picture}" for index in indices]
    return names


def _object(name: str, index: tuple[int, ...]) -> str:
    if name in SPHERES:
        return f"sphere {index[0] + 1}'s {name}"
    if name in LIGHTS:
        return f"light {index[0] + 1}'s {name.removeprefix('light_')}"
    return f"the {CHANNELS[index[0]]} exposure" if name == "exposure" else f"the camera's {name}"


def reasons(problem: Problem, values: PyTree, normal: Normal) -> Iterator[tuple[str, Directions]]:
    """Sentences, and the directions that do not show if they are true."""
    yield from _nothing_shows(problem, values, normal)
    scene = problem.place(values)[0][0]
    back = np.linalg.pinv(
        np.concatenate([problem.slope(values, k) for k in range(len(problem.parameters))])
    )
    for sentence, move in _moves(frozenset(problem.parameters[0].free), scene):
        parts = []
        for k, parameters in enumerate(problem.parameters):
            natural = parameters.natural(problem.of_picture(values, k))
            moved = move(natural)
            parts += [
                np.ravel(moved.get(name, jnp.zeros_like(natural[name]))) for name in parameters.free
            ]
        direction = back @ np.concatenate(parts)
        length = np.linalg.norm(direction)
        if length > 0:
            yield sentence, direction[:, None] / length


def _moves(free: frozenset[str], scene: Scene) -> Iterator[tuple[str, Callable[[Values], Move]]]:
    """Sentences, and the changes of free parameters that change no picture if they are true."""

    def grow(up: set[str], down: set[str], only: Callable[[Array, str], Array]) -> Callable:
        """As some grow others shrink, in proportion; `only`: the part that takes part."""

        def move(natural: Values) -> Move:
            signs = {n: 1 for n in up & free} | {n: -1 for n in down & free}
            return {n: only(natural[n], n) * sign for n, sign in signs.items()}

        return move

    def row(i: int) -> Callable[[Array, str], Array]:
        return lambda x, _: jnp.zeros_like(x).at[i].set(x[i])

    def channel(c: int) -> Callable[[Array, str], Array]:
        return lambda x, _: jnp.zeros_like(x).at[..., c].set(x[..., c])

    everything = lambda x, _: x
    coefficients = {"ka", "kd"} & free
    if "color" in free and coefficients:
        for i in range(len(scene.spheres)):
            yield (
                f"sphere {i + 1}: the scale of color against {_list(coefficients)} "
                "is not determined",
                grow({"color"}, coefficients, row(i)),
            )
    weights = {"ka", "kd", "ks"} & free
    for name, what in (("light_color", "the lights' color"), ("exposure", "the exposure")):
        if name not in free:
            continue
        if weights:
            yield (
                f"{what} against the spheres' {_list(weights)} is not determined",
                grow({name}, weights, everything),
            )
        others = {"color": "the spheres' color"} | (
            {"light_color": "the lights' color"} if name == "exposure" else {}
        )
        for other, against in others.items():
            for c in range(3 if other in free else 0):
                yield (
                    f"{what} against {against} is not determined in {CHANNELS[c]}",
                    grow({name}, {other}, channel(c)),
                )
    yield (
        "the scale of the world is not determined",
        grow({"center", "radius", "light_position", "mu"}, set(), everything),
    )
    right = np.asarray([float(x) for x in jax.tree.leaves(view_frame(scene.camera).right)])
    for name, axis in (("theta", np.array([0.0, 0, 1])), ("phi", right)):
        if name in free:
            yield (
                f"the camera's {name} against the world is not determined",
                lambda natural, name=name, axis=axis: {
                    name: jnp.ones_like(natural[name]),
                    **{
                        n: jnp.cross(jnp.asarray(axis, natural[n].dtype)[None], natural[n])
                        for n in {"center", "light_position"} & free
                    },
                },
            )


def _list(names: set[str]) -> str:
    names_ = sorted(names)
    return names_[0] if len(names_) == 1 else f"{', '.join(names_[:-1])} and {names_[-1]}"


def _nothing_shows(
    problem: Problem, values: PyTree, normal: Normal
) -> Iterator[tuple[str, Directions]]:
    """Numbers of which no picture depends at all, by the objects that they belong to."""
    hidden = np.diag(np.asarray(normal.square)) == 0
    places = placed(problem)
    seen, lit = _shown(problem, values)
    scene = problem.place(values)[0][0]
    unit = np.eye(len(hidden))

    for i in range(len(scene.spheres)):
        mine = {n: p[i].reshape(-1) for n, p in places.items() if n in SPHERES}
        gone = {n: p[hidden[p]] for n, p in mine.items() if hidden[p].any()}
        if not gone:
            continue
        all_gone = all(hidden[p].all() for p in mine.values())
        who = f"sphere {i + 1}"
        if not seen[i] and all_gone:
            groups = {f"{who} is not visible": set(gone)}
        else:
            dark = not lit[:, i].any()
            kd = {"kd", "ks", "exponent"} if dark else set()
            black = {"ka", "kd"} if not np.any(np.asarray(scene.spheres.color[i])) else set()
            none = {"exponent"} if float(scene.spheres.ks[i]) == 0 else set()
            groups = {
                f"no light reaches what is seen of {who}": kd & set(gone),
                f"{who} has ks 0": (none & set(gone)) - kd,
                f"{who} is black": (black & set(gone)) - kd,
            }
            rest = set(gone) - set().union(*groups.values())
            groups[f"nothing that is seen depends on it, {who}"] = rest
        for why, names in groups.items():
            if names:
                at = np.concatenate([gone[n] for n in names])
                yield f"{why}: {_list(names)} not determined", unit[:, at]
    for name in LIGHTS:
        if name not in places or name in problem.own:
            continue
        for i, at in enumerate(places[name]):
            if hidden[at].all():
                what = name.removeprefix("light_")
                why = "reaches nothing that is seen" if not lit[i].any() else "does not show"
                yield f"light {i + 1} {why}: {what} not determined", unit[:, at]


def placed(problem: Problem) -> dict[str, np.ndarray]:
    """Where each name's numbers are in the vector of unknowns; of shared names, in their shape."""
    start, end, places = problem.start(), 0, {}
    for name in sorted(start):
        arrays = start[name] if name in problem.own else [start[name]]
        for array in arrays:
            size = int(np.size(array))
            here = np.arange(end, end + size).reshape(np.shape(array))
            places.setdefault(name, here)
            end += size
    return places


def _shown(problem: Problem, values: PyTree) -> tuple[np.ndarray, np.ndarray]:
    """Which objects any ray from an eye meets, and which of these each light reaches there."""
    shown = [
        _shown_in(scene, options)
        for (scene, _), options in zip(problem.place(values), problem.options, strict=True)
    ]
    return tuple(np.any([np.asarray(s[k]) for s in shown], axis=0) for k in (0, 1))


@eqx.filter_jit
def _shown_in(
    scene: Scene, options: Options
) -> tuple[Bool[Array, " objects"], Bool[Array, "lights objects"]]:
    world, needs = build_world(scene), options.needs
    pixels = jnp.arange(options.width * options.height, dtype=jnp.int32)
    places = sample_places(scene, options)
    ray = rays_through(scene, options, pixels, places[0][0], places[1][0])
    hit = nearest(world, ray, needs)
    surface = surface_at(world, ray, hit, needs)
    any_of = lambda mask: (
        jnp.full(scene.objects, False).at[hit.id].max(mask & (hit.id >= 0), mode="drop")
    )
    lit = [
        any_of(
            (lambert(surface, toward_light(surface, vec(light))) > 0)
            & unoccluded(world, surface.point, hit, vec(light), needs)
        )
        for light in scene.lights.position
    ]
    none = jnp.zeros((0, scene.objects), bool)
    return any_of(hit.id >= 0), jnp.stack(lit) if lit else none
