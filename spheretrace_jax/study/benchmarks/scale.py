"""Scale: time and memory against pixels, spheres, lights and bounces."""

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


def scale(scene: Scene, settings: Settings) -> Iterator[Diagram]:
    """Four diagrams of single rays: each sweeps one thing and leaves the others as they are."""
    scene = scene.with_antialias(0).astype(jnp.float32)
    bounces, side = settings.bounces, settings.sides[-1] // 2
    sweeps: dict[str, tuple[str, tuple[int, ...], Callable]] = {
        "pixels": ("pixels", settings.sides, lambda n: (scene, n, bounces)),
        "spheres": ("spheres", settings.counts, lambda n: (cloud(scene, n), side, bounces)),
        "lights": ("lights", settings.lights, lambda n: (lit_by(scene, n), side, bounces)),
        "bounces": ("bounces + 1", settings.depths, lambda n: (mirroring(scene), side, n)),
    }
    shared: dict[tuple, Program] = {}

    def compiled(work: str, one: Scene, program: RenderSettings) -> Program:
        """Once where sweeps meet: one light, or a bounce, is the scene as it is."""
        shapes = jax.tree.structure(one), *map(jnp.shape, jax.tree.leaves(one))
        if (work, program, *shapes) not in shared:
            picture = partial(draw, settings=program)
            total = lambda scene: jnp.sum(picture(scene))
            function = picture if work == "picture" else jax.grad(total)
            shared[work, program, *shapes] = Program(function, one)
        return shared[work, program, *shapes]

    for name, (label, numbers, case) in sweeps.items():
        if name in ("spheres", "bounces") and not len(scene.spheres):
            continue
        settings.say(f"scale: {name}")
        programs: dict[tuple[str, int], Program] = {}
        runs: dict[tuple[str, int], Callable] = {}
        for n in numbers:
            one, width, depth = case(n)
            program = render_settings(
                one, width, width, highlight=settings.highlight, bounces=depth
            )
            for work in ("picture", "gradient") if settings.thorough else ("picture",):
                programs[work, n] = compiled(work, one, program)
                runs[work, n] = partial(programs[work, n], one)
        taken = clock(runs, settings.seconds)
        size = lambda n, name=name: float({"pixels": n * n, "bounces": n + 1}.get(name, n))
        knob = lambda n, name=name: f"{n} x {n} pixels" if name == "pixels" else _some(n, name)
        points = [
            Point(
                f"scale_{name}", work, knob(n), size(n), "float32", taken[work, n],
                program.compile_seconds, float("nan"), program.memory,
            )
            for (work, n), program in programs.items()
        ]  # fmt: skip
        yield Diagram(
            f"scale_{name}",
            f"Time and memory against {name}",
            "",
            _of_pictures(name, side, bounces),
            float("nan"),
            tuple(points),
            label,
        )


def _of_pictures(name: str, side: int, bounces: int) -> str:
    parts = [f"{side} x {side} pixels"] * (name != "pixels")
    parts += [f"bounces: {bounces}"] * (name != "bounces")
    return ", ".join(["float32, single rays", *parts])


def _some(count: int, name: str) -> str:
    return f"{count} {name}" if count != 1 else f"1 {'bounce' if name == 'bounces' else name[:-1]}"


def cloud(scene: Scene, count: int) -> Scene:
    """So many spheres in place of the scene's: about as dense, and made of the same materials."""
    rng = np.random.default_rng(0)
    s = scene.spheres
    center, radius = np.asarray(s.center), np.asarray(s.radius)
    low, high = (center - radius[:, None]).min(0), (center + radius[:, None]).max(0)
    which = rng.integers(0, len(s), count)
    small = radius[which] * (len(s) / count) ** (1 / 3)
    inside = rng.uniform(low, high, (count, 3))
    parts = (s.color, s.ka, s.kd, s.ks, s.exponent, s.kgr, s.kt)
    pic = tuple(s.pic[i] for i in which)
    made_of = (x[which] for x in parts)
    spheres = Spheres(*(jnp.asarray(x, s.radius.dtype) for x in (inside, small)), *made_of, pic=pic)
    return eqx.tree_at(lambda x: x.spheres, scene, spheres)


def lit_by(scene: Scene, count: int) -> Scene:
    """The scene under so many lights, as far away as its first, which share the light."""
    rng = np.random.default_rng(0)
    light = scene.lights.position[0] if len(scene.lights) else jnp.full(3, 1000, scene.dtype)
    away = rng.standard_normal((count, 3))
    away *= float(jnp.linalg.norm(light)) / np.linalg.norm(away, axis=1, keepdims=True)
    away[0] = light
    color = jnp.full((count, 3), 1 / count, scene.dtype)
    lights = Lights(jnp.asarray(away, scene.dtype), color)
    return eqx.tree_at(lambda x: x.lights, scene, lights)


def mirroring(scene: Scene) -> Scene:
    """The scene, in which all spheres reflect a third where none does anything of the sort."""
    if needs(scene).bounces:
        return scene
    kgr = jnp.full_like(scene.spheres.kgr, 1 / 3)
    return eqx.tree_at(lambda x: x.spheres.kgr, scene, kgr)
