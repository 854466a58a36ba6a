"""The chain rule: J^T J and J^T r by the free parameters, from products of rows' numbers."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...scene.parameters import LIGHT_PLACES
from .shading_equations import ShadingEquations, ShadingSums


def by_parameters(
    equations: ShadingEquations, sums: ShadingSums
) -> tuple[Float[Array, "free free"], Float[Array, " free"]]:
    """Returns J^T J and J^T r, by the free parameters."""
    products = sums.products + _products_alone(equations, sums.alone)
    shading, dtype = equations.shading, products.dtype
    spheres, places = shading.sphere_columns()
    spheres = spheres.astype(dtype)
    _, count, own, width = spheres.shape
    shared, shared_places = _shared_columns(equations)
    shared, size = shared.astype(dtype), products.shape[-1]
    rows = products[:, : count * own].reshape(3, count, own, size)
    left = jnp.einsum("cniw,cnim->cnwm", spheres, rows).reshape(3, count * width, size)
    left = jnp.concatenate([left, jnp.einsum("cmd,cmk->cdk", shared, products)], axis=1)
    total = left.shape[1]
    columns = left[:, :, : count * own].reshape(3, total, count, own)
    square = jnp.einsum("cmni,cniw->mnw", columns, spheres).reshape(total, count * width)
    square = jnp.concatenate([square, jnp.einsum("ckm,cmd->kd", left, shared)], axis=1)
    order = np.argsort(np.concatenate([places.reshape(-1), shared_places]))
    gradient = jnp.sum(left[:, :, -1], axis=0)
    return square[order][:, order], gradient[order]


def _shared_columns(
    equations: ShadingEquations,
) -> tuple[Float[Array, "3 all columns"], np.ndarray]:
    """Returns the columns that no sphere has to itself, as multiples of the rows' numbers."""
    shading, index = equations.shading, equations.index
    colors, first = shading.color_columns(), equations.objects * shading.own
    colors = jnp.pad(colors.reshape(3, first, -1), ((0, 0), (0, equations.extras), (0, 0)))
    places = [index.lights[name] for name in ("light_color",) if name in index.lights]
    units = []  # columns that are numbers of the rows as they are
    if shading.by_position:
        for name in LIGHT_PLACES:
            if name in index.lights:
                places.append(index.lights[name])
                units.append(first + np.arange(shading.by_position))
        first += shading.by_position
    if equations.turns is not None:
        spheres = np.arange(shading.context.tables.sphere_count)
        for name, shift in (("kgr", 0), ("kt", equations.objects - 1)):
            if name in index.spheres:
                places.append(index.spheres[name])
                units.append(first + shift + spheres)
        first += equations.turns.size
    number = np.concatenate([np.zeros(0, int), *units])
    identity = np.zeros((3, colors.shape[1], number.size))
    identity[:, number, np.arange(number.size)] = 1
    parts = [colors, jnp.asarray(identity, colors.dtype)]
    if index.exposure is not None:
        places.append(index.exposure)
        parts.append(jnp.zeros((3, colors.shape[1], 3)).at[:, first].set(jnp.eye(3)))
    places = np.concatenate([np.zeros(0, int), *(p.reshape(-1) for p in places)])
    return jnp.concatenate(parts, axis=2), places


def _products_alone(
    equations: ShadingEquations, alone: Float[Array, "objects 3 x x"]
) -> Float[Array, "3 all all"]:
    """Returns the products of rows of one object by the numbers of which rows are made."""
    shading, own, dtype = equations.shading, equations.shading.own, alone.dtype
    # rows are linear in the numbers of samples: what each of these numbers alone gives
    unit = jnp.eye(shading.numbers, dtype=dtype)[None]

    def columns(factors: Float[Array, "3 x"]) -> Float[Array, "3 columns numbers"]:
        factors = factors.astype(dtype)[..., None]
        parts = [jnp.repeat(unit[:, :own], 3, axis=0), shading.light_columns(unit, factors)]
        if equations.turns is not None:
            parts.append(jnp.zeros((3, equations.turns.size, shading.numbers), dtype))
        if equations.index.exposure is not None:
            seen = shading.seen(unit, factors) / equations.exposure[:, None].astype(dtype)
            parts.append(seen[:, None])
        return jnp.concatenate(parts, axis=1)

    by_numbers = jax.vmap(columns)(equations.factors)
    by_numbers = jnp.pad(by_numbers, ((0, 0), (0, 0), (0, 1), (0, 1)))
    by_numbers = by_numbers.at[:, :, -1, -1].set(1)
    products = jnp.einsum("ocam,ocmn,ocbn->coab", by_numbers, alone, by_numbers)
    # the numbers of the object, and after those of all objects what rows have beside them
    numbers = np.arange(own + equations.extras)
    holder = np.where(numbers < own, np.arange(equations.objects)[:, None], equations.objects - 1)
    place = holder * own + numbers
    size = equations.objects * own + equations.extras
    total = jnp.zeros((3, size, size), dtype)
    return total.at[:, place[:, :, None], place[:, None, :]].add(products)
