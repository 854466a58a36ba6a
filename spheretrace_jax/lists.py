"""`Lists`: where to look for the spheres that a ray may meet, where there are very many of them.

Made once for a picture, without derivatives. Without lists, every ray looks at every sphere.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .cells import cluster, sort_into_cells
from .charts import Lamp, View, chart_of, layout_of_view, tiles_in
from .grid import Grid, layout_of_grid, most_boxes
from .needs import Needs
from .scene import Scene
from .sharding import Rows
from .vec import Vec, vec

# Of at most so many spheres each ray looks at all. The lists are faster from 60 on (512 x 512, one
# light: 60 spheres 20 against 32 ms, 125 15 against 89), but take longer to compile.
FEW = 100

# The numbers of objects have to be exact in float32, beside a distance in the same complex number.
MOST = 1 << 24


class Lists(eqx.Module):
    """What spheres there are along the rays of a picture."""

    view: View  #: along those from the eye
    lights: Float[Array, "m 3"]
    lamps: Lamp | None  #: along those to each of the lights
    grid: Grid | None  #: along any

    def of_strip(self, first_row: Int[Array, ""]) -> "Lists":
        """The lists for the rays of full rows of pixels from one on, a multiple of `TILE`."""
        return eqx.tree_at(lambda s: s.view, self, self.view.of_strip(first_row))

    def lamp(self, light: Vec) -> tuple[Bool[Array, ""], Lamp]:
        """Whether there are lists for a light at some place, and these."""
        here = jnp.all(self.lights == jnp.stack([light.x, light.y, light.z])[None], axis=1)
        which = jnp.argmax(here)
        return here[which], jax.tree.map(lambda x: x[which], self.lamps)


def lists(
    scene: Scene, size: tuple[int, int], needs: Needs, bounces: int, rows: Rows | None = None
) -> Lists | None:
    """The lists of some rows of a picture, None if its spheres are few.

    **Arguments:** `size`: the picture's (width, height) in pixels. `rows`: all by default.
    """
    if not FEW < len(scene.spheres) < MOST - scene.objects:
        return None
    scene = lax.stop_gradient(scene)
    center, radius, lights = Vec(*scene.spheres.center.T), scene.spheres.radius, scene.lights
    stack = lambda layout: jax.tree.map(lambda x: x[None], layout)
    rows = Rows(size[1]) if rows is None else rows
    layouts = [stack(layout_of_view(center, radius, scene.camera, size, rows))]
    most = tiles_in((size[0], rows.count))
    group, charts, place = cluster(center, radius), None, None
    if needs.shadows:
        charts = lax.map(lambda light: chart_of(vec(light), len(radius), group), lights.position)
        layouts.append(lax.map(lambda chart: chart.layout(center, radius), charts))
        most = max(most, charts.cells**2)
    if bounces:
        corner, side, layout = layout_of_grid(center, radius, group)
        place = corner, side
        layouts.append(stack(layout))
        most = max(most, most_boxes(len(scene.spheres)))
    layouts = jax.tree.map(lambda *x: jnp.concatenate(x), *layouts)
    cells = sort_into_cells(center, radius, layouts, most)
    some = lambda which: jax.tree.map(lambda x: x[which], cells)
    return Lists(
        View(some(0)),
        lights.position,
        None if charts is None else Lamp(charts, some(slice(1, 1 + len(lights)))),
        None if place is None else Grid(*place, some(-1)),
    )
