"""A start from nothing: where the lights are, and what the spheres are made of, geometry known.

Directions all around are tried for the lights, one after the other, each with the materials that
suit it best, and then finer ones around the best. That is variable projection on a grid:
deterministic, and blind to local minima that are narrower than the grid.
"""

from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...scene.scene import Scene
from ...scene.settings import RenderSettings
from ..model.parameters import extent
from ..model.target import Target
from .variable_projection import (
    projected_costs,
    refine_lights,
    sample_pixels,
    scene_with,
    try_lights,
)

# So many directions are tried first, at these distances in units of the scene.
_DIRECTIONS, _DISTANCES = 160, (1.6, 5.0)

# Around the best: turned by so many degrees at most, in a grid of 5 x 5, and nearer and further.
_ZOOMS, _STRETCH = (12.0, 5.0, 2.0), (0.6, 1.0, 1.7)

# So many of the best first directions are followed.
_STARTS = 4


def start_from_lights(
    scene: Scene, target: Target, settings: RenderSettings, free: tuple[str, ...]
) -> Iterator[Scene]:
    """One scene to start from: the lights downhill from where they are in this scene."""
    look = sample_pixels(scene, target, settings, free)
    lights = scene.lights.position
    yield scene_with(
        look, free, refine_lights(look, lights) if "light_position" in free else lights
    )


def start_from_nothing(
    scene: Scene, target: Target, settings: RenderSettings, free: tuple[str, ...]
) -> Iterator[Scene]:
    """Scenes to start from, one after the other, the most promising first.

    **Arguments:** `scene`: its geometry, number of lights, and what is not free, are used.
    """
    if "light_position" not in free:
        yield from start_from_lights(scene, target, settings, free)
        return
    look = sample_pixels(scene, target, settings, free)
    middle, size = (np.asarray(x, np.float64) for x in extent(scene))
    grid = np.concatenate([middle + size * far * _all_around(_DIRECTIONS) for far in _DISTANCES])
    best = lambda terms, among, k: int(np.argmin(projected_costs(look, terms, among, k)))
    around, count = try_lights(look, grid), len(scene.lights)
    nothing = jnp.zeros((count, *around.shape[1:]), around.dtype)
    first = projected_costs(look, nothing, around, 0)
    for i in _apart(grid - middle, np.argsort(first))[:_STARTS]:
        lights, terms = np.repeat(grid[i][None], count, axis=0), nothing.at[0].set(around[i])
        for k in [*range(1, count), *range(count if count > 1 else 0)]:
            j = best(terms, around, k)
            lights[k], terms = grid[j], terms.at[k].set(around[j])
        for turn in _ZOOMS:
            for k in range(count):
                near = middle + _turned(lights[k] - middle, np.radians(turn))
                found = try_lights(look, near)
                j = best(terms, found, k)
                lights[k], terms = near[j], terms.at[k].set(found[j])
        yield scene_with(look, free, refine_lights(look, jnp.asarray(lights, scene.dtype)))


def _all_around(count: int) -> Float[np.ndarray, "count 3"]:
    """Directions all around, evenly spread (the Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)


def _turned(away: Float[np.ndarray, " 3"], angle: float) -> Float[np.ndarray, "c 3"]:
    """Vectors around one, turned by up to `angle` and stretched."""
    length = np.linalg.norm(away)
    along = away / length
    first = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    first /= np.linalg.norm(first)
    second = np.cross(along, first)
    steps = np.linspace(-np.tan(angle), np.tan(angle), 5)
    found = [along + a * first + b * second for a in steps for b in steps]
    found = np.stack([v / np.linalg.norm(v) for v in found])
    return np.concatenate([found * length * stretch for stretch in _STRETCH])


def _apart(vectors: Float[np.ndarray, "c 3"], order: Int[np.ndarray, " c"]) -> list[int]:
    """Of ordered vectors those that differ in direction from all better ones."""
    units = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    kept: list[int] = []
    for i in order:
        if all(units[i] @ units[j] < 0.8 for j in kept):
            kept.append(int(i))
    return kept
