"""`Accelerator`: the acceleration structures of a picture, for scenes of very many spheres.

The structures know no shapes, only bounding spheres. They are built once per picture, without
derivatives. Without an accelerator every ray tests every sphere.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Int

from ..base.types import Ids, PixelArray
from ..base.vec import Vec, components
from ..scene.light import Light, make_light
from ..scene.lights import Lights
from ..scene.scene import Scene
from ..scene.settings import RenderSettings
from .binning import Cluster, build_bins, cluster
from .light_buffer import LightBuffer, LightProjection, light_projection
from .screen_tiles import ScreenTiles, screen_bounds, tile_count
from .sphere_blocks import SphereBlocks, build_blocks
from .uniform_grid import UniformGrid, grid_bounds, max_grid_cells

# Number of spheres up to which every ray tests all of them. The structures are faster from 60 on
# (512 x 512, one light: 60 spheres 20 against 32 ms, 125 15 against 89), but take longer to
# compile.
MAX_BRUTE_FORCE = 100

# How far from its ray a pixel with edges reaches at most, in pixels, with room for rounding errors.
EDGE_REACH = 1.01

# Number of objects that scenes with an accelerator stay below. Ids have to be exact in float32:
# `closest_hit` packs them with distances into complex numbers.
ID_LIMIT = 1 << 24


class Accelerator(eqx.Module):
    """The acceleration structures for each kind of ray."""

    screen_tiles: ScreenTiles  #: for rays from the eye
    #: for shadow rays: the buffers of lights at points, and of directional ones
    light_buffers: "tuple[LightBuffers | None, LightBuffers | None] | None"
    uniform_grid: UniformGrid | None  #: for any rays
    sphere_blocks: SphereBlocks | None  #: for the cones of pixels with edges

    def from_row(self, first_row: Int[Array, ""]) -> "Accelerator":
        """Returns the accelerator for a strip of pixel rows.

        **Arguments:** `first_row`: of the strip, a multiple of `TILE`.
        """
        return eqx.tree_at(lambda a: a.screen_tiles, self, self.screen_tiles.from_row(first_row))

    def of_pixels(self, column: Ids, row: Ids) -> "Accelerator":
        """Returns the accelerator for some pixels."""
        return eqx.tree_at(lambda a: a.screen_tiles, self, self.screen_tiles.of_pixels(column, row))

    def light_buffer(self, light: Light) -> LightBuffer:
        """Finds the light buffer of one of the scene's lights."""
        assert self.light_buffers is not None
        buffers = self.light_buffers[light.directional]
        assert buffers is not None
        return buffers.of(light)


class LightBuffers(eqx.Module):
    """The light buffers of all lights of one kind, stacked."""

    places: Vec  #: the lights', by which they are found
    buffers: LightBuffer

    def of(self, light: Light) -> LightBuffer:
        """Returns the light buffer of one of the lights."""
        same = [a == b for a, b in zip(*map(components, (self.places, light.place)), strict=True)]
        index = jnp.argmax(same[0] & same[1] & same[2])
        return jax.tree.map(lambda x: x[index], self.buffers)


def build_accelerator(
    center: Vec, radius: PixelArray, scene: Scene, settings: RenderSettings
) -> Accelerator | None:
    """Builds the acceleration structures that a picture needs; None for few spheres.

    **Arguments:** `center`, `radius`: the shapes' bounding spheres, each of shape `(n,)`.
    `scene`: its camera and lights.
    """
    spheres = radius.shape[0]
    if not MAX_BRUTE_FORCE < spheres < ID_LIMIT - scene.objects:
        return None
    center, radius, scene = lax.stop_gradient((center, radius, scene))
    size, rows = (settings.width, settings.height), settings.rows
    stack = lambda grid: jax.tree.map(lambda x: x[None], grid)
    pixel = EDGE_REACH * settings.side if settings.antialias else 0.0
    bounds = [stack(screen_bounds(center, radius, scene.camera, size, rows, pixel))]
    max_cells = tile_count((size[0], rows.count))
    group, projected, grid = cluster(center, radius), {}, None
    if settings.needs.shadows:
        for directional in sorted(set(scene.lights.directional)):
            places, projections = _projections(scene.lights, directional, spheres, group)
            bounds.append(lax.map(lambda one: one.bounds(center, radius), projections))
            max_cells = max(max_cells, projections.cells**2)
            projected[directional] = places, projections
    if settings.bounces:
        corner, side, boxes = grid_bounds(center, radius, group)
        grid = corner, side
        bounds.append(stack(boxes))
        max_cells = max(max_cells, max_grid_cells(spheres))
    bounds = jax.tree.map(lambda *x: jnp.concatenate(x), *bounds)
    bins = build_bins(center, radius, bounds, max_cells)
    bins_of = lambda index: jax.tree.map(lambda x: x[index], bins)
    buffers, first = {}, 1
    for directional, (places, projections) in projected.items():
        last = first + len(scene.lights.numbers(directional))
        buffers[directional] = LightBuffers(
            places, LightBuffer(projections, bins_of(slice(first, last)))
        )
        first = last
    return Accelerator(
        ScreenTiles(bins_of(0)),
        (buffers.get(False), buffers.get(True)) if buffers else None,
        None if grid is None else UniformGrid(*grid, bins_of(-1)),
        build_blocks(center, radius, group) if settings.antialias else None,
    )


def _projections(
    lights: Lights, directional: bool, spheres: int, group: Cluster
) -> tuple[Vec, LightProjection]:
    """Returns the places of all lights of one kind and their projections, stacked.

    **Arguments:** `spheres`: the number of spheres. `group`: the region of most of them.
    """
    numbers = lights.numbers(directional)
    positions = lights.position
    if len(numbers) < len(lights):
        positions = positions[np.asarray(numbers, np.int32)]

    def of_row(position: Array) -> tuple[Vec, LightProjection]:
        light = make_light(position, None, directional)
        return light.place, light_projection(light, spheres, group)

    return lax.map(of_row, positions)
