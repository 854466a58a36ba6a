"""From a scene to a picture: strips of pixels, samples per pixel, edges."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ._types import Highlight, Mask, Picture
from .camera import pixel_rays
from .edges import pixel_cones
from .layers import layered
from .needs import Needs
from .options import Options, options
from .paths import radiance
from .phases import STRIP_PIXELS
from .scene import Scene
from .varying import pixel_beams
from .vec import Vec, where, zeros
from .world import World, build_world

# Pixels with edges are composed this many at a time, as few as keeps the overhead small.
EDGE_PIXELS = 1 << 10


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
    return _render(scene, options(scene, width, height, highlight, bounces, samples, needs))


@eqx.filter_jit
def _render(scene: Scene, options: Options) -> Picture:
    world = build_world(scene)
    width, height, samples = options.width, options.height, options.samples
    strips = -(-width * height // STRIP_PIXELS)
    rows = -(-height // strips)
    strips = -(-height // rows)
    dtype = scene.dtype
    places = (jnp.arange(samples, dtype=dtype) + 0.5) / samples

    def strip(first_row: Int[Array, ""]) -> Float[Array, "rows width 3"]:
        top = first_row.astype(dtype)

        def sample(total: Array, place: tuple) -> tuple[Array, None]:
            left, above = place[0], top + place[1]
            return total + _sample(scene, world, options, rows, left, above), None

        if samples == 1:
            return _sample(scene, world, options, rows, places[0], top + places[0])
        grid = [g.reshape(-1) for g in jnp.meshgrid(places, places)]
        start = jnp.zeros((rows, width, 3), dtype)
        return lax.scan(sample, start, tuple(grid))[0] * (1 / samples**2)

    if strips == 1:
        return strip(jnp.zeros((), jnp.int32))
    picture = lax.map(strip, jnp.arange(strips, dtype=jnp.int32) * rows)
    return picture.reshape(strips * rows, width, 3)[:height]


def _sample(
    scene: Scene, world: World, options: Options, rows: int, left: Array, top: Array
) -> Float[Array, "rows width 3"]:
    """One sample of each pixel of a strip. **Arguments:** `left`, `top`: where the first one is."""
    dtype, size = scene.dtype, (options.width, options.height)

    # the reverse pass traces a strip again rather than keep the temporaries of all of them
    @jax.checkpoint
    def trace(scene: Scene, world: World) -> tuple[Float[Array, "rows width 3"], Mask]:
        columns = left + jnp.arange(options.width, dtype=dtype)
        lines = top + jnp.arange(rows, dtype=dtype)
        ray = pixel_rays(scene.camera, columns[None, :], lines[:, None], size)
        cone = None
        if options.antialias:
            side = scene.camera.window / (options.height * options.samples)
            cone = pixel_cones(scene.camera, ray, side)
        color, edge = radiance(scene, world, ray, options, cone=cone)
        return _rgb(where(edge, zeros(edge.shape, dtype), color)), edge

    color, edge = trace(scene, world)
    if not options.antialias:
        return color

    def compose(pixels: Int[Array, " n"], alive: Mask) -> Float[Array, "n 3"]:
        column = left + (pixels % options.width).astype(dtype)
        line = top + (pixels // options.width).astype(dtype)
        beam = pixel_beams(scene.camera, column, line, size, 1 / options.samples)
        return _rgb(layered(scene, world, beam, options, alive))

    return _replace(color, edge, compose)


def _rgb(color: Vec) -> Float[Array, "*pixels 3"]:
    return jnp.stack([color.x, color.y, color.z], axis=-1)


def _replace(
    picture: Float[Array, "rows width 3"],
    marked: Mask,
    compose: Callable[[Int[Array, " n"], Mask], Float[Array, "n 3"]],
) -> Float[Array, "rows width 3"]:
    """Adds `compose` of the pixels that are marked, only as many at a time as there are.

    **Arguments:** `compose`: from pixels' numbers, and which of them count, to their colours.
    """
    size = marked.size
    n = min(EDGE_PIXELS, size)
    chunks = -(-size // n)
    flat = marked.reshape(-1)
    rank = jnp.cumsum(flat, dtype=jnp.int32)
    place = jnp.where(flat, rank - 1, chunks * n)
    numbers = jnp.arange(size, dtype=jnp.int32)
    pixels = size + jnp.arange(chunks * n, dtype=jnp.int32)  # those beyond the picture are dropped
    pixels = pixels.at[place].set(numbers, mode="drop", unique_indices=True)

    # the reverse pass composes again rather than keep what only few of the chunks have
    @jax.checkpoint
    def some(pixels: Int[Array, " n"]) -> Float[Array, "n 3"]:
        alive = pixels < size
        black = lambda *_: jnp.zeros((n, 3), picture.dtype)
        return lax.cond(alive[0], compose, black, jnp.where(alive, pixels, 0), alive)

    colors = lax.map(some, pixels.reshape(chunks, n)).reshape(-1, 3)
    # a scatter, whose transpose is a gather, and not the gather by rank, whose transpose scatters
    added = picture.reshape(-1, 3).at[pixels].add(colors, mode="drop", unique_indices=True)
    return added.reshape(picture.shape)
