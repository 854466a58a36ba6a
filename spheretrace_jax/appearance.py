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
from .world import Hit, Material, Surface, World


def local_color(
    scene: Scene,
    world: World,
    hit: Hit,
    surface: Surface,
    material: Material,
    needs: Needs,
    terms: Callable[[Vec], tuple[Plane, Plane]],
) -> Vec:
    """The lecture's C = ka A S + sum_l lit_l C_l (kd (N.L_l) S + ks highlight_l) at a hit.

    **Arguments:** `terms`: lit N.L and lit highlight for a light at a given position.
    """
    lights = scene.lights
    own_color = surface_color(scene, world, hit, surface, material, needs)
    ambient = vec(jnp.mean(lights.color, axis=0) if len(lights) else jnp.zeros(3, scene.dtype))

    def add_light(sums: tuple[Vec, Vec], light: tuple) -> tuple[tuple[Vec, Vec], None]:
        diffuse, shine = terms(vec(light[0]))
        light_color = vec(light[1])
        return (sums[0] + light_color * diffuse, sums[1] + light_color * shine), None

    black = zeros(hit.id.shape, scene.dtype)
    sums = black, black
    if len(lights) <= UNROLL // 4:
        for i in range(len(lights)):
            sums, _ = add_light(sums, (lights.position[i], lights.color[i]))
    else:
        sums, _ = lax.scan(add_light, sums, (lights.position, lights.color))
    diffuse, shine = sums
    color = own_color * (ambient * material.ka + diffuse * material.kd)
    return color + shine * material.ks if needs.highlights else color


def surface_color(
    scene: Scene, world: World, hit: Hit, surface: Surface, material: Material, needs: Needs
) -> Vec:
    """S: the object's colour, under its texture or checker."""
    color = material.color
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
