"""Derivatives: error against time, of single rays, of covered edges, and of differences."""

import dataclasses
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...base.types import Picture
from ...rendering.render import draw
from ...scene.needs import needs
from ...scene.scene import Scene
from ...scene.settings import render_settings
from .reference import reference_picture
from .settings import Settings
from .work_precision import Diagram, Point, Program, clock, relative

#: Of the truth's differences, in pixels that edges move.
_STEP = 0.1

_PLACES = lambda s: (s.spheres.center, s.spheres.radius, s.lights.position)


def derivatives(scene: Scene, settings: Settings) -> Iterator[Diagram]:
    """The diagrams of the derivative along one movement: of each pixel, and of a sum of them."""
    exact = scene.astype(jnp.float64)
    along = movement(exact, settings)
    drawn: dict[str, Any] = dict(
        width=settings.size, height=settings.size, highlight=settings.highlight,
        bounces=settings.bounces, needs=needs(exact),
    )  # fmt: skip
    settings.say(f"derivative: {settings.truth_rays} rays per pixel for the truth")
    picture = reference_picture(
        render_settings(exact.with_antialias(0), **drawn), settings.truth_rays
    )
    truth, wider = (np.asarray(_difference(picture, exact, along, h * _STEP)) for h in (1, 2))
    weight = blurred(truth, settings.size / 24)
    total = float(np.vdot(weight, truth)) or 1.0
    works = _works(exact, along, weight, drawn, settings)
    taken = clock({key: work.run for key, work in works.items()}, settings.seconds)
    pixels, sums = [], []
    for (method, knob, size), work in works.items():
        point = partial(
            Point, method=method, knob=knob, size=size, dtype="float64",
            seconds=taken[method, knob, size], compile_seconds=work.program.compile_seconds,
            memory=work.program.memory,
        )  # fmt: skip
        found = work.read(work.run())
        if found.ndim:
            pixels.append(point(diagram="derivative", error=relative(found, truth)))
            found = np.vdot(weight, found)
        sums.append(point(diagram="derivative_sum", error=abs(float(found) / total - 1)))
    reference = (
        f"central differences of {settings.truth_rays} or more single rays per pixel on a "
        f"Fibonacci lattice, by a step that moves edges about {_STEP:g} pixel"
    )
    size = f"{settings.size} x {settings.size}"
    yield Diagram(
        "derivative",
        f"Derivative pictures as all spheres and lights move at once, {size}",
        "relative error of the derivative picture, L2",
        reference,
        relative(wider, truth),
        tuple(pixels),
    )
    yield Diagram(
        "derivative_sum",
        f"Derivative of the picture's sum with a smooth weight, {size}",
        "relative error",
        reference + ", summed with the same weight",
        abs(float(np.vdot(weight, wider)) / total - 1),
        tuple(sums),
    )


def movement(scene: Scene, settings: Settings) -> Scene:
    """A random direction in which all spheres and lights move, so that edges move a pixel or so."""
    rng = np.random.default_rng(settings.seed)
    c = scene.camera
    pixel = float(c.window / c.distance * c.mu) / settings.size
    far = jnp.linalg.norm(scene.lights.position, axis=-1, keepdims=True)
    spread = lambda like: jnp.asarray(rng.uniform(-1, 1, like.shape))
    center, radius, light = (spread(x) for x in _PLACES(scene))
    moves = pixel * center, pixel * radius, far / settings.size * light
    return eqx.tree_at(_PLACES, jax.tree.map(jnp.zeros_like, scene), moves)


def blurred(picture: np.ndarray, width: float) -> np.ndarray:
    """A picture convolved with a Gaussian, periodically. **Arguments:** `width`: in pixels."""
    gauss = [np.exp(-2 * (np.pi * width * np.fft.fftfreq(n)) ** 2) for n in picture.shape[:2]]
    filter_ = gauss[0][:, None, None] * gauss[1][:, None]
    return np.fft.ifft2(np.fft.fft2(picture, axes=(0, 1)) * filter_, axes=(0, 1)).real


@dataclasses.dataclass(frozen=True)
class _Work:
    """One way to a derivative."""

    program: Program
    run: Callable[[], Any]  #: what is timed
    read: Callable[[Any], np.ndarray] = np.asarray  #: the derivative picture, or its sum


def _works(
    scene: Scene, along: Scene, weight: np.ndarray, drawn: dict, settings: Settings
) -> dict[tuple[str, str, float], _Work]:
    """All ways, by method, knob and the knob's number."""
    works = {}
    for method, antialias, knobs in (
        ("single rays", 0, settings.rays[:3:2]),
        ("covered edges", 1, settings.covered[: 2 if settings.thorough else 1]),
    ):
        one, still = (s.with_antialias(antialias) for s in (scene, along))

        def program(way: str, k: int, derived: Callable, *arguments: Any) -> Program:
            settings.say(f"derivative: {method}, {k} x {k}, {way}")
            picture = partial(draw, settings=render_settings(one, samples=k, **drawn))
            return Program(derived(picture), *arguments)

        for k in knobs:
            push = program("forward mode", k, _pushed, one, still)
            works[f"{method}, forward mode", f"{k} x {k}", float(k)] = _Work(push, push)
            if settings.thorough:
                pull = program("reverse mode", k, _pulled, one, jnp.asarray(weight))
                work = _Work(pull, pull, partial(_along, still))
                works[f"{method}, reverse mode", f"{k} x {k}", float(k)] = work
        if antialias and not settings.thorough:
            continue
        # of a few rays, as one ray hardly ever sees an edge move
        k = knobs[0] if antialias else knobs[-1]
        picture = program("differences", k, lambda picture: picture, one)
        for step in settings.steps:
            work = _Work(picture, partial(_difference, picture, one, still, step))
            works[f"differences of {method}, {k} x {k}", f"step {step:g}", step] = work
    settings.say("derivative: errors and times")
    return works


def _pushed(picture: Callable[[Scene], Picture]) -> Callable[[Scene, Scene], Picture]:
    return lambda scene, along: jax.jvp(picture, (scene,), (along,))[1]


def _pulled(picture: Callable[[Scene], Picture]) -> Callable[[Scene, Picture], Scene]:
    return lambda scene, weight: jax.vjp(picture, scene)[1](weight)[0]


def _along(still: Scene, slope: Scene) -> np.ndarray:
    pairs = zip(jax.tree.leaves(slope), jax.tree.leaves(still), strict=True)
    return np.sum([np.vdot(x, y) for x, y in pairs])


def _difference(
    picture: Callable[[Scene], Picture], scene: Scene, along: Scene, step: float
) -> Any:
    moved = lambda h: picture(jax.tree.map(lambda a, b: a + h * b, scene, along))
    return (moved(step) - moved(-step)) / (2 * step)
