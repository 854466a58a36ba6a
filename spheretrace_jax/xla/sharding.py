"""Rows of a picture on several devices: each computes its own.

Rows do not depend on one another but for smooth shading, which is averaged by its differences from
the rows above and below: of these, and of no other rows, devices tell their neighbours.
"""

import math
from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec, get_abstract_mesh
from jaxtyping import Array, Bool, Shaped

from ..base.errors import InputError
from ..base.types import Index

T = TypeVar("T")
Whole = TypeVar("Whole")
Own = TypeVar("Own")


class Rows(eqx.Module):
    """Those of a picture's rows that are computed together: all, or one device's own."""

    count: int = eqx.field(static=True)
    axes: tuple[str, ...] = eqx.field(static=True, default=())  #: the mesh's, along which they lie

    @property
    def first(self) -> Index:
        """The number of the first one."""
        return lax.axis_index(self.axes).astype(jnp.int32) * self.count if self.axes else 0

    def within(self, height: int) -> Bool[Array, " count"]:
        """Which of them are in a picture: the last device's may be beyond it."""
        return self.first + jnp.arange(self.count, dtype=jnp.int32) < height

    def with_neighbours(
        self, plane: Shaped[Array, "count width"]
    ) -> Shaped[Array, "count+2 width"]:
        """A plane with the rows above and below, which are 0 or no where there are none."""
        if not self.axes:
            return jnp.pad(plane, ((1, 1), (0, 0)))
        down = [(k, k + 1) for k in range(lax.axis_size(self.axes) - 1)]
        above = lax.ppermute(plane[-1:], self.axes, down)
        below = lax.ppermute(plane[:1], self.axes, [(k, j) for j, k in down])
        return jnp.concatenate([above, plane, below])


def rows_sharding(sharding: NamedSharding) -> NamedSharding:
    """The same, checked, with a mesh on which the compiler looks after what is not said here.

    **Raises:** `InputError` for shardings that divide other than rows.
    """
    if not isinstance(sharding, NamedSharding) or not isinstance(sharding.mesh, Mesh):
        raise InputError(
            'sharding must be as NamedSharding(mesh, PartitionSpec("rows")), '
            f"got {' '.join(repr(sharding).split())}"
        )
    spec = tuple(sharding.spec)
    if spec[:1] in ((), (None,), ((),)) or any(spec[1:]):
        raise InputError(
            f'sharding must divide rows and nothing else, as PartitionSpec("rows"), got {spec}'
        )
    if AxisType.Explicit in get_abstract_mesh().axis_types:
        raise InputError("sharding needs a mesh with axes of AxisType.Auto inside jax.set_mesh")
    mesh = Mesh(sharding.mesh.devices, sharding.mesh.axis_names)
    return NamedSharding(mesh, PartitionSpec(spec[0]))


def rows_of_device(height: int, sharding: NamedSharding) -> Rows:
    """The rows that each device computes, seen from there: as many on all of them."""
    return Rows(-(-height // _devices(sharding)), _axes(sharding))


def _axes(sharding: NamedSharding) -> tuple[str, ...]:
    """The axes of the mesh that rows lie on."""
    axes = sharding.spec[0]
    return axes if isinstance(axes, tuple) else (axes,)


def _devices(sharding: NamedSharding) -> int:
    """How many devices rows lie on."""
    return math.prod(sharding.mesh.shape[axis] for axis in _axes(sharding))


def on_devices(
    function: Callable[[Whole, Own], T],
    sharding: NamedSharding,
    whole: Whole,
    own: Own = None,
    *,
    joined: bool = False,
) -> T:
    """A function on each device.

    **Arguments:** `function`: of `whole`, which all devices have, and of their part of `own`, whose
    arrays lie by rows. `joined`: whether its value is the same on all of them.

    **Returns:** its value, or the values one after the other.
    """
    # unchecked: loops start with constants, the same everywhere, and end with a device's own values
    return jax.shard_map(
        function,
        mesh=sharding.mesh,
        in_specs=(PartitionSpec(), sharding.spec),
        out_specs=PartitionSpec() if joined else sharding.spec,
        check_vma=False,
    )(whole, own)


def padded(rows: Shaped[Array, "height ..."], sharding: NamedSharding) -> Shaped[Array, "all ..."]:
    """Rows, and as many of 0 as devices have beyond them."""
    beyond = -len(rows) % _devices(sharding)
    return jnp.pad(rows, ((0, beyond), *[(0, 0)] * (rows.ndim - 1)))


def everywhere(values: T, sharding: NamedSharding | None) -> T:
    """The same values, whole on each device; where there is one device, as they are."""
    if sharding is None:
        return values
    return jax.device_put(values, NamedSharding(sharding.mesh, PartitionSpec()))


def gathered(values: T) -> T:
    """The same values; arrays of which other processes hold parts, whole and on the host."""

    def whole(x):
        if not isinstance(x, jax.Array) or x.is_fully_addressable or x.is_fully_replicated:
            return x
        from jax.experimental.multihost_utils import process_allgather

        return process_allgather(x, tiled=True)

    return jax.tree.map(whole, values)
