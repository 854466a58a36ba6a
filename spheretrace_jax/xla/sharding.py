"""Sharding: a picture's rows are divided among devices, each of which computes one block.

Rows are independent except for the pixel filter of smooth shading, which needs the rows above and
below. Only these boundary rows (a halo of one row) are exchanged between neighbouring devices.
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
Replicated = TypeVar("Replicated")
Sharded = TypeVar("Sharded")


class Rows(eqx.Module):
    """A block of a picture's rows: all rows, or the block of one device."""

    count: int = eqx.field(static=True)
    axes: tuple[str, ...] = eqx.field(static=True, default=())  #: mesh axes that divide the rows

    @property
    def first(self) -> Index:
        """Returns the index of the first row of the block."""
        return lax.axis_index(self.axes).astype(jnp.int32) * self.count if self.axes else 0

    def within(self, height: int) -> Bool[Array, " count"]:
        """Returns the mask of the rows inside a picture of `height` rows.

        The block of the last device may extend beyond the picture.
        """
        return self.first + jnp.arange(self.count, dtype=jnp.int32) < height

    def with_neighbours(
        self, block: Shaped[Array, "count width"]
    ) -> Shaped[Array, "count+2 width"]:
        """Pads the block by the rows above and below (halo exchange).

        Beyond the first and the last device the padding is 0 or False.
        """
        if not self.axes:
            return jnp.pad(block, ((1, 1), (0, 0)))
        down = [(k, k + 1) for k in range(lax.axis_size(self.axes) - 1)]
        above = lax.ppermute(block[-1:], self.axes, down)
        below = lax.ppermute(block[:1], self.axes, [(k, j) for j, k in down])
        return jnp.concatenate([above, block, below])


def rows_sharding(sharding: NamedSharding) -> NamedSharding:
    """Checks that a sharding divides rows only, and returns it on a mesh of automatic axes.

    The compiler chooses the sharding of everything else on that mesh.

    **Raises:** `InputError` for shardings that divide other axes than rows.
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
    """Returns the block of rows of the current device: the same number of rows on every device."""
    return Rows(-(-height // device_count(sharding)), _axes(sharding))


def _axes(sharding: NamedSharding) -> tuple[str, ...]:
    """Returns the axes of the mesh along which rows are divided."""
    axes = sharding.spec[0]
    return axes if isinstance(axes, tuple) else (axes,)


def device_count(sharding: NamedSharding) -> int:
    """Returns the number of devices among which rows are divided."""
    return math.prod(sharding.mesh.shape[axis] for axis in _axes(sharding))


def on_devices(
    function: Callable[[Replicated, Sharded], T],
    sharding: NamedSharding,
    replicated: Replicated,
    sharded: Sharded = None,
    *,
    joined: bool = False,
) -> T:
    """Runs `function(replicated, sharded)` on each device (`shard_map`).

    **Arguments:** `replicated`: a pytree that every device holds in full. `sharded`: a pytree of
    arrays whose rows are divided among the devices. `joined`: whether all devices return the same
    value.

    **Returns:** the common value if `joined`, else the devices' values, concatenated by rows.
    """
    # check_vma fails: loops start with replicated constants and end with values of one device
    return jax.shard_map(
        function,
        mesh=sharding.mesh,
        in_specs=(PartitionSpec(), sharding.spec),
        out_specs=PartitionSpec() if joined else sharding.spec,
        check_vma=False,
    )(replicated, sharded)


def pad_rows(
    rows: Shaped[Array, "height ..."], sharding: NamedSharding
) -> Shaped[Array, "all ..."]:
    """Pads by rows of 0 to a multiple of the number of devices."""
    missing = -len(rows) % device_count(sharding)
    return jnp.pad(rows, ((0, missing), *[(0, 0)] * (rows.ndim - 1)))


def replicate(values: T, sharding: NamedSharding | None) -> T:
    """Replicates values on all devices of the mesh; returns them as they are without sharding."""
    if sharding is None:
        return values
    return jax.device_put(values, NamedSharding(sharding.mesh, PartitionSpec()))


def divide(values: T, sharding: NamedSharding) -> T:
    """Divides the rows of arrays, which every process holds whole, among the devices."""
    return jax.device_put(values, NamedSharding(sharding.mesh, sharding.spec))


def gather_on_host(values: T) -> T:
    """Gathers arrays divided among several processes on the host; returns other values as is."""

    def gather(x):
        if not isinstance(x, jax.Array) or x.is_fully_addressable or x.is_fully_replicated:
            return x
        from jax.experimental.multihost_utils import process_allgather

        return process_allgather(x, tiled=True)

    return jax.tree.map(gather, values)
