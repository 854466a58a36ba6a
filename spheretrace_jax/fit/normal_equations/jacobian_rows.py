"""Rows of a picture's Jacobian, a few pixels at a time, from the picture's own code.

Each pixel is given tables of its own (`tables.PixelTables`) and lights of its own, by which the
reverse pass differentiates, once per channel. The camera, on which every pixel depends through few
numbers, is differentiated forwards.
"""

from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from ...base.vec import SplitVec, Vec
from ...tracing.context import TraceContext
from ...tracing.tables import PixelTables
from ..model.accessors import CAMERA, SPHERES, array_name, distinct
from .parameter_index import ParameterIndex

Rows = Float[Array, "columns 3 pixels"]

ColorAndRows = tuple[Float[Array, "3 pixels"], Callable[[Float[Array, "3 pixels"]], Rows]]
"""The colours of some pixels, and a function from slopes to the rows of J times these slopes."""

See = Callable[[TraceContext], Vec]
"""From a context to the colours of some pixels, each channel of shape `(pixels,)`."""


def table_column(name: str) -> Callable[[PixelTables], Array | Vec]:
    """Returns the accessor of a sphere's parameter in tables of a pixel's own."""
    if name in ("center", "radius"):
        return lambda tables: getattr(tables.spheres, name)
    return lambda tables: getattr(tables.materials, name)


#: The accessors of all parameters that spheres have.
TABLE_COLUMNS = {name: table_column(name) for name in SPHERES}


def color_and_rows(
    see: See, context: TraceContext, tables: PixelTables, index: ParameterIndex, count: int
) -> ColorAndRows:
    """Returns the colours of some pixels, and a function to their derivatives by what is free.

    **Arguments:** `tables`: the objects that pixels may show, of shape `(objects,)`. `count`: the
    number of pixels.

    **Returns:** the colours, and a function from a slope for each channel to the derivatives times
    that slope: columns for the spheres' parameters, in the index's order of names, row by row of
    `tables`, then those of the lights and the camera.
    """
    spread = lambda x: jnp.broadcast_to(x[..., None], (*x.shape, count))
    tables = jax.tree.map(spread, tables)
    at_columns = lambda tables: [TABLE_COLUMNS[name](tables) for name in index.spheres]
    arrays = distinct(index.lights)
    at_lights = lambda scene: [accessor(scene) for accessor in arrays.values()]

    def reverse(columns: list, lights: list) -> Vec:
        moved = context
        if columns:
            moved = moved.with_pixel_tables(eqx.tree_at(at_columns, tables, columns))
        if lights:
            scene = eqx.tree_at(at_lights, context.scene, lights)
            moved = moved.with_lights(scene.lights)
        return see(moved)

    lights = [spread(light) for light in at_lights(context.scene)]
    color, pull = jax.vjp(reverse, at_columns(tables), lights)

    def rows(slope: Float[Array, "3 pixels"]) -> Rows:
        seeds = [jnp.zeros_like(slope).at[c].set(slope[c]) for c in range(3)]
        # one channel after the other where much is kept, all at once where little is: the other
        # way they take half as long again in both cases
        one_object = tables.spheres.radius.shape[0] == 1
        each = jax.vmap(pull) if one_object else partial(jax.lax.map, pull)
        columns, lights = each(SplitVec(*seeds))
        columns, lights = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -2), (columns, lights))
        # of colours and centres the three parts side by side; planes have no free parameters
        n = len(context.scene.spheres)
        parts = [jnp.stack(jax.tree.leaves(c), axis=1)[:n] for c in columns]
        # both names of lights' places stand for one array
        of_array = dict(zip(map(array_name, arrays), lights, strict=True))
        parts += [of_array[array_name(name)] for name in index.lights]
        parts = [part.reshape(-1, 3, count) for part in parts]
        if index.camera:
            parts.append(_by_camera(see, context, index) * slope[None])
        return jnp.concatenate([jnp.zeros((0, *slope.shape), slope.dtype), *parts])

    return jnp.stack([color.x, color.y, color.z]), rows


def _by_camera(see: See, context: TraceContext, index: ParameterIndex) -> Rows:
    """Returns the derivatives by what is free of the camera."""
    scene = context.scene
    at_camera = lambda scene: [CAMERA[name](scene) for name in index.camera]

    def forward(values: list) -> Vec:
        return see(context.of_scene(eqx.tree_at(at_camera, scene, values)))

    _, push = jax.linearize(forward, at_camera(scene))
    flat, unflatten = ravel_pytree(at_camera(scene))
    moved = jax.vmap(lambda unit: push(unflatten(unit)))(jnp.eye(flat.size, dtype=scene.dtype))
    return jnp.stack([moved.x, moved.y, moved.z], axis=1)
