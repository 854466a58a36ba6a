"""Materials: the colour of a surface point by the lecture's formula, textures and the background.

C = ka A S + sum over lights l of  lit_l C_l f_l (kd (N.L_l) S + ks highlight_l)
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from ..base.types import Ids, PixelArray
from ..base.vec import Vec, grey, vec, where
from ..scene.light import Light, make_light
from ..scene.scene import Scene
from .context import TraceContext
from .hit import Hit, Surface
from .shading import Finish
from .texture import lookup, second_square, sphere_uv, texture_color

#: Up to this many lights are written out; more are a loop, which compiles in the time of one.
MOST_LIGHTS = 4

LightTerms = Callable[[Light, bool], tuple[PixelArray, PixelArray]]
"""From a light, and whether objects may stand in its way, to lit N.L and highlight, faded."""


def finish_of(context: TraceContext, ids: Ids) -> Finish:
    """Returns what shapes the terms of the objects of these numbers."""
    needs = context.needs
    if not (needs.highlights or needs.coated):
        return Finish(None, None)
    return context.material(
        ids,
        lambda m: Finish(m.exponent if needs.highlights else None, m.ior if needs.coated else None),
    )


def sum_lights(
    context: TraceContext, shape: tuple[int, ...], terms: LightTerms, most: int = MOST_LIGHTS
) -> tuple[Vec, Vec]:
    """Sums C_l lit_l f_l (N.L_l) and C_l lit_l f_l highlight_l over all lights.

    **Arguments:** `shape`: of the terms. `most`: of more lights than these a loop is made.
    """
    lights, needs = context.scene.lights, context.needs
    # of white light one sum does for red, green and blue
    color_of = vec if needs.tinted else lambda color: color[0]
    dark = jnp.zeros(shape, context.dtype)
    dark = grey(dark) if needs.tinted else dark

    def add_light(
        sums: tuple[Any, Any], row: tuple, shadows: bool, directional: bool
    ) -> tuple[tuple, None]:
        position, falloff, color = row
        diffuse, shine = terms(make_light(position, falloff, directional), shadows)
        color = color_of(color)
        return (sums[0] + color * diffuse, sums[1] + color * shine), None

    def rows(at: Any, directional: bool) -> tuple:
        falloff = lights.falloff[at] if needs.falloff and not directional else None
        return lights.position[at], falloff, lights.color[at]

    sums: tuple[Any, Any] = (dark, dark)
    if len(lights) <= most:
        for i, far in enumerate(lights.directional):
            sums, _ = add_light(sums, rows(i, far), needs.shadows_of(i), far)
    else:
        for far in (False, True):
            for shadows in (False, True):
                alike = [i for i in lights.numbers(far) if needs.shadows_of(i) == shadows]
                if alike:
                    add = partial(add_light, shadows=shadows, directional=far)
                    sums, _ = lax.scan(add, sums, rows(np.array(alike), far))
    return sums if needs.tinted else (grey(sums[0]), grey(sums[1]))


def local_color(context: TraceContext, hit: Hit, surface: Surface, sums: tuple[Vec, Vec]) -> Vec:
    """Returns C = ka A S + sum_l lit_l C_l f_l (kd (N.L_l) S + ks highlight_l) at a hit.

    **Arguments:** `sums`: those of `sum_lights`.
    """
    lights = context.scene.lights
    ambient = vec(jnp.mean(lights.color, axis=0) if len(lights) else jnp.zeros(3, context.dtype))
    diffuse, shine = sums
    color, ka, kd, ks = context.material(hit.id, lambda m: (m.color, m.ka, m.kd, m.ks))
    color = surface_color(context, hit, surface, color)
    color = color * (ambient * ka + diffuse * kd)
    return color + shine * ks if context.needs.highlights else color


def surface_color(context: TraceContext, hit: Hit, surface: Surface, color: Vec) -> Vec:
    """Returns S: the object's own colour, under its texture or checker."""
    if context.needs.textures:
        outward = where(hit.inside, -surface.normal, surface.normal)
        images = tuple(t.image for t in context.scene.textures)
        color = color * texture_color(
            context.tables, hit.id, outward, images, context.scene.spheres.pic
        )
    if context.needs.checkers:
        other, checker_color = second_square(context.tables, hit.id, surface.point)
        color = where(other, checker_color, color)
    return color


def surface_tint(context: TraceContext, hit: Hit, surface: Surface, direction: Vec) -> Vec:
    """Returns what the colour of a sphere is multiplied by, the colour of a plane or of the sky.

    None of these moves with what a fit may change while geometry and camera stay.
    """
    one = jnp.ones(hit.id.shape, context.dtype)
    color = context.material(hit.id, lambda m: m.color)
    tint = where(context.tables.is_plane(hit.id), color, grey(one))
    tint = surface_color(context, hit, surface, tint)
    if not context.needs.background:
        return tint
    return where(hit.id >= 0, tint, background_color(context.scene, direction))


def background_color(scene: Scene, direction: Vec) -> Vec:
    """Returns the colour of rays that leave the world: the sky's picture, or one colour."""
    if scene.sky is not None:
        return lookup(scene.sky.image, *sphere_uv(direction))
    return vec(scene.background)
