"""Evidence: the objects in the pictures of a fit, and which of them are seen and lit."""

from collections.abc import Callable, Collection
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int, PyTree

from ...rendering.samples import sample_positions, sample_rays
from ...scene.light import each_light
from ...scene.parameters import LIGHT_PLACES, rows_of
from ...scene.scene import Scene
from ...scene.settings import RenderSettings
from ...tracing.context import build_context
from ...tracing.queries import closest_hit, light_visible
from ...tracing.shading import lambert
from ...tracing.surface import surface_at
from ...xla.jit import compiled
from ..problem.labels import picture_suffix, unknown_indices
from ..problem.problem import Problem

Arrays = dict[str, Any]
"""Free parameters by name, or how they change."""

Indices = dict[str, np.ndarray]
"""The indices of parameters' numbers in the unknowns, by name."""

Direction = Callable[[int], Arrays]
"""A direction in the free parameters: from the number of a picture to how its parameters change."""


class VisibleObjects(eqx.Module):
    """The objects that a picture's rays from the eye meet."""

    seen: Bool[ArrayLike, " objects"]  #: which objects the rays meet
    counts: Bool[ArrayLike, " objects"]  #: which objects they meet where the target counts
    lit: Bool[ArrayLike, "lights objects"]  #: which of the latter each light reaches there
    object: Int[ArrayLike, "height width"]  #: the number of each pixel's object, -1 for none


class Evidence:
    """The scenes at a solution, what is seen of them, and which unknowns do not show."""

    def __init__(self, problem: Problem, values: PyTree, null: np.ndarray):
        self.per_picture = problem.per_picture
        self.null = null  #: which unknowns no picture depends on
        self.free = problem.parameters[0].free
        self.indices = unknown_indices(problem)
        self.scenes = [scene for scene, _ in problem.scenes_at(values)]
        pictures = zip(self.scenes, problem.settings, problem.targets, strict=True)
        self.visible = [
            jax.tree.map(np.asarray, _shown(scene, settings, target.weight))
            for scene, settings, target in pictures
        ]
        #: the pictures' free parameters, in the scene's units
        self.natural = [
            jax.tree.map(_double, p.natural(problem.picture_unknowns(values, k)))
            for k, p in enumerate(problem.parameters)
        ]

    @property
    def all_pictures(self) -> list[int]:
        """Returns the numbers of all pictures."""
        return list(range(len(self.scenes)))

    def picture_groups(self, *names: str) -> list[tuple[str, list[int]]]:
        """Groups pictures that share one of the names, else each picture apart.

        **Returns:** for each group its words, and the numbers of its pictures.
        """
        if set(names) <= self.per_picture:
            return [(picture_suffix(k), [k]) for k in self.all_pictures]
        return [("", self.all_pictures)]

    @property
    def moves_with_eye(self) -> bool:
        """Returns whether all that has a position or axes is free to move with the eye."""
        scene = self.scenes[0]
        fixed = len(scene.planes) or scene.back_plane or scene.sky or any(scene.spheres.pic)
        lights = all(
            self.all_free(name, rows_of(scene, name))
            for name in LIGHT_PLACES
            if rows_of(scene, name).any()
        )
        return self.all_free("center") and lights and not fixed and len(self.scenes) == 1

    def all_free(self, name: str, rows: Bool[np.ndarray, " objects"] | None = None) -> bool:
        """Returns whether each number of a parameter is an unknown of its own.

        **Arguments:** `rows`: of some objects only; None for all.
        """
        if name not in self.indices:
            return False
        places = [at if rows is None else at[rows] for at in self.indices[name]]
        return all((at >= 0).all() and len(np.unique(at)) == at.size for at in places)

    def idle_lights(self, pictures: list[int]) -> list[int]:
        """Returns the lights that reach nothing that is seen in these pictures."""
        lit = np.any([self.visible[k].lit.any(axis=1) for k in pictures], axis=0)
        return np.flatnonzero(~lit).tolist()

    def indices_of(self, names: Collection[str], k: int, i: int) -> Indices:
        """Returns the indices of object i's numbers in the unknowns of picture k, by name.

        Without numbers that are held, and names of which all are.
        """
        places = {n: np.atleast_1d(self.indices[n][k][i]) for n in sorted(names)}
        return {n: at[at >= 0] for n, at in places.items() if (at >= 0).any()}

    def flat(self, direction: Direction) -> Float[np.ndarray, " natural"]:
        """Returns a direction as one vector, over all pictures' free parameters.

        Its numbers are in the order of the pictures' `ParameterIndex`.
        """
        pairs = [(direction(k), natural) for k, natural in enumerate(self.natural)]
        arrays = [m.get(n, np.zeros_like(natural[n])) for m, natural in pairs for n in self.free]
        return np.concatenate([np.ravel(array) for array in arrays])


def objects_at(problem: Problem, values: PyTree) -> list[Int[np.ndarray, "height width"]]:
    """Returns of each picture which object its pixels show: its number, -1 for none."""
    pictures = zip(problem.scenes_at(values), problem.settings, problem.targets, strict=True)
    return [np.asarray(_shown(scene, s, t.weight).object) for (scene, _), s, t in pictures]


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
            & (lambert(surface, light.direction(surface.point)) > 0)
            & light_visible(context, surface.point, hit, light)
        )
        for light in each_light(scene.lights, falloff=False)
    ]
    none = jnp.zeros((0, scene.objects), bool)
    lit = jnp.stack(lit) if lit else none
    object_ = hit.id.astype(jnp.int32).reshape(settings.height, settings.width)
    return VisibleObjects(any_of(some), any_of(counts), lit, object_)


def _double(x: Array) -> np.ndarray:
    return np.asarray(x, np.float64)
