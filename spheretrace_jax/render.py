"""From a scene to a picture: strips of pixels, samples per pixel, edges."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from ._types import Highlight, Mask, Picture, Plane
from .camera import pixel_rays
from .edges import pixel_cones
from .layers import layered
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
    return _render(scene, options(scene, width, height, highlight, bounces, samples, needs))


@eqx.filter_jit
def _render(scene: Scene, options: Options) -> Picture:
    world, k = build_world(scene), options.samples
    places = (jnp.arange(k, dtype=scene.dtype) + 0.5) / k
    if k == 1:
        color, edge = _sample(scene, world, options, places[0], places[0])
    else:

        def add(total: tuple[Vec, Mask], place: tuple) -> tuple[tuple[Vec, Mask], None]:
            color, edge = _sample(scene, world, options, *place)
            return (total[0] + color, total[1] | edge), None

        grid = tuple(g.reshape(-1) for g in jnp.meshgrid(places, places))
        size = (options.height, options.width)
        start = zeros(size, scene.dtype), jnp.full(size, False)
        (color, edge), _ = lax.scan(add, start, grid)
        color = color * (1 / k**2)
    if options.antialias:
        color = jax.tree.map(lambda f: f + _bend(f, edge) * (1 / (24 * k**2)), color)
    return jnp.stack([color.x, color.y, color.z], axis=-1)


def _bend(f: Plane, edge: Mask) -> Plane:
    """f_xx + f_yy, from differences of neighbours; 0 where an edge may be in between.

    The mean of a smooth f over a pixel is f + (f_xx + f_yy)/24: without that what is bright and
    small, as highlights are, is too bright at its centre.
    """
    wide, cut = jnp.pad(f, 1), jnp.pad(edge, 1, constant_values=True)

    def along(one: tuple, other: tuple) -> Plane:
        return jnp.where(edge | cut[one] | cut[other], 0, wide[one] + wide[other] - 2 * f)

    left, right = jnp.s_[1:-1, :-2], jnp.s_[1:-1, 2:]
    above, below = jnp.s_[:-2, 1:-1], jnp.s_[2:, 1:-1]
    return along(left, right) + along(above, below)


def _sample(
    scene: Scene, world: World, options: Options, left: Array, top: Array
) -> tuple[Vec, Mask]:
    """One sample of each pixel, and in which pixels there may be edges.

    **Arguments:** `left`, `top`: where the first one is, in pixels.
    """
    dtype, width, height = scene.dtype, options.width, options.height
    strips = -(-width * height // STRIP_PIXELS)
    rows = -(-height // strips)

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
        return radiance(scene, world, ray, options, cone=cone)

    first_rows = jnp.arange(0, height, rows, dtype=jnp.int32)
    whole = lambda x: x.reshape(-1, width)[:height]
    color, edge = jax.tree.map(whole, lax.map(trace, first_rows))
    if not options.antialias:
        return color, edge

    # nor what few of the chunks have
    @jax.checkpoint
    def compose(pixels: Int[Array, " n"], alive: Mask) -> Vec:
        column = left + (pixels % width).astype(dtype)
        line = top + (pixels // width).astype(dtype)
        beam = pixel_beams(scene.camera, column, line, (width, height), 1 / options.samples)
        return layered(scene, world, beam, options, alive)

    flat = jax.tree.map(jnp.ravel, color)
    flat = fill(flat, edge.reshape(-1), compose, min(EDGE_PIXELS, edge.size), GROUP)
    return jax.tree.map(lambda x: x.reshape(edge.shape), flat), edge
