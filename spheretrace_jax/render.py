"""From a scene to a picture: strips of pixels, samples per pixel, edges."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jax.sharding import NamedSharding
from jaxtyping import Array, Float, Int

from ._types import Highlight, Ids, Mask, Picture, Plane
from .area import area_color
from .camera import Ray, pixel_rays
from .charts import TILE
from .edges import pixel_cones
from .lists import lists
from .marked import add_where
from .needs import Needs
from .options import Options, options
from .phases import STRIP_PIXELS, compiled, keep, large, retrace
from .radiance import radiance
from .scene import Scene
from .sharding import everywhere, on_devices
from .varying import pixel_beams
from .vec import Vec, where, zeros
from .world import World, build_world

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
    checked = options(scene, width, height, highlight, bounces, samples, needs, sharding)
    return draw(everywhere(scene, checked.sharding), checked)


@compiled
def draw(scene: Scene, options: Options) -> Picture:
    """`render` with its static arguments already checked."""
    if options.sharding is None:
        return _rows(scene, options)
    own = lambda whole, _: _rows(*whole)
    return on_devices(own, options.sharding, (scene, options.of_device))[: options.height]


def draw_everywhere(scene: Scene, options: Options) -> Picture:
    """`draw`, and the whole picture on each device."""
    return everywhere(draw(scene, options), options.sharding)


def _rows(scene: Scene, options: Options) -> Picture:
    """The rows of the picture that are to be computed."""
    return averaged(*sampled(scene, options), options)


def sampled(scene: Scene, options: Options) -> tuple[Vec | Picture, Mask]:
    """The mean of each pixel's samples, and in which pixels there may be edges.

    Where edges are covered, in planes, with the rows above and below.
    """
    size = options.width, options.height
    known = lists(scene, size, options.needs, options.bounces, options.rows)
    world, k = build_world(scene).listed(known), options.samples
    places = sample_places(scene, options)
    if k == 1:
        return _sample(scene, world, options, places[0][0], places[1][0])

    def add(total: tuple, place: tuple) -> tuple[tuple, None]:
        color, edge = _sample(scene, world, options, *place)
        return (total[0] + color, total[1] | edge), None

    rows, width = options.rows.count, options.width
    black = jnp.zeros((rows, width, 3), scene.dtype)
    if options.antialias:
        black = zeros((rows + 2, width), scene.dtype)
    (color, edge), _ = lax.scan(add, (black, jnp.full((rows, width), False)), places)
    return color * (1 / k**2), edge


def sample_places(scene: Scene, options: Options) -> tuple[Array, Array]:
    """Where a pixel's k x k samples are: in pixels, from its left and from its top.

    Of the first one that is computed; of another so many rows and columns away add these.
    """
    # from the middle of the pixel, where that of its box is too
    middles = jnp.arange(options.samples, dtype=scene.dtype) + (1 - options.samples) / 2
    middles = 0.5 + middles * options.side
    left, top = jnp.meshgrid(middles, middles)
    first = jnp.asarray(options.rows.first, scene.dtype)
    return left.reshape(-1), top.reshape(-1) + first


def averaged(color: Vec | Picture, edge: Mask, options: Options) -> Picture:
    """The picture's rows: where pixels are areas, smooth shading is averaged over them, too.

    The mean of a smooth f over a pixel is f + (f_xx + f_yy)/24: without that what is bright and
    small, as highlights are, is too bright at its centre.

    **Arguments:** `color`: as `sampled` says.
    """
    if not isinstance(color, Vec):
        return color
    across, down = smooth_beside(edge, options)
    # known once, and in one byte: in the reverse pass they are asked for five times a pixel
    sides = keep(across.astype(jnp.int8) + 2 * down.astype(jnp.int8))
    across, down = sides & 1 > 0, sides & 2 > 0
    part, width = bend_part(options), options.width

    def mean(plane: Float[Array, "all width"]) -> Float[Array, "height width"]:
        beside = _further_on(plane, options)
        f = beside(0)
        bend_x = beside(-1) + beside(1) - 2 * f
        bend_y = beside(-width) + beside(width) - 2 * f
        return f + (jnp.where(across, bend_x, 0) + jnp.where(down, bend_y, 0)) * part

    return _interleaved(jax.tree.map(mean, color))


def _interleaved(color: Vec) -> Picture:
    return jnp.stack([color.x, color.y, color.z], axis=-1)


def bend_part(options: Options) -> Float[Array, ""] | float:
    """What second differences of neighbours count in a pixel's mean."""
    return options.side**2 / 24


