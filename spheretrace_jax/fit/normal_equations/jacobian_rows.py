"""What pixels see and the rows of the picture's Jacobian, a few at a time, from its own code.

Each pixel is given tables of its own (`world.Own`) and lights of its own, by which the reverse pass
differentiates, once per channel. The camera, on which every pixel depends through few numbers, is
differentiated forwards.
"""

from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.vec import Vec
from ...scene.scene import Scene
from ...tracing.tables import PixelTables, SceneTables, build_tables
from ..model.parameters import CAMERA, LIGHTS, SPHERES
from .parameter_index import ParameterIndex

Rows = Float[Array, "columns 3 pixels"]

ColorAndRows = tuple[Float[Array, "3 pixels"], Callable[[Float[Array, "3 pixels"]], Rows]]
"""What some pixels see, and from slopes the rows of its Jacobian times these."""

#: Where the spheres' parameters are in the tables that pixels have of their own.
TABLE_COLUMNS = {
    "color": lambda own: own.materials.color,
    "ka": lambda own: own.materials.ka,
    "kd": lambda own: own.materials.kd,
    "ks": lambda own: own.materials.ks,
    "exponent": lambda own: own.materials.exponent,
    "kgr": lambda own: own.materials.kgr,
    "kt": lambda own: own.materials.kt,
    "center": lambda own: own.balls.center,
    "radius": lambda own: own.balls.radius,
}
assert set(TABLE_COLUMNS) == set(SPHERES)


def color_and_rows(
    see: Callable[[Scene, SceneTables], Vec],
    scene: Scene,
    world: SceneTables,
    own: PixelTables,
    layout: ParameterIndex,
    count: int,
) -> ColorAndRows:
    """What some pixels see, and a function to its derivatives by what is free.

    **Arguments:** `see`: from a scene to the colours, planes of shape `(pixels,)`. `own`: the
    objects that pixels may show, of shape `(objects,)`. `count`: how many pixels.

    **Returns:** the colours, and a function from a slope for each channel to the derivatives times
    that: columns for the spheres' parameters, in the layout's order of names, row by row of `own`,
    then those of the lights and the camera.
    """
    spread = lambda x: jnp.broadcast_to(x[..., None], (*x.shape, count))
    own = jax.tree.map(spread, own)
    at_own = lambda own: [TABLE_COLUMNS[name](own) for name in layout.spheres]
    at_lights = lambda scene: [LIGHTS[name](scene) for name in layout.lights]

    def reverse(columns: list, lights: list) -> Vec:
        scene_, world_ = scene, world
        if columns:
            own_ = eqx.tree_at(at_own, own, columns)
            world_ = world.with_own(own_)
        if lights:
            scene_ = eqx.tree_at(at_lights, scene, lights)
        return see(scene_, world_)

    lights = [spread(light) for light in at_lights(scene)]
    color, pull = jax.vjp(reverse, at_own(own), lights)

    def rows(slope: Float[Array, "3 pixels"]) -> Rows:
        seeds = [jnp.zeros_like(slope).at[c].set(slope[c]) for c in range(3)]
        # one channel after the other where much is kept, all at once where little is: the other
        # way they take half as long again in both cases
        each = jax.vmap(pull) if own.balls.radius.shape[0] == 1 else partial(jax.lax.map, pull)
        columns, lights = each(Vec(*seeds))
        columns, lights = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -2), (columns, lights))
        # of colours and centres the three parts side by side; planes have no free parameters
        parts = [jnp.stack(jax.tree.leaves(c), axis=1)[: len(scene.spheres)] for c in columns]
        parts = [part.reshape(-1, 3, count) for part in (*parts, *lights)]
        if layout.camera:
            parts.append(_by_camera(see, scene, layout) * slope[None])
        return jnp.concatenate([jnp.zeros((0, *slope.shape), slope.dtype), *parts])

    return jnp.stack([color.x, color.y, color.z]), rows


def _by_camera(
    see: Callable[[Scene, SceneTables], Vec], scene: Scene, layout: ParameterIndex
) -> Rows:
    """The derivatives by what is free of the camera."""
    at_camera = lambda scene: [CAMERA[name](scene) for name in layout.camera]

    def forward(values: list) -> Vec:
        scene_ = eqx.tree_at(at_camera, scene, values)
        return see(scene_, build_tables(scene_))

    _, push = jax.linearize(forward, at_camera(scene))
    moved = jax.vmap(push)(list(jnp.eye(len(layout.camera), dtype=scene.dtype)))
    return jnp.stack([moved.x, moved.y, moved.z], axis=1)
