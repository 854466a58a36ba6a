"""Samples: the k x k parts of each pixel, their rays, and what these see."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from ..acceleration.screen_tiles import TILE
from ..antialiasing.pixel_radiance import pixel_radiance
from ..base.types import Ids, Mask, Picture, PixelArray
from ..base.vec import Vec, where, zeros
from ..scene.camera import Ray, pixel_rays
from ..scene.scene import Scene
from ..scene.settings import RenderSettings
from ..tracing.cone import pixel_cones
from ..tracing.context import TraceContext
from ..tracing.differential import Differential, pixel_differentials
from ..xla.compaction import add_where
from ..xla.loops import STRIP_PIXELS, keep_loop_parallel
from ..xla.rematerialization import remat
from .pixel_filter import interleave
from .wavefront import ray_radiance

T = TypeVar("T")

# Pixels with edges are composited this many at a time, as few as keeps the overhead small.
EDGE_PIXELS = 1 << 11


def render_samples(context: TraceContext, cover: bool = True) -> tuple[Vec | Picture, Mask]:
    """Returns the mean of each pixel's samples, and where there may be edges.

    Where edges are covered, the mean is a `Vec` with the rows above and below; of single rays it is
    the picture.

    **Arguments:** `cover`: false to leave pixels with edges black, where the mask is enough.
    """
    settings, k = context.settings, context.settings.samples
    positions = sample_positions(context.scene, settings)
    if k == 1:
        return _render_sample(context, positions[0][0], positions[1][0], cover)

    def add(total: tuple, position: tuple) -> tuple[tuple, None]:
        left, top = position
        color, edge = _render_sample(context, left, top, cover)
        return (total[0] + color, total[1] | edge), None

    rows, width = settings.rows.count, settings.width
    black = jnp.zeros((rows, width, 3), context.dtype)
    if settings.antialias:
        black = zeros((rows + 2, width), context.dtype)
    (color, edge), _ = lax.scan(add, (black, jnp.full((rows, width), False)), positions)
    return color * (1 / k**2), edge


def sample_positions(scene: Scene, settings: RenderSettings) -> tuple[Array, Array]:
    """Returns where the k x k samples of the first pixel are, in pixels from the left and the top.

    The samples of pixel (row, column) are these plus (column, row).
    """
    # centred on the pixel: its box filter, which may be wider, has the same centre
    middles = jnp.arange(settings.samples, dtype=scene.dtype) + (1 - settings.samples) / 2
    middles = 0.5 + middles * settings.side
    left, top = jnp.meshgrid(middles, middles)
    first = jnp.asarray(settings.rows.first, scene.dtype)
    return left.reshape(-1), top.reshape(-1) + first


def point_radiance(context: TraceContext, pixels: Ids, left: Array, top: Array) -> Vec:
    """Returns what one ray sees of some pixels.

    **Arguments:** `pixels`: numbers, row by row. `left`, `top`: the position of the sample in the
    first pixel, as `sample_positions` says.
    """
    ray = sample_rays(context.scene, context.settings, pixels, left, top)
    return ray_radiance(context, ray)[0]


def area_radiance(context: TraceContext, pixels: Ids, alive: Mask, left: Array, top: Array) -> Vec:
    """Returns what a sample sees of some pixels, their edges covered by area.

    **Arguments:** as for `point_radiance`; `alive`: which pixels count; others are 0.
    """
    ray = eye_differentials(context, pixels, left, top)
    return pixel_radiance(context.of_pixels(pixels), ray, alive)


def eye_differentials(
    context: TraceContext, pixels: Ids, left: Array, top: Array
) -> Differential[Ray]:
    """Returns the rays of one sample of some pixels, with their differentials."""
    settings = context.settings
    column, row = _positions(pixels, settings, left, top)
    size = settings.width, settings.height
    return pixel_differentials(context.scene.camera, column, row, size, settings.side)


def sample_rays(
    scene: Scene, settings: RenderSettings, pixels: Ids, left: Array, top: Array
) -> Ray:
    """Returns the rays of one sample of some pixels. **Arguments:** as for `point_radiance`."""
    column, row = _positions(pixels, settings, left, top)
    return pixel_rays(scene.camera, column, row, (settings.width, settings.height))


def _positions(
    pixels: Ids, settings: RenderSettings, left: Array, top: Array
) -> tuple[PixelArray, PixelArray]:
    """Returns where samples are, in pixels from the picture's left and top."""
    column, row = pixels % settings.width, pixels // settings.width
    return left + column.astype(left.dtype), top + row.astype(top.dtype)


