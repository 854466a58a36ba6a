"""Candidates: the spheres that pixels with edges look at, in scenes of very many spheres.

A pixel is wider than its ray, so that more spheres may matter to it than its ray meets. Pixels find
the same among their candidates as among all spheres.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import jax.numpy as jnp
from jax import lax

from ..acceleration.binning import Visitor
from ..acceleration.sphere_blocks import PixelCone
from ..base.types import Mask, PixelArray
from ..base.vec import Vec
from ..scene.camera import Ray
from ..scene.light import Light
from .context import Candidates, TraceContext
from .hit import Hit

T = TypeVar("T")

# Cells of the light buffer up to which a pixel looks at each. Where a surface is seen at a grazing
# angle, a pixel may have thousands: all spheres are fewer then.
_MOST_CELLS = 16


def cone_candidates(
    context: TraceContext, cone: PixelCone, source_hit: Hit | None
) -> Candidates | None:
    """Returns the spheres in the cones of a picture's pixels; None for all spheres.

    **Arguments:** `source_hit`: the hit that the cones start from, None for the eye.
    """
    accelerator = context.accelerator
    if accelerator is None or accelerator.sphere_blocks is None:
        return None
    if source_hit is None and accelerator.screen_tiles.row is not None:
        return accelerator.screen_tiles.visit
    return partial(accelerator.sphere_blocks.visit, cone)


def nearest_in_cone(
    context: TraceContext,
    cone: PixelCone,
    source_hit: Hit | None,
    max_distance: Callable[[T], PixelArray],
) -> Candidates | None:
    """Returns the spheres in the cones of few pixels, nearest first; None for all spheres.

    **Arguments:** as for `cone_candidates`. `max_distance`: from a pixel's state to the distance
    beyond which no sphere changes the state.
    """
    accelerator = context.accelerator
    if accelerator is None or accelerator.sphere_blocks is None:
        return None
    tiles = accelerator.screen_tiles
    if source_hit is None and tiles.cell is not None:
        return partial(tiles.visit_nearest, cone, max_distance)
    return partial(accelerator.sphere_blocks.visit_each, cone, max_distance, True)


def shadow_cone(light: Light, point: Vec, radius: PixelArray, alive: Mask) -> PixelCone:
    """Returns what balls around surface points see of the way to a light."""
    ray, end = Ray(point, light.direction(point)), light.distance(point)
    return PixelCone(ray, radius, jnp.zeros_like(radius), alive, -radius, end)


def shadow_candidates(
    context: TraceContext, light: Light, cone: PixelCone, done: Callable[[T], Mask]
) -> Candidates | None:
    """Returns the spheres between a light and what a picture's pixels show; None for all spheres.

    Spheres may come more than once.

    **Arguments:** `cone`: that of `shadow_cone`. `done`: true of a state that no sphere changes.
    """
    accelerator = context.accelerator
    if accelerator is None or accelerator.light_buffers is None:
        return None
    blocks = accelerator.sphere_blocks
    assert blocks is not None
    cells = accelerator.light_buffer(light).cells_around(cone.ray.origin, cone.radius)
    few = cells.count <= _MOST_CELLS
    wide = dataclasses.replace(cone, alive=cone.alive & ~few)

    def visit(visitor: Visitor, pixels: Any, state: T) -> T:
        state = cells.visit(cone.alive & few, done, visitor, pixels, state)
        others = lambda state: blocks.visit(wide, visitor, pixels, state)
        return lax.cond(jnp.any(wide.alive), others, lambda state: state, state)

    return visit


def few_shadow_candidates(
    context: TraceContext, cone: PixelCone, done: Callable[[T], Mask]
) -> Candidates | None:
    """Returns the spheres between a light and few pixels; None for all spheres.

    **Arguments:** as for `shadow_candidates`.
    """
    accelerator = context.accelerator
    if accelerator is None or accelerator.sphere_blocks is None:
        return None
    dtype = cone.radius.dtype
    max_distance = lambda state: jnp.where(done(state), -jnp.inf, jnp.inf).astype(dtype)
    return partial(accelerator.sphere_blocks.visit_each, cone, max_distance, False)
