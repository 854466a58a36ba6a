"""`GBuffer`: shading samples, and the rows of a picture's Jacobian as sums of them.

Most pixels show one object: their rows have its columns alone, and come in chunks of one object
each. The rows of all other pixels have columns for every object.
"""

import itertools
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Int

from ...rendering.pixel_filter import filter_weights
from ...rendering.sample_tracer import trace_samples
from ...rendering.shading_samples import LayerSample, PointSample, ShadingSamples, take
from ...scene.scene import Scene
from ...scene.settings import RenderSettings
from ...xla.jit import compiled
from ...xla.sharding import device_count, divide
from ..model.accessors import distinct
from .cells import (
    CELLS,
    SAMPLES,
    Arranged,
    CellList,
    Cells,
    Entries,
    arrange_in_chunks,
    arrange_in_groups,
    make_entries,
)

#: Samples that are shaded at a time: of points, and of layers, whose shadows have edges.
POINTS, LAYERS = 1 << 14, 1 << 11

# Pictures are cut into strips of at most so many samples of pixels, so that temporary arrays stay
# small: 12 numbers for each. Smaller strips repeat more of the rows beside them.
_STRIP = 1 << 19


class Rows(eqx.Module):
    """Rows as sums of cells, in chunks of one object each, or in groups of several."""

    cells: Cells
    most: Int[Array | np.ndarray, "*strips groups"]  #: how many samples cells have at most
    pixel: Int[Array | np.ndarray, "*strips groups rows"]  #: the number of pixels for no row
    count: Int[Array | np.ndarray, "*strips"]  #: how many groups there are


class GBuffer(eqx.Module):
    """The shading samples and rows of a picture; arrays have an axis for strips in front."""

    points: PointSample
    layers: LayerSample | None
    point_count: Int[Array | np.ndarray, " strips"]
    layer_count: Int[Array | np.ndarray, " strips"]
    alone: Rows  #: of pixels that show one object: `(strips, chunks, CHUNK)`; none of black ones
    several: Rows  #: of all others: `(strips, groups, CELLS)`
    fixed: list[Array]  #: what the scene has that is not free, as it was traced


def fixed_arrays(scene: Scene, free: tuple[str, ...]) -> list[Array]:
    """Returns the arrays of a scene that a fit leaves as they are."""
    accessors = distinct(name for name in free if name != "exposure").values()
    places = lambda scene: [accessor(scene) for accessor in accessors]
    fixed = eqx.tree_at(places, scene, replace_fn=lambda _: None)
    return [x for x in jax.tree.leaves(fixed) if eqx.is_array(x)]


