"""From a scene to a picture: strips of pixels, samples per pixel, edges."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jax.sharding import NamedSharding
from jaxtyping import Array, Float, Int

from ..acceleration.accelerator import build_accelerator
from ..acceleration.screen_tiles import TILE
from ..antialiasing.differential import pixel_differentials
from ..antialiasing.edge_mask import pixel_cones
from ..antialiasing.pixel_radiance import pixel_radiance
from ..base.types import Highlight, Ids, Mask, Picture, PixelArray
from ..base.vec import Vec, where, zeros
from ..scene.camera import Ray, pixel_rays
from ..scene.needs import Needs
from ..scene.scene import Scene
from ..scene.settings import RenderSettings, render_settings
from ..tracing.tables import SceneTables, build_tables
from ..xla.barriers import barrier
from ..xla.compaction import add_where
from ..xla.jit import compiled
from ..xla.loops import STRIP_PIXELS, keep_loop_parallel
from ..xla.rematerialization import remat
from ..xla.sharding import everywhere, on_devices
from .wavefront import ray_radiance

# Pixels with edges are composed this many at a time, as few as keeps the overhead small.
EDGE_PIXELS = 1 << 11


def render(
    scene: Scene,
    *,
    width: int = 512,
    height: int = 512,
    highlight: Highlight = "phong",
    bounces: int = 5,
    samples: int = 1,
    needs: Needs | None = None,
    sharding: NamedSharding | None = None,
) -> Picture:
    """The picture of a scene: a pure function, differentiable in every array of the scene.

    Compiled once per shape and need of the scene; other numbers never compile again. Where the
    scene's antialias flag is 1, pixels are averages over their area: edges are covered
    analytically, and the derivatives say how the picture changes as they move. Where it is 0,
    pixels are single rays, and derivatives are those of the surfaces' colours alone. For
    derivatives by ks, kgr or kt where they are 0, pass `needs(scene, free=("ks", "kgr", "kt"))`.

    **Arguments:**

    - `width`, `height`: the picture's size in pixels.
    - `highlight`: `"phong"` for (R.V)^n or `"blinn"` for (H.N)^n.
    - `bounces`: how many reflections and transmissions n a path goes through at most. Where an
      object both reflects and transmits, 2^n paths are followed.
    - `samples`: k for the average of k x k parts of each pixel, each a picture of its own:
      edges covered analytically or single rays, as the antialias flag says. By default 1.
    - `needs`: what to compute, by default what `spheretrace_jax.needs(scene)` finds; to be given
      under jit, grad and vmap, where the scene's numbers are not known.
    - `sharding`: how the picture's rows lie on several devices, each of which computes its own:
      `NamedSharding(mesh, PartitionSpec("rows"))`, where rows is an axis of the mesh or several.

    **Returns:** linear RGB of shape `(height, width, 3)`, unclamped, in the scene's dtype. Row 0
    is the top. With `sharding`, rows lie on their devices, if these divide the height; if not,
    every device holds all of them. Where devices are those of several processes, all of these call
    `render` with the same arguments, and `jax.experimental.multihost_utils.process_allgather(
    picture, tiled=True)` is the whole picture as a numpy array.

    **Raises:** `InputError` for sizes, samples or bounces out of range, unknown highlights and
    shardings that divide other than rows.
    """
    checked = render_settings(
        scene, width, height, highlight=highlight, bounces=bounces, samples=samples, needs=needs,
        sharding=sharding,
    )  # fmt: skip
    return draw(everywhere(scene, checked.sharding), checked)


@compiled
def draw(scene: Scene, settings: RenderSettings) -> Picture:
    """`render` with its static arguments already checked."""
    if settings.sharding is None:
        return _rows(scene, settings)
    own = lambda whole, _: _rows(*whole)
    return on_devices(own, settings.sharding, (scene, settings.of_device))[: settings.height]


def draw_everywhere(scene: Scene, settings: RenderSettings) -> Picture:
    """`draw`, and the whole picture on each device."""
    return everywhere(draw(scene, settings), settings.sharding)


def _rows(scene: Scene, settings: RenderSettings) -> Picture:
    """The rows of the picture that are to be computed."""
    return averaged(*sampled(scene, settings), settings)


def sampled(scene: Scene, settings: RenderSettings) -> tuple[Vec | Picture, Mask]:
    """The mean of each pixel's samples, and in which pixels there may be edges.

    Where edges are covered, in planes, with the rows above and below.
    """
    size = settings.width, settings.height
    known = build_accelerator(scene, size, settings.needs, settings.bounces, settings.rows)
    world, k = build_tables(scene).listed(known), settings.samples
    places = sample_places(scene, settings)
    if k == 1:
        return _sample(scene, world, settings, places[0][0], places[1][0])

    def add(total: tuple, place: tuple) -> tuple[tuple, None]:
        color, edge = _sample(scene, world, settings, *place)
        return (total[0] + color, total[1] | edge), None

    rows, width = settings.rows.count, settings.width
    black = jnp.zeros((rows, width, 3), scene.dtype)
    if settings.antialias:
        black = zeros((rows + 2, width), scene.dtype)
    (color, edge), _ = lax.scan(add, (black, jnp.full((rows, width), False)), places)
    return color * (1 / k**2), edge


def sample_places(scene: Scene, settings: RenderSettings) -> tuple[Array, Array]:
    """Where a pixel's k x k samples are: in pixels, from its left and from its top.

    Of the first one that is computed; of another so many rows and columns away add these.
    """
    # from the middle of the pixel, where that of its box is too
    middles = jnp.arange(settings.samples, dtype=scene.dtype) + (1 - settings.samples) / 2
    middles = 0.5 + middles * settings.side
    left, top = jnp.meshgrid(middles, middles)
    first = jnp.asarray(settings.rows.first, scene.dtype)
    return left.reshape(-1), top.reshape(-1) + first


def averaged(color: Vec | Picture, edge: Mask, settings: RenderSettings) -> Picture:
    """The picture's rows: where pixels are areas, smooth shading is averaged over them, too.

    The mean of a smooth f over a pixel is f + (f_xx + f_yy)/24: without that what is bright and
    small, as highlights are, is too bright at its centre.

    **Arguments:** `color`: as `sampled` says.
    """
    if not isinstance(color, Vec):
        return color
    across, down = smooth_beside(edge, settings)
    # known once, and in one byte: in the reverse pass they are asked for five times a pixel
    sides = barrier(across.astype(jnp.int8) + 2 * down.astype(jnp.int8))
    across, down = sides & 1 > 0, sides & 2 > 0
    part, width = bend_part(settings), settings.width

    def mean(plane: Float[Array, "all width"]) -> Float[Array, "height width"]:
        beside = _further_on(plane, settings)
        f = beside(0)
        bend_x = beside(-1) + beside(1) - 2 * f
        bend_y = beside(-width) + beside(width) - 2 * f
        return f + (jnp.where(across, bend_x, 0) + jnp.where(down, bend_y, 0)) * part

    return _interleaved(jax.tree.map(mean, color))


def _interleaved(color: Vec) -> Picture:
    return jnp.stack([color.x, color.y, color.z], axis=-1)


def bend_part(settings: RenderSettings) -> Float[Array, ""] | float:
    """What second differences of neighbours count in a pixel's mean."""
    return settings.side**2 / 24


