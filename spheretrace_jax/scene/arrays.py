"""Arrays of a scene: their dtype, and one row for each object from a number that holds for all."""

import dataclasses
from collections.abc import Callable
from contextlib import nullcontext
from functools import cache, wraps
from statistics import mode
from types import NoneType
from typing import Any, ParamSpec, TypeVar, get_args

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..base.device import check_device
from ..base.errors import InputError

P = ParamSpec("P")
T = TypeVar("T")


def precision(dtype: Any) -> np.dtype:
    """Returns a scene's dtype. **Raises:** `InputError` for all but float32 and float64."""
    if np.dtype(dtype) not in (np.float32, np.float64):
        raise InputError(f"a scene's dtype must be float32 or float64, got {np.dtype(dtype)}")
    return np.dtype(dtype)


def floats(*values: Any) -> list[Array]:
    """Returns the values as arrays of one floating dtype.

    Python numbers, lists and arrays of whole numbers take the dtype of the floating arrays among
    the values. Without floating arrays, all values take JAX's default dtype.

    **Raises:** `InputError` for arrays of other dtypes, and where JAX has no device.
    """
    check_device()
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


def check_shapes(owner: str, part: Any) -> dict[str, Any]:
    """Checks the arrays of a part of a scene against the axes that its fields are annotated with.

    Python's numbers count as arrays without axes, and what is None and may be is not looked at.

    **Arguments:** `owner`: the part's name in the scene, with a dot; empty for the scene itself.

    **Returns:** the arrays by their names, such as `spheres.kd`.

    **Raises:** `InputError` for other shapes, and for what is no array.
    """
    fields = _axes_of(type(part))
    optional = _optional_of(type(part))
    arrays: dict[str, Any] = {name: getattr(part, name) for name in fields}
    arrays = {n: x for n, x in arrays.items() if x is not None or n not in optional}
    fields = {name: fields[name] for name in arrays}
    lengths = _axis_lengths(fields, arrays)
    for name, array in arrays.items():
        wanted = tuple(lengths.get(axis, axis) for axis in fields[name])
        if is_array(array):
            got = None if array.shape == wanted else str(array.shape)
        else:
            number = not wanted and type(array) in (int, float)
            got = None if number else described(array)
        if got is not None:
            shape = f"({', '.join(map(str, wanted))}{',' if len(wanted) == 1 else ''})"
            raise InputError(f"{owner}{name} must be an array of shape {shape}, got {got}")
    return {f"{owner}{name}": array for name, array in arrays.items()}


def check_refraction(owner: str, ior: Any) -> None:
    """Checks the indices of refraction of objects, if they are known.

    **Raises:** `InputError` for one below 1, and for nan.
    """
    if not is_traced(ior) and not (np.asarray(ior) >= 1).all():
        raise InputError(f"{owner}ior must be at least 1, got {np.min(np.asarray(ior)):g}")


@cache
def _axes_of(part: type) -> dict[str, tuple[int | str, ...]]:
    """Returns the axes of the fields that are arrays: lengths, or names of lengths."""
    kinds = {f.name: (f.type, *get_args(f.type)) for f in dataclasses.fields(part)}
    named = lambda kinds: [k.dim_str for k in kinds if hasattr(k, "dim_str")]
    annotated = {name: next(iter(named(kinds)), None) for name, kinds in kinds.items()}
    length = lambda axis: int(axis) if axis.isdigit() else axis
    return {
        name: tuple(map(length, axes.split()))
        for name, axes in annotated.items()
        if axes is not None
    }


@cache
def _optional_of(part: type) -> frozenset[str]:
    """Returns the names of the fields that may be None."""
    return frozenset(f.name for f in dataclasses.fields(part) if NoneType in get_args(f.type))


def _axis_lengths(
    fields: dict[str, tuple[int | str, ...]], arrays: dict[str, Any]
) -> dict[int | str, int]:
    """Returns how long named axes are: as most of the arrays say that have as many axes."""
    found: dict[int | str, list[int]] = {}
    for name, axes in fields.items():
        shape = arrays[name].shape if is_array(arrays[name]) else ()
        if len(shape) == len(axes):
            for axis, length in zip(axes, shape, strict=True):
                found.setdefault(axis, []).append(length)
    return {axis: mode(lengths) for axis, lengths in found.items() if isinstance(axis, str)}


def described(value: Any) -> str:
    """Returns words for a value of a wrong class."""
    if is_array(value):
        return "an array"
    return "None" if value is None else f"a {type(value).__name__}"


def is_array(value: Any) -> bool:
    """Tells whether a value is an array of JAX, traced ones included, or of NumPy."""
    return hasattr(value, "shape")  # many times as fast as to ask for the class


_NO_ARRAYS_OF_JAX = (np.ndarray, np.generic, int, float)


def with_one_dtype(tree: T, arrays: dict[str, Any]) -> T:
    """Returns a pytree whose leaves are arrays of JAX, all of one floating dtype.

    Python's numbers and NumPy's arrays are converted. NumPy's float64 is float32 without 64-bit
    JAX, as everywhere in JAX.

    **Arguments:** `arrays`: the leaves by their names.

    **Raises:** `InputError` for dtypes that no scene may have, and for more than one.
    """
    dtypes = {name: _dtype(x) for name, x in arrays.items() if is_array(x)}
    dtype = precision(mode(dtypes.values()))
    for name, other in dtypes.items():
        if other != dtype:
            raise InputError(f"{name} must be {dtype}, as the rest is, got {other}")
    if not any(isinstance(x, _NO_ARRAYS_OF_JAX) for x in arrays.values()):
        return tree
    return jax.tree.map(lambda leaf: converted(leaf, dtype), tree)


def _dtype(array: Any) -> np.dtype:
    """Returns an array's dtype; of NumPy's arrays that of the array that JAX makes of them."""
    dtype = np.dtype(array.dtype)
    of_numpy = isinstance(array, _NO_ARRAYS_OF_JAX)
    return jax.dtypes.canonicalize_dtype(dtype) if of_numpy else dtype
