"""What there is in the pictures of a fit, and what is seen and lit of it."""

from collections.abc import Callable, Collection
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, PyTree

from ...base.vec import vec
from ...rendering.samples import sample_positions, sample_rays
from ...scene.scene import Scene
from ...scene.settings import RenderSettings
from ...tracing.context import build_context
from ...tracing.queries import closest_hit, light_visible
from ...tracing.shading import lambert, toward_light
from ...tracing.surface import surface_at
from ...xla.jit import compiled
from ..problem.labels import picture_suffix, unknown_places
from ..problem.problem import Problem

Numbers = dict[str, Any]
"""Free parameters by name, or how they change."""

Places = dict[str, np.ndarray]
"""Where their numbers are in the unknowns."""

Move = Callable[[int], Numbers]
"""From the number of a picture to how some of its free parameters change."""


class VisibleObjects(eqx.Module):
    """What a picture's rays from the eye meet."""

    seen: Bool[ArrayLike, " objects"]  #: which objects
    counts: Bool[ArrayLike, " objects"]  #: which of them where the target counts
    lit: Bool[ArrayLike, "lights objects"]  #: which of these each light reaches there


class Evidence:
    """What there is, and what is seen of it, at some values of the unknowns."""

    def __init__(self, problem: Problem, values: PyTree, hidden: np.ndarray):
        self.own, self.hidden = problem.own, hidden
        self.free = problem.parameters[0].free
        self.places = unknown_places(problem)
        self.scenes = [scene for scene, _ in problem.place(values)]
        each = zip(self.scenes, problem.settings, problem.targets, strict=True)
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
        return [(picture_suffix(k), [k]) for k in self.every] if own else [("", self.every)]

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


@compiled
def _shown(
    scene: Scene, settings: RenderSettings, weight: Float[Array, "height width 3"]
) -> VisibleObjects:
    context = build_context(scene, settings, accelerated=False)
    pixels = jnp.arange(settings.width * settings.height, dtype=jnp.int32)
    left, top = sample_positions(scene, settings)
    ray = sample_rays(scene, settings, pixels, left[0], top[0])
    hit = closest_hit(context, ray)
    surface = surface_at(context, ray, hit)
    some = hit.id >= 0
    counts = some & jnp.any(weight > 0, axis=-1).reshape(-1)
    any_of = lambda mask: jnp.full(scene.objects, False).at[hit.id].max(mask, mode="drop")
    lit = [
        any_of(
            counts
            & (lambert(surface, toward_light(surface, vec(light))) > 0)
            & light_visible(context, surface.point, hit, vec(light))
        )
        for light in scene.lights.position
    ]
    none = jnp.zeros((0, scene.objects), bool)
    return VisibleObjects(any_of(some), any_of(counts), jnp.stack(lit) if lit else none)


def _double(x: Array) -> np.ndarray:
    return np.asarray(x, np.float64)