def trace_strips(
    context: TraceContext, left: Array, top: Array, trace: Callable[[TraceContext, Ray], T]
) -> T:
    """Traces the rays of one sample of each pixel, strip by strip.

    **Arguments:** `left`, `top`: as for `point_radiance`. `trace`: returns what the rays of a strip
    see, in arrays whose first axes are the strip's rows and columns.

    **Returns:** the same for all rows.
    """
    settings, camera, dtype = context.settings, context.scene.camera, context.dtype
    size, count = (settings.width, settings.height), settings.rows.count
    strips = -(-settings.width * count // STRIP_PIXELS)
    rows = -(-count // strips)
    if context.accelerator is not None:
        rows = -(-rows // TILE) * TILE

    # the reverse pass traces a strip again rather than keep the temporaries of all of them
    @remat
    def trace_strip(first_row: Int[Array, ""]) -> T:
        first_row = keep_loop_parallel(first_row)
        columns, lines = (jnp.arange(n, dtype=dtype) for n in (settings.width, rows))
        lines = top + first_row.astype(dtype) + lines
        ray = pixel_rays(camera, (left + columns)[None, :], lines[:, None], size)
        return trace(context.from_row(first_row), ray)

    first_rows = jnp.arange(0, count, rows, dtype=jnp.int32)
    join_strips = lambda x: x.reshape(-1, *x.shape[2:])[:count]
    return jax.tree.map(join_strips, lax.map(trace_strip, first_rows))


def _strip_radiance(context: TraceContext, ray: Ray) -> tuple[Vec | Picture, Mask]:
    """Returns what rays see, black where edges are covered, and where there may be edges."""
    settings, camera, cone = context.settings, context.scene.camera, None
    if settings.antialias:
        cone = pixel_cones(camera, ray, camera.window / settings.height * settings.side)
    color, edge = ray_radiance(context, ray, cone)
    if settings.antialias:
        return where(edge, zeros(edge.shape, context.dtype), color), edge
    # interleaved here, the rows go straight into the picture: 9.8 against 11.3 ms
    return interleave(color), edge


def _render_sample(
    context: TraceContext, left: Array, top: Array, cover: bool
) -> tuple[Vec | Picture, Mask]:
    """Renders one sample of each pixel; returns what `render_samples` does."""
    settings, width = context.settings, context.settings.width
    color, edge = trace_strips(context, left, top, _strip_radiance)
    if not settings.antialias:
        return color, edge

    def composite(pixels: Int[Array, " n"], alive: Mask) -> Vec:
        # the mask has one row more above
        return area_radiance(context, pixels - width, alive, left, top)

    # with a place for the rows above and below from now on, no copy is made where neighbours are
    # asked for (22 against 33 ms for the nine spheres' picture)
    color = jax.tree.map(settings.rows.with_neighbours, color)
    if not cover:
        return color, edge
    mask = jnp.pad(edge, ((1, 1), (0, 0))).reshape(-1)
    flat = jax.tree.map(jnp.ravel, color)
    flat = add_where(flat, mask, composite, min(EDGE_PIXELS, edge.size), rematerialize=True)
    return jax.tree.map(lambda x: x.reshape(-1, width), flat), edge
