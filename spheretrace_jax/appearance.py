"""What colour a point of an object has: the lecture's formula, its texture, the background."""

from collections.abc import Callable

import jax.numpy as jnp
from jax import lax

from ._types import Plane
from .needs import Needs
from .phases import UNROLL
from .scene import Scene
from .texture import lookup, other_square, sphere_uv, worn
from .vec import Vec, vec, where, zeros
from .world import Hit, Surface, World


def light_sums(
    scene: Scene, shape: tuple[int, ...], terms: Callable[[Vec], tuple[Plane, Plane]]
) -> tuple[Vec, Vec]:
    """Over all lights the sums of C_l lit_l (N.L_l) and of C_l lit_l highlight_l.

    **Arguments:** `terms`: lit N.L and lit highlight for a light at a given position, of `shape`.
    """
    lights = scene.lights

    def add_light(sums: tuple[Vec, Vec], light: tuple) -> tuple[tuple[Vec, Vec], None]:
        diffuse, shine = terms(vec(light[0]))
        light_color = vec(light[1])
        return (sums[0] + light_color * diffuse, sums[1] + light_color * shine), None

    black = zeros(shape, scene.dtype)
    sums = black, black
    if len(lights) > UNROLL // 4:
        return lax.scan(add_light, sums, (lights.position, lights.color))[0]
    for i in range(len(lights)):
        sums, _ = add_light(sums, (lights.position[i], lights.color[i]))
    return sums


def local_color(
    scene: Scene,
    world: World,
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
    scene: Scene, world: World, hit: Hit, surface: Surface, color: Vec, needs: Needs
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


def background(scene: Scene, direction: Vec) -> Vec:
    """What rays see that leave the world: the sky's picture all around, or one colour."""
    if scene.sky is not None:
        return lookup(scene.sky.image, *sphere_uv(direction))
    return vec(scene.background)
