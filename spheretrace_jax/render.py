"""From a scene to a picture: strips of pixels, samples per pixel, edges."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from ._types import Highlight, Ids, Mask, Picture, Plane
from .camera import Ray, pixel_rays
from .charts import TILE
from .edges import pixel_cones
from .layers import layered
from .lists import lists
from .needs import Needs
from .options import Options, options
from .paths import radiance
from .phases import STRIP_PIXELS, fill
from .scene import Scene
from .varying import pixel_beams
from .vec import Vec, zeros
from .world import World, build_world

# Pixels with edges are composed this many at a time, as few as keeps the overhead small.
EDGE_PIXELS, GROUP = 1 << 11, 4


def render(
    scene: Scene,
    *,
    width: int = 512,
    height: int = 512,
    highlight: Highlight = "phong",
    bounces: int = 5,
    samples: int = 1,
    needs: Needs | None = None,
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

    **Returns:** linear RGB of shape `(height, width, 3)`, unclamped, in the scene's dtype. Row 0
    is the top.

    **Raises:** `InputError` for sizes, samples or bounces out of range and unknown highlights.
    """
    return draw(scene, options(scene, width, height, highlight, bounces, samples, needs))


@eqx.filter_jit
def draw(scene: Scene, options: Options) -> Picture:
    """`render` with its static arguments already checked."""
    return averaged(*sampled(scene, options), options)


def sampled(scene: Scene, options: Options) -> tuple[Vec, Mask]:
    """The mean of each pixel's samples, and in which pixels there may be edges."""
    size = options.width, options.height
    world = build_world(scene).listed(lists(scene, size, options.needs, options.bounces))
    k = options.samples
    places = sample_places(scene, options)
    if k == 1:
        return _sample(scene, world, options, places[0][0], places[1][0])

    def add(total: tuple[Vec, Mask], place: tuple) -> tuple[tuple[Vec, Mask], None]:
        color, edge = _sample(scene, world, options, *place)
        return (total[0] + color, total[1] | edge), None

    size = (options.height, options.width)
    start = zeros(size, scene.dtype), jnp.full(size, False)
    (color, edge), _ = lax.scan(add, start, places)
    return color * (1 / k**2), edge


def sample_places(scene: Scene, options: Options) -> tuple[Array, Array]:
    """Where a pixel's k x k samples are: in pixels, from its left and its top."""
    middles = (jnp.arange(options.samples, dtype=scene.dtype) + 0.5) / options.samples
    left, top = jnp.meshgrid(middles, middles)
    return left.reshape(-1), top.reshape(-1)


def averaged(color: Vec, edge: Mask, options: Options) -> Picture:
    """The picture: where pixels are areas, smooth shading is averaged over them, too.

    The mean of a smooth f over a pixel is f + (f_xx + f_yy)/24: without that what is bright and
    small, as highlights are, is too bright at its centre.
    """
    if options.antialias:
        across, down = smooth_beside(edge)
        part = bend_part(options)

        def mean(f: Plane) -> Plane:
            wide = jnp.pad(f, 1)
            bend_x = wide[1:-1, :-2] + wide[1:-1, 2:] - 2 * f
            bend_y = wide[:-2, 1:-1] + wide[2:, 1:-1] - 2 * f
            return f + (jnp.where(across, bend_x, 0) + jnp.where(down, bend_y, 0)) * part

        color = jax.tree.map(mean, color)
    return jnp.stack([color.x, color.y, color.z], axis=-1)


def bend_part(options: Options) -> float:
    """What second differences of neighbours count in a pixel's mean."""
    return 1 / (24 * options.samples**2)


def smooth_beside(edge: Mask) -> tuple[Mask, Mask]:
    """Where there is no edge in a pixel nor left and right of it, and not above and below."""
    cut = jnp.pad(edge, 1, constant_values=True)
    across = ~(edge | cut[1:-1, :-2] | cut[1:-1, 2:])
    return across, ~(edge | cut[:-2, 1:-1] | cut[2:, 1:-1])


def point_seen(
    scene: Scene, world: World, options: Options, pixels: Ids, left: Array, top: Array
) -> Vec:
    """What one ray sees of each of some pixels. **Arguments:** `pixels`: row by row from 0."""
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

    **Arguments:** `pixels`: row by row from 0. `alive`: which of them count; others are 0.
    """
    column, row = _position(pixels, options, left, top)
    size = options.width, options.height
    beam = pixel_beams(scene.camera, column, row, size, 1 / options.samples)
    return layered(scene, world, beam, options, alive)


def _position(pixels: Ids, options: Options, left: Array, top: Array) -> tuple[Plane, Plane]:
    """Where samples are, in pixels from the picture's left and top."""
    column, row = pixels % options.width, pixels // options.width
    return left + column.astype(left.dtype), top + row.astype(top.dtype)


def _sample(
    scene: Scene, world: World, options: Options, left: Array, top: Array
) -> tuple[Vec, Mask]:
    """One sample of each pixel, and in which pixels there may be edges.

    **Arguments:** `left`, `top`: where the first one is, in pixels.
    """
    dtype, width, height = scene.dtype, options.width, options.height
    strips = -(-width * height // STRIP_PIXELS)
    rows = -(-height // strips)
    if world.lists is not None:
        rows = -(-rows // TILE) * TILE

    # the reverse pass traces a strip again rather than keep the temporaries of all of them
    @jax.checkpoint
    def trace(first_row: Int[Array, ""]) -> tuple[Vec, Mask]:
        columns, lines = (jnp.arange(n, dtype=dtype) for n in (width, rows))
        lines = top + first_row.astype(dtype) + lines
        ray = pixel_rays(scene.camera, (left + columns)[None, :], lines[:, None], (width, height))
        cone = None
        if options.antialias:
            side = scene.camera.window / (height * options.samples)
            cone = pixel_cones(scene.camera, ray, side)
        return radiance(scene, world.of_strip(first_row), ray, options, cone=cone)

    first_rows = jnp.arange(0, height, rows, dtype=jnp.int32)
    whole = lambda x: x.reshape(-1, width)[:height]
    color, edge = jax.tree.map(whole, lax.map(trace, first_rows))
    if not options.antialias:
        return color, edge

    # nor what few of the chunks have
    @jax.checkpoint
    def compose(pixels: Int[Array, " n"], alive: Mask) -> Vec:
        return area_seen(scene, world, options, pixels, alive, left, top)

    flat = jax.tree.map(jnp.ravel, color)
    flat = fill(flat, edge.reshape(-1), compose, min(EDGE_PIXELS, edge.size), GROUP)
    return jax.tree.map(lambda x: x.reshape(edge.shape), flat), edge
