"""`Lists`: where to look for the spheres that a ray may meet, where there are very many of them.

Made once for a picture, without derivatives. Without lists, every ray looks at every sphere.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..base.vec import Vec, vec
from ..scene.needs import Needs
from ..scene.scene import Scene
from ..xla.sharding import Rows
from .binning import build_bins, cluster
from .light_buffer import LightBuffer, light_projection
from .screen_tiles import ScreenTiles, screen_bounds, tiles_in
from .uniform_grid import UniformGrid, grid_bounds, most_boxes

# Of at most so many spheres each ray looks at all. The lists are faster from 60 on (512 x 512, one
# light: 60 spheres 20 against 32 ms, 125 15 against 89), but take longer to compile.
FEW = 100

# The numbers of objects have to be exact in float32, beside a distance in the same complex number.
MOST = 1 << 24


class Accelerator(eqx.Module):
    """What spheres there are along the rays of a picture."""

    screen_tiles: ScreenTiles  #: along those from the eye
    lights: Float[Array, "m 3"]
    light_buffers: LightBuffer | None  #: along those to each of the lights
    uniform_grid: UniformGrid | None  #: along any

    def of_strip(self, first_row: Int[Array, ""]) -> "Accelerator":
        """The lists for the rays of full rows of pixels from one on, a multiple of `TILE`."""
        return eqx.tree_at(lambda s: s.screen_tiles, self, self.screen_tiles.of_strip(first_row))

    def light_buffer(self, light: Vec) -> tuple[Bool[Array, ""], LightBuffer]:
        """Whether there are lists for a light at some place, and these."""
        here = jnp.all(self.lights == jnp.stack([light.x, light.y, light.z])[None], axis=1)
        which = jnp.argmax(here)
        return here[which], jax.tree.map(lambda x: x[which], self.light_buffers)


def build_accelerator(
    scene: Scene, size: tuple[int, int], needs: Needs, bounces: int, rows: Rows | None = None
) -> Accelerator | None:
    """The lists of some rows of a picture, None if its spheres are few.

    **Arguments:** `size`: the picture's (width, height) in pixels. `rows`: all by default.
    """
    if not FEW < len(scene.spheres) < MOST - scene.objects:
        return None
    scene = lax.stop_gradient(scene)
    center, radius, lights = Vec(*scene.spheres.center.T), scene.spheres.radius, scene.lights
    stack = lambda layout: jax.tree.map(lambda x: x[None], layout)
    rows = Rows(size[1]) if rows is None else rows
    layouts = [stack(screen_bounds(center, radius, scene.camera, size, rows))]
    most = tiles_in((size[0], rows.count))
    group, charts, place = cluster(center, radius), None, None
    if needs.shadows:
        charts = lax.map(
            lambda light: light_projection(vec(light), len(radius), group), lights.position
        )
        layouts.append(lax.map(lambda chart: chart.layout(center, radius), charts))
        most = max(most, charts.cells**2)
    if bounces:
        corner, side, layout = grid_bounds(center, radius, group)
        place = corner, side
        layouts.append(stack(layout))
        most = max(most, most_boxes(len(scene.spheres)))
    layouts = jax.tree.map(lambda *x: jnp.concatenate(x), *layouts)
    cells = build_bins(center, radius, layouts, most)
    some = lambda which: jax.tree.map(lambda x: x[which], cells)
    return Accelerator(
        ScreenTiles(some(0)),
        lights.position,
        None if charts is None else LightBuffer(charts, some(slice(1, 1 + len(lights)))),
        None if place is None else UniformGrid(*place, some(-1)),
    )
