"""`Vec`: vectors as a structure of arrays, one array per component.

Separate arrays for x, y and z, with the pixels last, make every operation one vectorised loop.
`Vec` lets formulas on these arrays read like vector algebra. Colours are `Vec`s too: x, y, z hold
red, green, blue.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar, Union

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from .safe_math import safe_sqrt
from .types import Mask, PixelArray

T = TypeVar("T")


class Vec(eqx.Module):
    """A vector per pixel, in one of two layouts: `SplitVec` for pictures, `PackedVec` for edges.

    Arithmetic on both layouts together is packed.
    """

    if TYPE_CHECKING:

        @property
        def x(self) -> PixelArray: ...

        @property
        def y(self) -> PixelArray: ...

        @property
        def z(self) -> PixelArray: ...

    def __add__(self, other: "Vec") -> "Vec":
        return _by_component(jnp.add, self, other)

    def __sub__(self, other: "Vec") -> "Vec":
        return _by_component(jnp.subtract, self, other)

    def __neg__(self) -> "Vec":
        return jax.tree.map(jnp.negative, self)

    def __mul__(self, other: Union["Vec", PixelArray, float, int]) -> "Vec":
        """Scales by a number per pixel, or multiplies two `Vec`s per component, as for colours."""
        if isinstance(other, Vec):
            return _by_component(jnp.multiply, self, other)
        if isinstance(self, PackedVec):
            return PackedVec(self.xyz * _per_vector(other))
        return jax.tree.map(lambda c: c * other, self)

    def __rmul__(self, other: PixelArray | float | int) -> "Vec":
        return self * other


class SplitVec(Vec):
    """Vectors as arrays `x`, `y`, `z` of one shape `(*pixels,)`, or scalars."""

    x: PixelArray  # pyright: ignore[reportIncompatibleMethodOverride]
    y: PixelArray  # pyright: ignore[reportIncompatibleMethodOverride]
    z: PixelArray  # pyright: ignore[reportIncompatibleMethodOverride]


class PackedVec(Vec):
    """Vectors as one array: a third as many operations to compile, for a few pixels with edges.

    For whole pictures XLA runs them slower than `SplitVec`s.
    """

    xyz: Float[Array, "3 *pixels"]

    @property
    def x(self) -> PixelArray:
        return self.xyz[0]

    @property
    def y(self) -> PixelArray:
        return self.xyz[1]

    @property
    def z(self) -> PixelArray:
        return self.xyz[2]


def _by_component(function: Callable[..., Array], a: Vec, b: Vec) -> Vec:
    """Applies a function to the components of two vectors."""
    if isinstance(a, PackedVec) or isinstance(b, PackedVec):
        return PackedVec(function(_packed(a).xyz, _packed(b).xyz))
    pairs = zip(components(a), components(b), strict=True)
    return SplitVec(*(function(p, q) for p, q in pairs))


def _per_vector(number: Any) -> Any:
    """Returns a number per pixel with an axis for the components of packed vectors."""
    return number if jnp.ndim(number) == 0 else jnp.asarray(number)[None]


def _packed(v: Vec) -> PackedVec:
    if isinstance(v, PackedVec):
        return v
    parts = jnp.broadcast_arrays(*components(v))
    # scalars keep an axis for pixels
    return PackedVec(jnp.stack([jnp.atleast_1d(part) for part in parts]))


def packed(tree: T) -> T:
    """Returns a pytree with its vectors packed."""
    return _with_vectors(_packed, tree)


def split(tree: T) -> T:
    """Returns a pytree with its vectors split."""
    return _with_vectors(lambda v: SplitVec(*components(v)), tree)


def spread(tree: T, shape: tuple[int, ...]) -> T:
    """Returns a pytree of pixel arrays and vectors, scalars spread over pixels of a shape."""
    return jax.tree.map(lambda x: jnp.broadcast_to(x, (*x.shape[:-1], *shape)), tree)


def _with_vectors(function: Callable[[Vec], Vec], tree: T) -> T:
    apply = lambda v: function(v) if _is_vec(v) else v
    return jax.tree.map(apply, tree, is_leaf=_is_vec)


def _is_vec(v: Any) -> bool:
    return isinstance(v, Vec)


def vec(row: Float[Array, "3 *pixels"]) -> Vec:
    """Converts a row of three components to a `Vec`: of scalars, or of numbers per pixel."""
    return SplitVec(row[0], row[1], row[2])


def zeros(shape: tuple[int, ...], dtype: DTypeLike) -> Vec:
    """Returns zero vectors, which are also black."""
    zero = jnp.zeros(shape, dtype)
    return SplitVec(zero, zero, zero)


def grey(value: PixelArray) -> Vec:
    """Returns the colour with equal red, green and blue."""
    return SplitVec(value, value, value)


def components(a: Vec) -> tuple[PixelArray, PixelArray, PixelArray]:
    """Returns the components x, y, z as a tuple."""
    return a.x, a.y, a.z


def dot(a: Vec, b: Vec) -> PixelArray:
    if isinstance(a, PackedVec) or isinstance(b, PackedVec):
        return jnp.sum(_packed(a).xyz * _packed(b).xyz, axis=0)
    return a.x * b.x + a.y * b.y + a.z * b.z


def cross(a: Vec, b: Vec) -> Vec:
    if isinstance(a, PackedVec) or isinstance(b, PackedVec):
        turned = lambda v, by: jnp.roll(_packed(v).xyz, by, axis=0)
        return PackedVec(turned(a, -1) * turned(b, 1) - turned(a, 1) * turned(b, -1))
    return SplitVec(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


def norm(a: Vec) -> PixelArray:
    """Returns the length of `a`; at the zero vector length and derivative are 0, not NaN."""
    return safe_sqrt(dot(a, a))


@jax.custom_jvp
def unit(a: Vec) -> Vec:
    """Normalises: `a / |a|`; the zero vector stays zero, with derivative 0."""
    return a * _per_length(a)


@unit.defjvp
def _unit_jvp(primals: tuple[Vec], tangents: tuple[Vec]) -> tuple[Vec, Vec]:
    # the derivative subtracts the component along `a`, so that none of it is left by rounding
    (a,), (da,) = primals, tangents
    per_length = _per_length(a)
    u, scaled = a * per_length, da * per_length
    return u, scaled - u * dot(u, scaled)


@jax.custom_jvp
def _per_length(a: Vec) -> PixelArray:
    square = dot(a, a)
    positive = square > 0
    # on the CPU sqrt(1/x) compiles to vector code, 1/sqrt(x) does not: 0.8 against 3.3 ms for a
    # million pixels
    return jnp.where(positive, jnp.sqrt(1 / jnp.where(positive, square, 1)), 0)


@_per_length.defjvp
def _per_length_jvp(primals: tuple[Vec], tangents: tuple[Vec]) -> tuple[PixelArray, PixelArray]:
    # -a.da/|a|^3; jax's derivative would compute |a|^4, which overflows in float32 for lights 1e10
    # away
    (a,), (da,) = primals, tangents
    per_length = _per_length(a)
    return per_length, -per_length * dot(a * per_length, da * per_length)


def where(mask: Mask, a: T, b: T) -> T:
    """Selects per pixel `a` where the mask is set, else `b`; both are pytrees of pixel arrays."""
    pick = lambda x, y: jnp.where(mask, x, y)

    def select(x: Any, y: Any) -> Any:
        if isinstance(x, PackedVec) or isinstance(y, PackedVec):
            x, y = _packed(x).xyz, _packed(y).xyz
            return PackedVec(jnp.where(_per_vector(mask), x, y))
        return _by_component(pick, x, y) if _is_vec(x) else pick(x, y)

    return jax.tree.map(select, a, b, is_leaf=_is_vec)


def reflect(direction: Vec, normal: Vec) -> Vec:
    """Reflects `direction` at a surface: D - 2 (D.N) N."""
    return direction - normal * (2 * dot(direction, normal))