def make_gbuffer(scene: Scene, settings: RenderSettings, free: tuple[str, ...]) -> GBuffer:
    """Traces a picture's shading samples and arranges its rows, from the host.

    It takes some 60 bytes for each point and 260 for each layer, and for each row 8 bytes a sample.
    """
    samples, weights, reach = trace_samples(scene, settings), None, settings.samples**2
    if settings.antialias:
        reach = 5 * reach
        weights = np.asarray(_filter_weights(scene, jax.device_put(samples.edge), settings))
    entries = make_entries(
        samples.point_contribution, samples.layer_contribution, weights, settings.width
    )
    strips = -(-settings.width * settings.height * settings.samples**2 // _STRIP)
    if settings.sharding is not None:  # as many for each device
        devices = device_count(settings.sharding)
        strips = -(-strips // devices) * devices
    bounds = np.linspace(0, settings.height, strips + 1).astype(int) * settings.width
    known = not settings.needs.dark_paths
    parts = [
        _Strip(samples, entries.between(begin, end), scene.objects, known)
        for begin, end in itertools.pairwise(bounds.tolist())
    ]
    most = max(part.cells.most_in_a_pixel(SAMPLES) for part in parts)
    most = max(CELLS, 1 << (most - 1).bit_length())
    pixels = settings.width * settings.height
    buffer = _stacked(
        [part.points for part in parts],
        None if samples.layers is None else [part.layers for part in parts],
        [part.alone(reach, pixels) for part in parts],
        [part.several(min(SAMPLES, reach), pixels, most) for part in parts],
    )
    if settings.sharding is not None:
        buffer = divide(buffer, settings.sharding)
    return eqx.tree_at(lambda b: b.fixed, buffer, fixed_arrays(scene, free))


@compiled
def _filter_weights(scene: Scene, edge: Array, settings: RenderSettings) -> Array:
    return filter_weights(edge, settings, scene.dtype)


class _Strip:
    """A strip of the picture in NumPy arrays, before it has the size of the largest."""

    def __init__(self, samples: ShadingSamples, entries: Entries, background: int, known: bool):
        used, number = np.unique(entries.sample, return_inverse=True)
        points, layers = used[used >= 0], -1 - used[used < 0][::-1]
        entries = entries._replace(sample=number - len(layers))
        object_, turns = _objects_and_turns(samples, points, layers)
        object_ = np.where(object_ < 0, background, object_)
        turns = turns[:0] if known else turns
        # a negative number counts from the end, as layers do
        self.cells = CellList(entries, object_[entries.sample], turns[:, entries.sample])
        self.only = self.cells.only_cells(no_turn=2 * background)
        self.known = known
        self.points, self.layers = take(samples.points, points), take(samples.layers, layers)

    def alone(self, reach: int, pixels: int) -> Arranged:
        """Arranges the rows of pixels with one cell."""
        cells = self.cells.cells(np.flatnonzero(self.only), reach, self.known)
        return arrange_in_chunks(*cells, pixels)

    def several(self, samples: int, pixels: int, most: int) -> Arranged:
        """Arranges the rows of all other pixels."""
        cells = self.cells.cells(np.flatnonzero(~self.only), samples, self.known)
        return arrange_in_groups(*cells, pixels, most)


def _objects_and_turns(
    samples: ShadingSamples, points: np.ndarray, layers: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the objects and turns of samples: of points, then of layers from the last one on."""
    ids = np.asarray(samples.points.hit.id)[points]
    turns = samples.point_contribution.turns[:, points]
    if samples.layers is not None:
        back = layers[::-1]
        ids = np.concatenate([ids, np.asarray(samples.layers.layer.hit.id)[back]])
        turns = np.concatenate([turns, samples.layer_contribution.turns[:, back]], axis=1)
    return ids.astype(np.int32), turns


def _stacked(
    points: list[PointSample],
    layers: list[Any] | None,
    alone: list[Arranged],
    several: list[Arranged],
) -> GBuffer:
    """Stacks strips, filled up to the size of the largest, and that to one of few sizes."""
    count = lambda trees: np.array([jax.tree.leaves(t)[0].shape[-1] for t in trees], np.int32)
    point_count, layer_count = count(points), np.zeros(len(points), np.int32)
    first_layer, stacked_layers = _size(point_count, POINTS), None
    if layers is not None:
        layer_count = count(layers)
        stacked_layers = _stack(layers, _size(layer_count, LAYERS))

    def rows(arranged: list[Arranged]) -> Rows:
        counts = np.array([len(each.most) for each in arranged], np.int32)
        cells, most, pixel = _stack(arranged, _size(counts, 1), axis=0)
        sample = np.where(cells.sample < 0, first_layer - 1 - cells.sample, cells.sample)
        cells = eqx.tree_at(lambda c: c.sample, cells, sample.astype(np.int32))
        return Rows(cells, most, pixel.astype(np.int32), counts)

    stacked_points = _stack(points, first_layer)
    samples = stacked_points, stacked_layers, point_count, layer_count
    return jax.device_put(GBuffer(*samples, rows(alone), rows(several), []))


def _stack(trees: list[Any], size: int, axis: int = -1) -> Any:
    """Stacks trees of samples or groups, each filled up with zeros along an axis."""

    def fill(x: np.ndarray) -> np.ndarray:
        shape = list(x.shape)
        shape[axis] = size - shape[axis]
        return np.concatenate([x, np.zeros(shape, x.dtype)], axis=axis)

    return jax.tree.map(lambda *x: np.stack([fill(one) for one in x]), *trees)


def _size(counts: np.ndarray, block: int) -> int:
    """Returns a size for all: blocks by a power of two, so that few sizes are compiled."""
    blocks = -(-int(counts.max()) // block)
    return block << max(0, blocks - 1).bit_length()