def smooth_beside(edge: Mask, settings: RenderSettings) -> tuple[Mask, Mask]:
    """Where there is no edge in a pixel nor left and right of it, and not above and below."""
    smooth = ~edge & settings.rows.within(settings.height)[:, None]
    beside = _further_on(settings.rows.with_neighbours(smooth), settings)
    column = jnp.arange(settings.width, dtype=jnp.int32)
    inner = (column > 0) & (column < settings.width - 1)
    across = beside(-1) & beside(1) & inner[None, :]
    return smooth & across, smooth & beside(-settings.width) & beside(settings.width)


def _further_on(plane: Array, settings: RenderSettings) -> Callable[[int], Array]:
    """What is so much further on, row by row, than each pixel: its neighbours, for one.

    **Arguments:** `plane`: with the rows above and below.
    """
    rows, width = settings.rows.count, settings.width
    flat = plane.reshape(-1)

    def further_on(by: int) -> Array:
        start = width + by
        return lax.slice(flat, (start,), (start + rows * width,)).reshape(rows, width)

    return further_on


def point_seen(
    scene: Scene,
    world: SceneTables,
    settings: RenderSettings,
    pixels: Ids,
    left: Array,
    top: Array,
) -> Vec:
    """What one ray sees of some pixels. **Arguments:** `pixels`: row by row from `left`, `top`."""
    return ray_radiance(scene, world, rays_through(scene, settings, pixels, left, top), settings)[0]