def smooth_beside(edge: Mask, options: Options) -> tuple[Mask, Mask]:
    """Where there is no edge in a pixel nor left and right of it, and not above and below."""
    smooth = ~edge & options.rows.within(options.height)[:, None]
    beside = _further_on(options.rows.with_neighbours(smooth), options)
    column = jnp.arange(options.width, dtype=jnp.int32)
    inner = (column > 0) & (column < options.width - 1)
    across = beside(-1) & beside(1) & inner[None, :]
    return smooth & across, smooth & beside(-options.width) & beside(options.width)


def _further_on(plane: Array, options: Options) -> Callable[[int], Array]:
    """What is so much further on, row by row, than each pixel: its neighbours, for one.

    **Arguments:** `plane`: with the rows above and below.
    """
    rows, width = options.rows.count, options.width
    flat = plane.reshape(-1)

    def further_on(by: int) -> Array:
        start = width + by
        return lax.slice(flat, (start,), (start + rows * width,)).reshape(rows, width)

    return further_on


def point_seen(
    scene: Scene, world: World, options: Options, pixels: Ids, left: Array, top: Array
) -> Vec:
    """What one ray sees of some pixels. **Arguments:** `pixels`: row by row from `left`, `top`."""
    return radiance(scene, world, rays_through(scene, options, pixels, left, top), options)[0]


def rays_through(scene: Scene, options: Options, pixels: Ids, left: Array, top: Array) -> Ray:
    """The rays of one sample of some pixels."""
    column, row = _position(pixels, options, left, top)
    return pixel_rays(scene.camera, column, row, (options.width, options.height))


def area_seen(
    scene: Scene,
    world: World,
    options: Options,
    pixels: Ids,
    alive: Mask,
    left: Array,
    top: Array,
) -> Vec:
    """What a sample sees of some pixels, their edges covered by area.

    **Arguments:** `pixels`: row by row from `left`, `top`. `alive`: which of them count; others
    are 0.
    """
    column, row = _position(pixels, options, left, top)
    size = options.width, options.height
    beam = pixel_beams(scene.camera, column, row, size, options.side)
    return area_color(scene, world, beam, options, alive)


def _position(pixels: Ids, options: Options, left: Array, top: Array) -> tuple[Plane, Plane]:
    """Where samples are, in pixels from the picture's left and top."""
    column, row = pixels % options.width, pixels // options.width
    return left + column.astype(left.dtype), top + row.astype(top.dtype)


def _sample(
    scene: Scene, world: World, options: Options, left: Array, top: Array
) -> tuple[Vec | Picture, Mask]:
    """One sample of each pixel, and in which pixels there may be edges, as `sampled` says.

    **Arguments:** `left`, `top`: where the first one is, in pixels.
    """
    dtype, width, height = scene.dtype, options.width, options.height
    count = options.rows.count
    strips = -(-width * count // STRIP_PIXELS)
    rows = -(-count // strips)
    if world.lists is not None:
        rows = -(-rows // TILE) * TILE

    # the reverse pass traces a strip again rather than keep the temporaries of all of them
    @retrace
    def trace(first_row: Int[Array, ""]) -> tuple[Vec | Picture, Mask]:
        first_row = large(first_row)
        columns, lines = (jnp.arange(n, dtype=dtype) for n in (width, rows))
        lines = top + first_row.astype(dtype) + lines
        ray = pixel_rays(scene.camera, (left + columns)[None, :], lines[:, None], (width, height))
        cone = None
        if options.antialias:
            side = scene.camera.window / height * options.side
            cone = pixel_cones(scene.camera, ray, side)
        color, edge = radiance(scene, world.of_strip(first_row), ray, options, cone=cone)
        if options.antialias:
            return where(edge, zeros(edge.shape, dtype), color), edge
        # interleaved here, the rows go straight into the picture: 9.8 against 11.3 ms
        return _interleaved(color), edge

    first_rows = jnp.arange(0, count, rows, dtype=jnp.int32)
    whole = lambda x: x.reshape(-1, *x.shape[2:])[:count]
    color, edge = jax.tree.map(whole, lax.map(trace, first_rows))
    if not options.antialias:
        return color, edge

    def compose(pixels: Int[Array, " n"], alive: Mask) -> Vec:
        return area_seen(scene, world, options, pixels - width, alive, left, top)

    # with a place for the rows above and below from now on, no copy is made where neighbours are
    # asked for (22 against 33 ms for the nine spheres' picture)
    color = jax.tree.map(options.rows.with_neighbours, color)
    marked = jnp.pad(edge, ((1, 1), (0, 0))).reshape(-1)
    flat = jax.tree.map(jnp.ravel, color)
    flat = add_where(flat, marked, compose, min(EDGE_PIXELS, edge.size), again=True)
    return jax.tree.map(lambda x: x.reshape(-1, width), flat), edge
