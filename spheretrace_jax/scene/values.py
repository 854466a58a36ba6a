"""Values: a scene's arrays by the names of its parameters, and a scene with other ones."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..base.errors import InputError
from .arrays import converted, is_array
from .parameters import FITTED, LIGHT_PLACES, rows_of, with_optional
from .scene import Scene, check_scene


def values(scene: Scene, names: str | Iterable[str]) -> dict[str, Float[Array, "..."]]:
    """Returns the arrays of a scene by the names of its parameters, as `fit(free=...)` has them.

    A pytree for optimisers: `replace` is the way back. Works under `jit`, `grad` and `vmap`.

    **Arguments:** `names`: one name or several, such as `("color", "light_position")`. Optional
    numbers of the camera that are unset are at their defaults.

    **Returns:** the arrays by their names: shapes `(spheres, 3)`, `(spheres,)`, `(lights, 3)` or,
    of the camera, `()`, in the scene's units.

    **Raises:** `InputError` for names of no parameter.
    """
    chosen = [names] if isinstance(names, str) else list(names)
    scene = with_optional(check_scene(scene), _checked(chosen))
    return {name: FITTED[name].value(scene) for name in chosen}


def replace(scene: Scene, values: Mapping[str, ArrayLike | Sequence]) -> Scene:
    """Returns a scene with other arrays for some of its parameters.

    Works under `jit`, `grad` and `vmap`. Of the positions of lights, `"light_position"` replaces
    those of lights at points, `"light_direction"` those of directional lights.

    **Arguments:** `values`: arrays by the names that `values` takes, or what NumPy broadcasts to
    their shapes: a number for all spheres, a colour for all. They take the dtype of the scene.

    **Raises:** `InputError` for names of no parameter, and for arrays of other shapes.
    """
    scene = with_optional(check_scene(scene), _checked(values))
    arrays = {name: _like(name, x, FITTED[name].value(scene)) for name, x in values.items()}
    return check_scene(with_values(scene, arrays))


def with_values(scene: Scene, values: Mapping[str, Array]) -> Scene:
    """Returns a scene with other values of some parameters; of lights' places only their rows.

    **Arguments:** `values`: arrays of the shapes and the dtype of those that they replace, which is
    not checked.
    """
    for name, x in values.items():
        accessor = FITTED[name].value
        if name in LIGHT_PLACES and not (rows := rows_of(scene, name)).all():
            x = jnp.where(rows[:, None], x, accessor(scene))
        scene = eqx.tree_at(accessor, scene, x)
    return scene


def _like(name: str, value: ArrayLike | Sequence, old: Array) -> Array:
    """Returns a value as an array of an old one's shape and dtype. **Raises:** `InputError`."""
    try:
        array: Any = value if is_array(value) else np.asarray(value)
        fits = np.broadcast_shapes(array.shape, old.shape) == old.shape
    except ValueError:  # rows of different lengths, or shapes that do not go together
        array, fits = None, False
    if not fits:
        got = f"shape {np.shape(value)}" if is_array(value) else repr(value)
        raise InputError(f"{name} must be an array of shape {old.shape}, got {got}")
    if np.dtype(array.dtype).kind not in "fiu":
        raise InputError(f"{name} must be real numbers, got {array.dtype}")
    return jnp.broadcast_to(converted(value, old.dtype), old.shape)


def _checked(names: Iterable[str]) -> list[str]:
    """Returns names of parameters. **Raises:** `InputError` for others."""
    names = list(names)
    unknown = [str(name) for name in names if name not in FITTED]
    if unknown:
        known = ", ".join(FITTED)
        raise InputError(f"unknown parameter {', '.join(unknown)}: expected {known}")
    return names
