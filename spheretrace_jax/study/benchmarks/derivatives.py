"""Derivatives: error against time of single rays, of covered edges, and of differences."""

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

# Step of the reference's central differences, in pixels that edges move.
_STEP = 0.1

_POSITIONS = lambda s: (s.spheres.center, s.spheres.radius, s.lights.position)


def derivatives(scene: Scene, settings: Settings) -> Iterator[Diagram]:
    """Yields the diagrams of the derivative along one motion: of all pixels, and of their sum."""
    exact = scene.astype(jnp.float64)
    motion = movement(exact, settings)
    drawn: dict[str, Any] = dict(
        width=settings.size, height=settings.size, highlight=settings.highlight,
        bounces=settings.bounces, needs=needs(exact),
    )  # fmt: skip
    settings.say(f"derivative: {settings.truth_rays} rays per pixel for the truth")
    checked = render_settings(exact.with_antialias(0), **drawn)
    picture = reference_picture(exact, checked, settings.truth_rays)
    truth, wider = (np.asarray(_difference(picture, exact, motion, h * _STEP)) for h in (1, 2))
    weight = blurred(truth, settings.size / 24)
    total = float(np.vdot(weight, truth)) or 1.0
    methods = _methods(exact, motion, weight, drawn, settings)
    taken = clock({key: method.run for key, method in methods.items()}, settings.seconds)
    pixels, sums = [], []
    for (name, knob, size), method in methods.items():
        point = partial(
            Point, method=name, knob=knob, size=size, dtype="float64",
            seconds=taken[name, knob, size], compile_seconds=method.program.compile_seconds,
            memory=method.program.memory,
        )  # fmt: skip
        derivative = method.read(method.run())
        if derivative.ndim:
            pixels.append(point(diagram="derivative", error=relative(derivative, truth)))
            derivative = np.vdot(weight, derivative)
        sums.append(point(diagram="derivative_sum", error=abs(float(derivative) / total - 1)))
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
    """Returns a random motion of all spheres and lights, by which edges move about a pixel."""
    rng = np.random.default_rng(settings.seed)
    c = scene.camera
    pixel = float(c.window / c.distance * c.mu) / settings.size
    far = jnp.linalg.norm(scene.lights.position, axis=-1, keepdims=True)
    spread = lambda like: jnp.asarray(rng.uniform(-1, 1, like.shape))
    center, radius, light = (spread(x) for x in _POSITIONS(scene))
    moves = pixel * center, pixel * radius, far / settings.size * light
    return eqx.tree_at(_POSITIONS, jax.tree.map(jnp.zeros_like, scene), moves)


def blurred(picture: np.ndarray, width: float) -> np.ndarray:
    """Convolves a picture with a periodic Gaussian. **Arguments:** `width`: in pixels."""
    gauss = [np.exp(-2 * (np.pi * width * np.fft.fftfreq(n)) ** 2) for n in picture.shape[:2]]
    filter_ = gauss[0][:, None, None] * gauss[1][:, None]
    return np.fft.ifft2(np.fft.fft2(picture, axes=(0, 1)) * filter_, axes=(0, 1)).real


@dataclasses.dataclass(frozen=True)
class _Method:
    """A method of differentiation."""

    program: Program
    run: Callable[[], Any]  #: the timed work
    #: from the result of `run` to the derivative picture, or its weighted sum
    read: Callable[[Any], np.ndarray] = np.asarray


_Key = tuple[str, str, float]
"""A method's name, its knob in words, and the knob's number."""


def _methods(
    scene: Scene, motion: Scene, weight: np.ndarray, drawn: dict, settings: Settings
) -> dict[_Key, _Method]:
    """Compiles all methods, of single rays and of covered edges."""
    methods = {}
    for rays, antialias, knobs in (
        ("single rays", 0, settings.rays[:3:2]),
        ("covered edges", 1, settings.covered[: 2 if settings.thorough else 1]),
    ):
        sampler = _Sampler(rays, scene.with_antialias(antialias), drawn, settings)
        tangent = motion.with_antialias(antialias)
        for k in knobs:
            methods |= sampler.derivatives(k, tangent, jnp.asarray(weight))
        if antialias and not settings.thorough:
            continue
        # differences take a few rays, as the edges that one ray sees hardly ever move
        methods |= sampler.differences(knobs[0] if antialias else knobs[-1], tangent)
    settings.say("derivative: errors and times")
    return methods


@dataclasses.dataclass(frozen=True)
class _Sampler:
    """Pictures of single rays, or of covered edges, and the methods that differentiate them."""

    name: str
    scene: Scene
    drawn: dict[str, Any]  #: the arguments of `render_settings`, but for samples
    settings: Settings

    def program(self, method: str, k: int, derive: Callable, *arguments: Any) -> Program:
        """Compiles a derivative of the picture with k x k samples."""
        self.settings.say(f"derivative: {self.name}, {k} x {k}, {method}")
        checked = render_settings(self.scene, samples=k, **self.drawn)
        return Program(derive(partial(draw, settings=checked)), self.scene, *arguments)

    def derivatives(self, k: int, tangent: Scene, weight: Picture) -> dict[_Key, _Method]:
        """Compiles forward mode, and reverse mode in thorough studies."""
        forward = self.program("forward mode", k, _forward, tangent)
        methods = {
            (f"{self.name}, forward mode", f"{k} x {k}", float(k)): _Method(forward, forward)
        }
        if self.settings.thorough:
            reverse = self.program("reverse mode", k, _reverse, weight)
            method = _Method(reverse, reverse, partial(_inner_product, tangent))
            methods[f"{self.name}, reverse mode", f"{k} x {k}", float(k)] = method
        return methods

    def differences(self, k: int, tangent: Scene) -> dict[_Key, _Method]:
        """Compiles central differences of all steps."""
        picture = self.program("differences", k, lambda picture: picture)
        name = f"differences of {self.name}, {k} x {k}"
        return {
            (name, f"step {step:g}", step): _Method(
                picture, partial(_difference, picture, self.scene, tangent, step)
            )
            for step in self.settings.steps
        }


def _forward(picture: Callable[[Scene], Picture]) -> Callable[[Scene, Scene], Picture]:
    """Returns the derivative of a picture along a tangent."""
    return lambda scene, tangent: jax.jvp(picture, (scene,), (tangent,))[1]


def _reverse(picture: Callable[[Scene], Picture]) -> Callable[[Scene, Picture], Scene]:
    """Returns the gradient of a picture's sum with a weight."""
    return lambda scene, weight: jax.vjp(picture, scene)[1](weight)[0]


def _inner_product(tangent: Scene, gradient: Scene) -> np.ndarray:
    """Returns the derivative of the weighted sum along the tangent."""
    pairs = zip(jax.tree.leaves(gradient), jax.tree.leaves(tangent), strict=True)
    return np.sum([np.vdot(x, y) for x, y in pairs])


def _difference(
    picture: Callable[[Scene], Picture], scene: Scene, tangent: Scene, step: float
) -> Any:
    """Returns the central difference of a picture along a tangent."""
    moved = lambda h: picture(jax.tree.map(lambda a, b: a + h * b, scene, tangent))
    return (moved(step) - moved(-step)) / (2 * step)
