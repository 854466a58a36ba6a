"""Arrays of a scene: their dtype, and one row for each object from a number that holds for all."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..base.errors import InputError

P = ParamSpec("P")
T = TypeVar("T")

#: The coefficients of the lecture's shading that spheres and planes have, in the scene's order.
COEFFICIENTS = ("ka", "kd", "ks", "exponent", "kgr")


def precision(dtype: Any) -> np.dtype:
    """Returns a scene's dtype. **Raises:** `InputError` for all but float32 and float64."""
    if np.dtype(dtype) not in (np.float32, np.float64):
        raise InputError(f"a scene's dtype must be float32 or float64, got {np.dtype(dtype)}")
    return np.dtype(dtype)


def floats(*values: Any) -> list[Array]:
    """Returns the values as arrays of one floating dtype.

    Python numbers, lists and arrays of whole numbers take the dtype of the floating arrays among
    the values. Without floating arrays, all values take JAX's default dtype.

    **Raises:** `InputError` for arrays of other dtypes.
    """
    typed = {v.dtype for v in values if isinstance(v, jax.Array | np.ndarray)}
    typed = {precision(t) for t in typed if not jnp.issubdtype(t, jnp.integer)}
    dtype = jax.dtypes.canonicalize_dtype(np.result_type(*typed) if typed else float)
    return [converted(v, dtype) for v in values]


def is_traced(tree: Any) -> bool:
    """Tells whether numbers of a pytree are not known yet, as under jit, grad and vmap."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def at_once(function: Callable[P, T]) -> Callable[P, T]:
    """Evaluates a function of known numbers now, also under a trace; of traced ones as always.

    Inside a compiled function all arrays that JAX makes are traced, of known numbers too: a scene
    built there would need everything, since none of its numbers could be looked at.
    """

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        with nullcontext() if is_traced((args, kwargs)) else jax.ensure_compile_time_eval():
            return function(*args, **kwargs)

    return call


@at_once
def converted(value: Any, dtype: Any) -> Array:
    """Returns a number, a list or an array as an array of a dtype."""
    return jnp.asarray(value, dtype)


@at_once
def vectors(rows: Array) -> Array:
    """Returns rows of three numbers; an empty array of any shape becomes `(0, 3)`."""
    return rows.reshape(-1, 3) if rows.size == 0 else rows


@at_once
def color_rows(color: Array, rows: int) -> Array:
    """Returns one colour for each row: a single colour holds for all rows."""
    return jnp.broadcast_to(color, (rows, 3)) if color.ndim == 1 else color


@at_once
def number_rows(number: Array, rows: int) -> Array:
    """Returns one number for each row: a single number holds for all rows."""
    return jnp.broadcast_to(number, (rows,)) if number.ndim == 0 else number


def material_rows(rows: int, color: Array, *coefficients: Array) -> list[Array]:
    """Returns the materials of `rows` objects: a colour and each coefficient, row by row.

    **Arguments:** `color`, `coefficients`: one for all objects, or one for each object.
    """
    return [color_rows(color, rows), *(number_rows(x, rows) for x in coefficients)]


def misshapen(
    objects: object, names: Iterable[str], shape: tuple[int, ...]
) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Yields the name and the shape of each field whose shape is not `shape`."""
    for name in names:
        field = getattr(objects, name)
        if field.shape != shape:
            yield name, field.shape
