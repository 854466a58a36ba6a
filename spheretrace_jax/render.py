"""From a scene to a picture: strips of pixels, samples per pixel, edges."""

from collections.abc import Callable
from functools import partial

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
from .phases import STRIP_PIXELS, nth_marked
from .scene import Scene
from .varying import pixel_beams
from .vec import Vec, where, zeros
from .world import World, build_world

# Pixels with edges are composed this many at a time, as few as keeps the overhead small.
EDGE_PIXELS, GROUP = 1 << 10, 8


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
    world, k = build_world(scene), options.samples
    places = (jnp.arange(k, dtype=scene.dtype) + 0.5) / k
    if k == 1:
        return _sample(scene, world, options, places[0], places[0])

    def add(total: Picture, place: tuple) -> tuple[Picture, None]:
        return total + _sample(scene, world, options, *place), None

    grid = [g.reshape(-1) for g in jnp.meshgrid(places, places)]
    start = jnp.zeros((options.height, options.width, 3), scene.dtype)
    return lax.scan(add, start, tuple(grid))[0] * (1 / k**2)


def _sample(scene: Scene, world: World, options: Options, left: Array, top: Array) -> Picture:
    """One sample of each pixel. **Arguments:** `left`, `top`: where the first one is, in pixels."""
    strips = -(-options.width * options.height // STRIP_PIXELS)
    rows = -(-options.height // strips)
    first_rows = jnp.arange(0, options.height, rows, dtype=jnp.int32)
    strip = lambda row: _strip(scene, world, options, rows, left, top + row.astype(top.dtype))
    picture = lax.map(strip, first_rows)
    return picture.reshape(-1, options.width, 3)[: options.height]


def _strip(
    scene: Scene, world: World, options: Options, rows: int, left: Array, top: Array
) -> Float[Array, "rows width 3"]:
    """One sample of each pixel of a strip, as in `_sample`."""
    dtype, width, height = scene.dtype, options.width, options.height

    # the reverse pass traces a strip again rather than keep the temporaries of all of them
    @jax.checkpoint
    def trace(scene: Scene, world: World) -> tuple[Float[Array, "rows width 3"], Mask]:
        columns, lines = (jnp.arange(n, dtype=dtype) for n in (width, rows))
        columns, lines = (left + columns)[None, :], (top + lines)[:, None]
        ray = pixel_rays(scene.camera, columns, lines, (width, height))
        cone = None
        if options.antialias:
            side = scene.camera.window / (height * options.samples)
            cone = pixel_cones(scene.camera, ray, side)
        color, edge = radiance(scene, world, ray, options, cone=cone)
        return _rgb(where(edge, zeros(edge.shape, dtype), color)), edge

    color, edge = trace(scene, world)
    if not options.antialias:
        return color

    def compose(pixels: Int[Array, " n"], alive: Mask) -> Float[Array, "n 3"]:
        column = left + (pixels % width).astype(dtype)
        line = top + (pixels // width).astype(dtype)
        beam = pixel_beams(scene.camera, column, line, (width, height), 1 / options.samples)
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
    groups = -(-chunks // GROUP)
    total, place = nth_marked(marked.reshape(-1))
    numbers = jnp.arange(groups * GROUP * n, dtype=jnp.int32).reshape(groups, GROUP, n)

    # the reverse pass composes again rather than keep what only few of the chunks have
    @jax.checkpoint
    def some(number: Int[Array, " n"]) -> tuple[Int[Array, " n"], Float[Array, "n 3"]]:
        alive = number < total
        pixels = place(number)
        return jnp.where(alive, pixels, size), compose(jnp.where(alive, pixels, 0), alive)

    def if_any(work: Callable, numbers: Int[Array, "..."]) -> tuple[Array, Array]:
        black = jnp.zeros((*numbers.shape, 3), picture.dtype)
        none = lambda numbers: (jnp.full_like(numbers, size), black)
        return lax.cond(numbers.reshape(-1)[0] < total, work, none, numbers)

    # in groups, as to find out of each chunk that it is empty takes longer than to fill the others
    group = partial(lax.map, partial(if_any, some))
    pixels, colors = lax.map(partial(if_any, group), numbers)

    def add(used: int) -> Float[Array, "size 3"]:
        at, what = pixels[:used].reshape(-1), colors[:used].reshape(-1, 3)
        return picture.reshape(-1, 3).at[at].add(what, mode="drop", unique_indices=True)

    # a scatter takes 10 ns also for what it drops, so that it is given few groups, if few are used
    few = total <= GROUP * n
    return lax.cond(few, partial(add, 1), partial(add, groups)).reshape(picture.shape)
