"""Scaling: time and memory against pixels, spheres, lights and bounces."""

import dataclasses
from collections.abc import Callable, Iterator
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...rendering.render import draw
from ...scene.lights import Lights
from ...scene.needs import needs
from ...scene.scene import Scene
from ...scene.settings import RenderSettings, render_settings
from ...scene.spheres import Spheres
from .settings import Settings
from .work_precision import Diagram, Point, Program, clock

_Case = tuple[Scene, int, int]
"""A scene, the side of its picture in pixels, and the bounces."""


def scale(scene: Scene, settings: Settings) -> Iterator[Diagram]:
    """Yields four diagrams of single rays, each of which sweeps one size."""
    scene = scene.with_antialias(0).astype(jnp.float32)
    bounces, side = settings.bounces, settings.sides[-1] // 2
    sweeps: dict[str, tuple[str, tuple[int, ...], Callable[[int], _Case]]] = {
        "pixels": ("pixels", settings.sides, lambda n: (scene, n, bounces)),
        "spheres": ("spheres", settings.counts, lambda n: (cloud(scene, n), side, bounces)),
        "lights": ("lights", settings.lights, lambda n: (lit_by(scene, n), side, bounces)),
        "bounces": ("bounces + 1", settings.depths, lambda n: (mirroring(scene), side, n)),
    }
    programs = _Programs({})
    for name, (label, numbers, case) in sweeps.items():
        if name in ("spheres", "bounces") and not len(scene.spheres):
            continue
        settings.say(f"scale: {name}")
        yield Diagram(
            f"scale_{name}",
            f"Time and memory against {name}",
            "",
            _description(name, side, bounces),
            float("nan"),
            _points(name, {n: case(n) for n in numbers}, programs, settings),
            label,
        )


@dataclasses.dataclass(frozen=True)
class _Programs:
    """Compiled programs, shared where sweeps meet: at one light, or at the scene's bounces."""

    compiled: dict[tuple, Program]

    def of(self, work: str, scene: Scene, drawn: RenderSettings) -> Program:
        """Compiles a picture, or a gradient of its sum, once for each shape of a scene."""
        shapes = jax.tree.structure(scene), *map(jnp.shape, jax.tree.leaves(scene))
        key = work, drawn, *shapes
        if key not in self.compiled:
            picture = partial(draw, settings=drawn)
            total = lambda scene: jnp.sum(picture(scene))
            self.compiled[key] = Program(picture if work == "picture" else jax.grad(total), scene)
        return self.compiled[key]


def _points(
    name: str, cases: dict[int, _Case], programs: _Programs, settings: Settings
) -> tuple[Point, ...]:
    """Measures all cases of a sweep: pictures, and gradients in thorough studies."""
    measured: dict[tuple[str, int], Program] = {}
    runs: dict[tuple[str, int], Callable] = {}
    for n, (scene, side, bounces) in cases.items():
        drawn = render_settings(scene, side, side, highlight=settings.highlight, bounces=bounces)
        for work in ("picture", "gradient") if settings.thorough else ("picture",):
            measured[work, n] = programs.of(work, scene, drawn)
            runs[work, n] = partial(measured[work, n], scene)
    taken = clock(runs, settings.seconds)
    return tuple(
        Point(
            f"scale_{name}", work, _knob(n, name), _size(n, name), "float32", taken[work, n],
            program.compile_seconds, float("nan"), program.memory,
        )
        for (work, n), program in measured.items()
    )  # fmt: skip


def _description(name: str, side: int, bounces: int) -> str:
    """Describes the pictures of a sweep."""
    sizes = [f"{side} x {side} pixels"] * (name != "pixels")
    sizes += [f"bounces: {bounces}"] * (name != "bounces")
    return ", ".join(["float32, single rays", *sizes])


def _size(n: int, name: str) -> float:
    """Returns the swept size: pixels, spheres, lights, or segments of paths."""
    return float({"pixels": n * n, "bounces": n + 1}.get(name, n))


def _knob(n: int, name: str) -> str:
    """Returns a number of a sweep in words, such as `1 bounce`."""
    if name == "pixels":
        return f"{n} x {n} pixels"
    return f"{n} {name}" if n != 1 else f"1 {'bounce' if name == 'bounces' else name[:-1]}"


def cloud(scene: Scene, count: int) -> Scene:
    """Replaces the spheres by `count` spheres of the same density and materials."""
    rng = np.random.default_rng(0)
    s = scene.spheres
    center, radius = np.asarray(s.center), np.asarray(s.radius)
    low, high = (center - radius[:, None]).min(0), (center + radius[:, None]).max(0)
    copied = rng.integers(0, len(s), count)
    new_radius = radius[copied] * (len(s) / count) ** (1 / 3)
    new_center = rng.uniform(low, high, (count, 3))
    material = (s.color, s.ka, s.kd, s.ks, s.exponent, s.kgr, s.kt)
    spheres = Spheres(
        *(jnp.asarray(x, s.radius.dtype) for x in (new_center, new_radius)),
        *(x[copied] for x in material),
        pic=tuple(s.pic[i] for i in copied),
        ior=s.ior[copied],
    )
    return eqx.tree_at(lambda x: x.spheres, scene, spheres)


def lit_by(scene: Scene, count: int) -> Scene:
    """Replaces the lights by `count` points at the distance of the first, with one light's sum."""
    rng = np.random.default_rng(0)
    near = scene.lights.numbers(directional=False)
    light = scene.lights.position[near[0]] if near else jnp.full(3, 1000, scene.dtype)
    position = rng.standard_normal((count, 3))
    position *= float(jnp.linalg.norm(light)) / np.linalg.norm(position, axis=1, keepdims=True)
    position[0] = light
    color = jnp.full((count, 3), 1 / count, scene.dtype)
    lights = Lights(jnp.asarray(position, scene.dtype), color)
    return eqx.tree_at(lambda x: x.lights, scene, lights)


def mirroring(scene: Scene) -> Scene:
    """Makes all spheres reflect a third, in a scene without reflection and transmission."""
    if needs(scene).bounces:
        return scene
    kgr = jnp.full_like(scene.spheres.kgr, 1 / 3)
    return eqx.tree_at(lambda x: x.spheres.kgr, scene, kgr)
