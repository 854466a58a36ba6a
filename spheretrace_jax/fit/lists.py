"""Pixels sorted by what they show, so that those with the same columns are looked at together."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from .._types import Ids, Index, Mask
from ..options import Options
from ..phases import STRIP_PIXELS
from ..render import rays_through, sample_places
from ..scene import Scene
from ..visibility import nearest
from ..world import build_world
from .layout import Layout

#: The lists after those of the objects and of the background that moves (`Layout.each`): pixels
#: that show several objects, and those with edges.
SEVERAL, EDGE = 0, 1

#: The most pixels of a list that are looked at at once.
MOST = 1 << 12


class Lists(eqx.Module):
    """Lists of pixels, one after the other."""

    order: Int[Array, " padded"]  #: those first that nothing free moves; then `MOST` zeros
    ends: Int[Array, " lists"]  #: where each list ends, the first one that of those

    def bounds(self, label: Index) -> tuple[Int[Array, ""], Int[Array, ""]]:
        """Where a list begins and ends."""
        return self.ends[label], self.ends[label + 1]


def sorted_pixels(scene: Scene, layout: Layout, options: Options, edge: Mask | None) -> Lists:
    """Which pixels show which object, several, or edges; without derivatives.

    A list for each object, for the background if it moves, for pixels that show several objects
    and for those with edges. **Arguments:** `edge`: where there may be edges.
    """
    label = _labels(scene, layout, options)
    if edge is not None:
        label = jnp.where(edge.reshape(-1), len(layout.each) + EDGE, label)
    order = jnp.argsort(label, stable=True).astype(jnp.int32)
    numbers = jnp.arange(-1, len(layout.each) + 2, dtype=label.dtype)
    ends = jnp.searchsorted(label[order], numbers, side="right").astype(jnp.int32)
    return Lists(jnp.pad(order, (0, MOST)), ends)


def _labels(scene: Scene, layout: Layout, options: Options) -> Int[Array, " pixels"]:
    """The number of each pixel's list; -1 for a background that no free parameter moves."""
    world = jax.lax.stop_gradient(build_world(scene))
    objects = world.spheres + world.planes
    ends = jnp.full(objects + 1, True)
    if options.bounces and options.needs.dark_paths:
        ends = jnp.arange(objects + 1) >= objects
    elif options.bounces:
        ends = jnp.append((world.materials.kgr == 0) & (world.materials.kt == 0), True)
    sky = objects if layout.camera and scene.sky is not None else -1
    places = sample_places(scene, options)

    def label(pixels: Ids) -> Ids:
        def sample(place: tuple) -> Ids:
            ray = rays_through(scene, options, pixels, *place)
            return nearest(world, ray, options.needs).id.astype(jnp.int32)

        first = sample(jax.tree.map(lambda p: p[0], places))
        same = jnp.full(first.shape, True)
        if options.samples > 1:
            add = lambda same, place: (same & (sample(place) == first), None)
            same, _ = lax.scan(add, same, jax.tree.map(lambda p: p[1:], places))
        alone = jnp.where(first >= 0, first, sky)
        return jnp.where(same & ends[first], alone, len(layout.each) + SEVERAL)

    size = options.width * options.height
    strips = -(-size // STRIP_PIXELS)
    strip = -(-size // strips)
    pixels = jnp.arange(strips * strip, dtype=jnp.int32).reshape(strips, strip)
    return lax.map(label, pixels).reshape(-1)[:size]
