"""The normal equations of shading: geometry is traced once, and each step only shades and sums.

The products of all numbers of which rows of J are made are summed, whatever is free; the chain
rule to the free parameters is applied to the sums. Products are summed in double precision where
JAX has it, so that what shows little is not lost among the rounding errors of what shows much.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from ...antialiasing.compositing import layer_light_terms
from ...base.types import Index, widest_float
from ...rendering.shading_samples import LayerSample, PointSample
from ...scene.camera import Ray
from ...tracing.context import TraceContext
from ...tracing.path import all_turns, light_terms_at
from ...xla.barriers import barrier
from ...xla.loops import keep_loop_parallel
from ..model.target import Target
from .cells import ROWS, Cells
from .gbuffer import LAYERS, POINTS, GBuffer, Rows
from .linear_shading import Basis, LinearShading
from .parameter_index import ParameterIndex

# Chunks of rows of one object that are summed at a time, side by side.
_CHUNKS = 1 << 4


class ShadingSums(eqx.Module):
    """Sums of products of the numbers of which the rows of J are made, for each channel.

    Rows of several objects are made of, in order: the numbers of each object and of the background;
    the columns of the lights' positions; those of kgr and kt (`all_turns`), if they are free; that
    of the exposure, if it is free; and the residual. Rows of one object are made of the numbers of
    its samples and the residual.
    """

    products: Float[Array, "3 all all"]  #: of rows of several objects
    #: of rows of one object
    alone: Float[Array, "objects 3 x x"]
    seen: Float[Array, "pixels 3"]  #: the picture


class ShadingEquations(eqx.Module):
    """Sums the products of one strip of a picture after another."""

    shading: LinearShading
    target: Target
    exposure: Float[Array, " 3"]
    factors: Float[Array, "objects 3 x"]
    turns: Float[Array, " turns"] | None  #: kgr and kt, if they are free

    def __init__(
        self,
        context: TraceContext,
        target: Target,
        exposure: Float[Array, " 3"],
        index: ParameterIndex,
    ):
        self.shading = LinearShading(context, index)
        self.target, self.exposure = target, exposure
        self.factors = self.shading.all_factors()
        self.turns = all_turns(context) if context.needs.dark_paths else None

    @property
    def index(self) -> ParameterIndex:
        """Returns where the free parameters are."""
        return self.shading.index

    @property
    def objects(self) -> int:
        """Returns the number of objects, the background included."""
        return len(self.factors)

    @property
    def extras(self) -> int:
        """Returns how many numbers a row has beside those of objects; the last one the residual."""
        turns = 0 if self.turns is None else self.turns.size
        return self.shading.by_position + turns + (self.index.exposure is not None) + 1

    def sums(self, buffer: GBuffer, pixels: int) -> ShadingSums:
        """Sums the products of all strips. **Arguments:** `buffer`: without `fixed`."""
        size = self.objects * self.shading.own + self.extras
        of_sample, narrow = 1 + self.shading.numbers, self.shading.context.dtype
        dtype = widest_float(narrow)
        start = ShadingSums(
            jnp.zeros((3, size, size), dtype),
            jnp.zeros((self.objects, 3, of_sample, of_sample), dtype),
            jnp.zeros((pixels, 3), narrow),
        )
        if len(buffer.point_count) == 1:
            return self._add_strip(start, jax.tree.map(lambda x: x[0], buffer))[0]
        # no bound method: `scan` hashes its function, and a module of arrays has no hash
        return lax.scan(lambda sums, strip: self._add_strip(sums, strip), start, buffer)[0]

    def _add_strip(self, sums: ShadingSums, strip: GBuffer) -> tuple[ShadingSums, None]:
        basis = self._bases(strip.points, strip.point_count, POINTS, self._point_basis)
        if strip.layers is not None:
            layers = self._bases(strip.layers, strip.layer_count, LAYERS, self._layer_basis)
            basis = jnp.concatenate([basis, layers], axis=2)
        sums = self._add_alone(sums, strip.alone, basis)
        return self._add_several(sums, strip.several, basis), None

    # -- samples

    def _bases(self, samples, count: Int[Array | np.ndarray, ""], size: int, of_block) -> Basis:
        """Returns the numbers of all samples, `size` of them at a time."""
        total = jax.tree.leaves(samples)[0].shape[-1]
        block = lambda k: jax.tree.map(
            lambda x: lax.dynamic_slice_in_dim(x, k * size, size, axis=-1), samples
        )
        shape = 1 if samples.tint is None else 3, self.shading.numbers, total
        basis = jnp.zeros(shape, self.shading.context.dtype)

        def add(k: Index, basis: Basis) -> Basis:
            k = keep_loop_parallel(jnp.asarray(k))
            return lax.dynamic_update_slice_in_dim(basis, of_block(block(k)), k * size, axis=2)

        return lax.fori_loop(0, -(-count // size), add, basis)

    def _point_basis(self, point: PointSample) -> Basis:
        context = self.shading.context
        # only where rays come from is not known any more, and shading does not ask
        ray = Ray(point.surface.point, point.direction)
        terms = lambda light, shadows, finish: light_terms_at(
            context, ray, point.hit, light, shadows, finish, point.surface
        )
        return self.shading.basis(point.hit.id, terms, point.tint)

    def _layer_basis(self, sample: LayerSample) -> Basis:
        terms = partial(layer_light_terms, self.shading.context, sample.layer)
        return self.shading.basis(sample.layer.hit.id, terms, sample.tint)

    # -- rows

    def _cell_basis(self, cells: Cells, most: Int[Array, ""], basis: Basis) -> Basis:
        """Returns the numbers of cells: weighted sums of those of their samples.

        **Arguments:** `most`: how many samples cells have at most.
        """

        # sample by sample: gathered at once, and then summed, it takes 70 times as long
        def add(k: Index, total: Basis) -> Basis:
            sample, weight = cells.sample[..., k], cells.weight[..., k]
            taken = basis.at[:, :, sample].get(mode="promise_in_bounds")
            return total + taken * weight[None, None]

        start = jnp.zeros((*basis.shape[:2], *cells.object.shape), basis.dtype)
        return lax.fori_loop(0, most, add, start)

    def _residual(
        self, seen: Float[Array, "3 ..."], pixel: Array
    ) -> tuple[Float[Array, "3 ..."], Float[Array, "3 ..."], Float[Array, "3 ..."]]:
        """Returns the residuals of rows, and their derivatives by what is seen and by exposures."""
        # as a picture of one row
        lift = lambda x: x.reshape(1, -1, 3)
        take = lambda x: lift(x.reshape(-1, 3).at[pixel].get(mode="fill", fill_value=0))
        target, picture = self.target, lift(jnp.moveaxis(seen, 0, -1))
        here = Target(take(target.image), take(target.weight), target.noise, target.loss)
        numbers = here.residual(picture, self.exposure), *here.slopes(picture, self.exposure)
        residual, slope, by_exposure = (
            jnp.moveaxis(x.reshape(*pixel.shape, 3), -1, 0) for x in numbers
        )
        return barrier((residual, slope, by_exposure))

    def _add_alone(self, sums: ShadingSums, rows: Rows, basis: Basis) -> ShadingSums:
        """Adds pixels that show one object each, chunk by chunk."""
        shading = self.shading

        def add(k: Index, sums: ShadingSums) -> ShadingSums:
            k = keep_loop_parallel(jnp.asarray(k))
            at = k * _CHUNKS + jnp.arange(_CHUNKS, dtype=jnp.int32)
            cells, most, pixel = jax.tree.map(
                lambda x: x.at[at].get(mode="clip"), (rows.cells, rows.most, rows.pixel)
            )
            pixel = jnp.where((at < rows.count)[:, None], pixel, len(sums.seen))
            object_ = cells.object[:, 0]
            factors = jnp.moveaxis(self.factors[object_], 0, -1)[..., None]
            of_cells = self._cell_basis(cells, jnp.max(most), basis)
            seen = shading.seen(of_cells, factors)
            residual, slope, _ = self._residual(seen, pixel)
            products = _products(of_cells, slope, residual, sums.alone.dtype)
            seen = jnp.moveaxis(seen, 0, -1)
            return ShadingSums(
                sums.products,
                sums.alone.at[object_].add(products),
                sums.seen.at[pixel].set(seen, mode="drop"),
            )

        return lax.fori_loop(0, -(-rows.count // _CHUNKS), add, sums)

    def _add_several(self, sums: ShadingSums, rows: Rows, basis: Basis) -> ShadingSums:
        """Adds all other pixels, group by group."""
        shading, own = self.shading, self.shading.own

        def add(k: Index, sums: ShadingSums) -> ShadingSums:
            k = keep_loop_parallel(jnp.asarray(k))
            cells, most, pixel = jax.tree.map(lambda x: x[k], (rows.cells, rows.most, rows.pixel))
            factors = jnp.moveaxis(self.factors[cells.object], 0, -1)
            of_cells = self._cell_basis(cells, most, basis)
            by_turns = None
            if cells.turns is not None:
                of_cells, by_turns = self._turned(cells, of_cells, factors)
            in_rows = lambda x, *at: (
                jnp.zeros((ROWS, *(n for n, _ in at), *x.shape[:-1]), x.dtype)
                .at[(cells.row, *(i for _, i in at))]
                .add(jnp.moveaxis(x, -1, 0), mode="drop")
            )
            seen = shading.seen(of_cells, factors)
            extras = [seen[:, None], shading.light_columns(of_cells, factors)]
            extras = jnp.moveaxis(in_rows(jnp.concatenate(extras, axis=1)), 0, -1)
            seen, extras = extras[:, 0], [extras[:, 1:]]
            if by_turns is not None:
                extras.append(self._turn_columns(cells, by_turns))
            residual, slope, by_exposure = self._residual(seen, pixel)
            extras = [x * slope[:, None] for x in extras]
            if self.index.exposure is not None:
                extras.append(by_exposure[:, None])
            of_objects = in_rows(of_cells[:, :own], (self.objects, cells.object))
            of_objects = jnp.moveaxis(of_objects, 0, -1)
            of_objects = jnp.moveaxis(of_objects, 1, 0).reshape(-1, self.objects * own, ROWS)
            a = jnp.concatenate([of_objects * slope[:, None], *extras, residual[:, None]], axis=1)
            a = a.astype(sums.products.dtype)
            products = sums.products + jnp.einsum("car,cbr->cab", a, a)
            seen = jnp.moveaxis(seen, 0, -1)
            return ShadingSums(products, sums.alone, sums.seen.at[pixel].set(seen, mode="drop"))

        return lax.fori_loop(0, rows.count, add, sums)

    def _turned(
        self, cells: Cells, of_cells: Basis, factors: Float[Array, "3 x cells"]
    ) -> tuple[Basis, Float[Array, "3 bounces cells"]]:
        """Returns the numbers of cells times kgr and kt on their way, and the colours by each."""
        assert self.turns is not None and cells.turns is not None
        values = self.turns[cells.turns]
        bounces = values.shape[-1]
        others = ~np.eye(bounces, dtype=bool)
        rest = jnp.prod(jnp.where(others[None], values[:, None, :], 1), axis=-1)
        seen = self.shading.seen(of_cells, factors)
        return of_cells * jnp.prod(values, axis=-1)[None, None], seen[:, None] * rest.T[None]

    def _turn_columns(
        self, cells: Cells, by_turns: Float[Array, "3 bounces cells"]
    ) -> Float[Array, "3 turns rows"]:
        """Returns the derivatives by kgr and kt of the rows that cells are in."""
        assert self.turns is not None and cells.turns is not None
        columns = jnp.zeros((ROWS, self.turns.size, 3), by_turns.dtype)
        row = jnp.broadcast_to(cells.row[:, None], cells.turns.shape)
        columns = columns.at[row, cells.turns].add(
            jnp.moveaxis(by_turns, 0, -1).swapaxes(0, 1), mode="drop"
        )
        return jnp.moveaxis(columns, (0, 2), (2, 0))


def _products(
    basis: Float[Array, "_ numbers chunks rows"],
    slope: Float[Array, "3 chunks rows"],
    residual: Float[Array, "3 chunks rows"],
    dtype: jnp.dtype,
) -> Float[Array, "chunks 3 x x"]:
    """Returns the products of scaled numbers and the residual, for each chunk and channel.

    **Arguments:** `slope`: what scales numbers.
    """

    def each() -> Float[Array, "chunks 3 x x"]:
        rows = jnp.concatenate([basis * slope[:, None], residual[:, None]], axis=1)
        rows = jnp.moveaxis(rows.astype(dtype), 2, 0)
        return rows @ jnp.swapaxes(rows, -1, -2)

    def alike() -> Float[Array, "chunks 3 x x"]:
        rows = jnp.concatenate([basis[0] * slope[:1], residual])
        rows = jnp.moveaxis(rows.astype(dtype), 1, 0)
        # one by one: 5 ms for 120,000 rows, as a batch 7
        products, numbers = jnp.stack([row @ row.T for row in rows]), basis.shape[1]
        at = np.array([[*range(numbers), numbers + c] for c in range(3)])
        return products[:, at[:, :, None], at[:, None, :]]

    if len(basis) > 1:
        return each()
    # where nothing is tinted, or counts in some channels only, one product does for all
    return lax.cond(jnp.all(slope == slope[:1]), alike, each)
