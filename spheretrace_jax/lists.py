"""`Lists`: where to look for the spheres that a ray may meet, where there are very many of them.

Made once for a picture, without derivatives. Without lists, every ray looks at every sphere.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .charts import Lamp, View, lamp, view
from .grid import Grid, grid
from .needs import Needs
from .scene import Scene
from .vec import Vec, vec

# Of at most so many spheres each ray looks at all.
FEW = 128

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


def lists(scene: Scene, size: tuple[int, int], needs: Needs, bounces: int) -> Lists | None:
    """The lists of a picture of `size` (width, height) in pixels, None if its spheres are few."""
    if not FEW < len(scene.spheres) < MOST - scene.objects:
        return None
    scene = lax.stop_gradient(scene)
    center, radius = Vec(*scene.spheres.center.T), scene.spheres.radius
    lamps = None
    if needs.shadows:
        lamps = lax.map(lambda light: lamp(center, radius, vec(light)), scene.lights.position)
    from_anywhere = grid(center, radius) if bounces else None
    from_eye = view(center, radius, scene.camera, size)
    return Lists(from_eye, scene.lights.position, lamps, from_anywhere)