def rays_through(
    scene: Scene, settings: RenderSettings, pixels: Ids, left: Array, top: Array
) -> Ray:
    """The rays of one sample of some pixels."""
    column, row = _position(pixels, settings, left, top)
    return pixel_rays(scene.camera, column, row, (settings.width, settings.height))


def area_seen(
    scene: Scene,
    world: SceneTables,
    settings: RenderSettings,
    pixels: Ids,
    alive: Mask,
    left: Array,
    top: Array,
) -> Vec:
    """What a sample sees of some pixels, their edges covered by area.

    **Arguments:** `pixels`: row by row from `left`, `top`. `alive`: which of them count; others
    are 0.
    """
    column, row = _position(pixels, settings, left, top)
    size = settings.width, settings.height
    beam = pixel_differentials(scene.camera, column, row, size, settings.side)
    return pixel_radiance(scene, world, beam, settings, alive)


def _position(
    pixels: Ids, settings: RenderSettings, left: Array, top: Array
) -> tuple[PixelArray, PixelArray]:
    """Where samples are, in pixels from the picture's left and top."""
    column, row = pixels % settings.width, pixels // settings.width
    return left + column.astype(left.dtype), top + row.astype(top.dtype)


def _sample(
    scene: Scene, world: SceneTables, settings: RenderSettings, left: Array, top: Array
) -> tuple[Vec | Picture, Mask]:
    """One sample of each pixel, and in which pixels there may be edges, as `sampled` says.

    **Arguments:** `left`, `top`: where the first one is, in pixels.
    """
    dtype, width, height = scene.dtype, settings.width, settings.height
    count = settings.rows.count
    strips = -(-width * count // STRIP_PIXELS)
    rows = -(-count // strips)
    if world.lists is not None:
        rows = -(-rows // TILE) * TILE

    # the reverse pass traces a strip again rather than keep the temporaries of all of them
    @remat
    def trace(first_row: Int[Array, ""]) -> tuple[Vec | Picture, Mask]:
        first_row = keep_loop_parallel(first_row)
        columns, lines = (jnp.arange(n, dtype=dtype) for n in (width, rows))
        lines = top + first_row.astype(dtype) + lines
        ray = pixel_rays(scene.camera, (left + columns)[None, :], lines[:, None], (width, height))
        cone = None
        if settings.antialias:
            side = scene.camera.window / height * settings.side
            cone = pixel_cones(scene.camera, ray, side)
        color, edge = ray_radiance(scene, world.of_strip(first_row), ray, settings, cone=cone)
        if settings.antialias:
            return where(edge, zeros(edge.shape, dtype), color), edge
        # interleaved here, the rows go straight into the picture: 9.8 against 11.3 ms
        return _interleaved(color), edge

    first_rows = jnp.arange(0, count, rows, dtype=jnp.int32)
    whole = lambda x: x.reshape(-1, *x.shape[2:])[:count]
    color, edge = jax.tree.map(whole, lax.map(trace, first_rows))
    if not settings.antialias:
        return color, edge

    def compose(pixels: Int[Array, " n"], alive: Mask) -> Vec:
        return area_seen(scene, world, settings, pixels - width, alive, left, top)

    # with a place for the rows above and below from now on, no copy is made where neighbours are
    # asked for (22 against 33 ms for the nine spheres' picture)
    color = jax.tree.map(settings.rows.with_neighbours, color)
    marked = jnp.pad(edge, ((1, 1), (0, 0))).reshape(-1)
    flat = jax.tree.map(jnp.ravel, color)
    flat = add_where(flat, marked, compose, min(EDGE_PIXELS, edge.size), again=True)
    return jax.tree.map(lambda x: x.reshape(-1, width), flat), edge
