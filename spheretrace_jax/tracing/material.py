"""What colour a point of an object has: the lecture's formula, its texture, the background."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from ..base.types import PixelArray
from ..base.vec import Vec, grey, vec, where
from ..scene.needs import Needs
from ..scene.scene import Scene
from .tables import Hit, SceneTables, Surface
from .texture import lookup, other_square, sphere_uv, worn

#: Of more lights a loop is made rather than the same written out again.
MOST_LIGHTS = 4


def sum_lights(
    scene: Scene,
    shape: tuple[int, ...],
    needs: Needs,
    terms: Callable[[Vec, bool], tuple[PixelArray, PixelArray]],
    most: int = MOST_LIGHTS,
) -> tuple[Vec, Vec]:
    """Over all lights the sums of C_l lit_l (N.L_l) and of C_l lit_l highlight_l.

    **Arguments:** `terms`: lit N.L and lit highlight of `shape` for a light at a given position,
    where objects may stand in its way or not. `most`: of more lights than these a loop is made.
    """
    lights = scene.lights
    # of white light one sum does for red, green and blue
    color_of = vec if needs.tinted else lambda color: color[0]
    dark = jnp.zeros(shape, scene.dtype)
    dark = grey(dark) if needs.tinted else dark

    def add_light(sums: tuple[Any, Any], light: tuple, shadows: bool) -> tuple[tuple, None]:
        diffuse, shine = terms(vec(light[0]), shadows)
        color = color_of(light[1])
        return (sums[0] + color * diffuse, sums[1] + color * shine), None

    sums: tuple[Any, Any] = (dark, dark)
    if len(lights) <= most:
        for i in range(len(lights)):
            light = lights.position[i], lights.color[i]
            sums, _ = add_light(sums, light, needs.shadows_of(i))
    else:
        for shadows in (False, True):
            alike = [i for i in range(len(lights)) if needs.shadows_of(i) == shadows]
            if alike:
                light = lights.position[np.array(alike)], lights.color[np.array(alike)]
                sums, _ = lax.scan(partial(add_light, shadows=shadows), sums, light)
    return sums if needs.tinted else (grey(sums[0]), grey(sums[1]))


def local_color(
    scene: Scene,
    world: SceneTables,
    hit: Hit,
    surface: Surface,
    needs: Needs,
    sums: tuple[Vec, Vec],
) -> Vec:
    """The lecture's C = ka A S + sum_l lit_l C_l (kd (N.L_l) S + ks highlight_l) at a hit.

    **Arguments:** `sums`: those of `light_sums`.
    """
    lights = scene.lights
    ambient = vec(jnp.mean(lights.color, axis=0) if len(lights) else jnp.zeros(3, scene.dtype))
    diffuse, shine = sums
    color, ka, kd, ks = world.material(hit.id, lambda m: (m.color, m.ka, m.kd, m.ks))
    color = surface_color(scene, world, hit, surface, color, needs)
    color = color * (ambient * ka + diffuse * kd)
    return color + shine * ks if needs.highlights else color


def surface_color(
    scene: Scene, world: SceneTables, hit: Hit, surface: Surface, color: Vec, needs: Needs
) -> Vec:
    """S: the object's own colour, under its texture or checker."""
    if needs.textures:
        outward = where(hit.inside, -surface.normal, surface.normal)
        images = tuple(t.image for t in scene.textures)
        color = color * worn(hit.id, outward, images, scene.spheres.pic)
    if needs.checkers:
        other, checker_color = other_square(world, hit.id, surface.point)
        color = where(other, checker_color, color)
    return color


def background_color(scene: Scene, direction: Vec) -> Vec:
    """What rays see that leave the world: the sky's picture all around, or one colour."""
    if scene.sky is not None:
        return lookup(scene.sky.image, *sphere_uv(direction))
    return vec(scene.background)
