"""Shading samples: a picture's geometry, traced once (the G-buffer of deferred shading).

What a pixel shows is a weighted sum over samples: points that single rays meet, and layers that
cover edges (Saito and Takahashi, "Comprehensible Rendering of 3-D Shapes", SIGGRAPH 1990). Where
geometry and camera stay, samples stay, and only materials and lights are left to evaluate. Samples
are found from the host, bounce by bounce, so that only paths that go on are traced.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..antialiasing.compositing import VisibleLayer, visible_layers
from ..antialiasing.edge_mask import edge_mask
from ..antialiasing.pixel_radiance import secondary_differential
from ..base.types import Ids, Index, Mask
from ..base.vec import Vec, split, spread
from ..scene.camera import Ray
from ..scene.scene import Scene
from ..scene.settings import RenderSettings
from ..tracing.cone import RayCone, pixel_cones
from ..tracing.context import TraceContext, build_context
from ..tracing.differential import Differential
from ..tracing.hit import Hit, Surface
from ..tracing.material import surface_tint
from ..tracing.path import all_turns, continues, first_path, next_path, turn_number
from ..tracing.queries import closest_hit
from ..tracing.surface import surface_at
from ..xla.jit import compiled
from .samples import eye_differentials, sample_positions, sample_rays

T = TypeVar("T")

# Rays are traced this many at a time, and pixels with edges: always as many, so that pictures of
# any size share their programs. Larger chunks waste more in the last one.
_RAYS, _EDGE_PIXELS = 1 << 14, 1 << 11


class PointSample(eqx.Module):
    """Points that single rays see, with all that shading needs but materials and lights."""

    hit: Hit  #: -1 where the background is seen
    surface: Surface
    direction: Vec  #: of the ray
    tint: Vec | None  #: see `surface_tint`; None for white


class LayerSample(eqx.Module):
    """Layers that cover parts of pixels, with all that shading needs but materials and lights."""

    layer: VisibleLayer
    tint: Vec | None


class Contribution(NamedTuple):
    """How samples count: in which pixel, by how much, and through which mirrors and bubbles."""

    pixel: Int[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]
    turns: Int[np.ndarray, "bounces n"]  #: factors of the weight, numbers in `all_turns`


class ShadingSamples(NamedTuple):
    """All samples of a picture, in NumPy arrays whose last axis is that of samples."""

    points: PointSample
    point_contribution: Contribution
    layers: LayerSample | None  #: None where edges are not covered
    layer_contribution: Contribution
    edge: Bool[np.ndarray, "height width"]  #: where there may be edges


class _Way(NamedTuple):
    """Where rays go on from what they meet."""

    alive: Mask
    turn: Ids
    ray: Ray | Differential[Ray]
    source_hit: Hit
    cone: RayCone | None


class _Front(NamedTuple):
    """Rays of one bounce, on the host, and how what they see counts."""

    ray: Any
    source_hit: Any
    cone: Any
    contribution: Contribution

    def kept(self, mask: np.ndarray) -> "_Front":
        return _take(self, np.flatnonzero(mask))


def trace_samples(scene: Scene, settings: RenderSettings) -> ShadingSamples:
    """Traces a picture's shading samples, from the host."""
    return _Tracer(scene, settings).trace()


class _Tracer:
    """The state of `trace_samples`: the samples found so far."""

    def __init__(self, scene: Scene, settings: RenderSettings):
        self.context = _context(scene, settings)
        self.settings, self.free_turns = settings, settings.needs.dark_paths
        self.turns = np.asarray(_turns(self.context))
        self.points: list[tuple[Any, Contribution]] = []
        self.layers: list[tuple[Any, Contribution]] = []
        self.edge = np.zeros(settings.width * settings.height, bool)

    def trace(self) -> ShadingSamples:
        settings = self.settings
        pixels = np.arange(self.edge.size, dtype=np.int32)
        positions = sample_positions(self.context.scene, settings)
        for left, top in zip(*(np.asarray(p) for p in positions), strict=True):
            self._trace_sample(pixels, left, top)
        shape = settings.height, settings.width
        points, point_contribution = _concatenate(self.points)
        layers, layer_contribution = _concatenate(self.layers) if self.layers else (None, _nowhere())
        return ShadingSamples(
            points, point_contribution, layers, layer_contribution, self.edge.reshape(shape)
        )

    def _trace_sample(self, pixels: np.ndarray, left: np.ndarray, top: np.ndarray) -> None:
        """Traces one sample of each pixel: single rays, and areas where they may meet edges."""
        weight = np.full(pixels.size, self.settings.samples**-2, self.context.dtype)
        none = np.full((self.settings.bounces, pixels.size), len(self.turns) - 1, np.int32)
        contribution = Contribution(pixels, weight, none)
        look = lambda pixels: _look_from_eye(self.context, pixels, left, top)
        met = _in_chunks(look, pixels, _RAYS)
        front, found = None, []
        edge = met.edge.copy()
        for bounce in range(self.settings.bounces + 1):
            if front is not None:
                where = front.contribution.pixel
                met = self._meet(front, bounce)
                edge[where[met.edge]] = True
                contribution = front.contribution
            found.append((met.point, met.seen, contribution))
            if bounce == self.settings.bounces:
                break
            front = self._onward(met.ways, contribution, bounce)
            if not front.contribution.pixel.size:
                break
        for point, seen, contribution in found:
            at = np.flatnonzero(seen & ~edge[contribution.pixel])
            self.points.append(_take((point, contribution), at))
        self.edge |= edge
        if edge.any():
            self._cover(pixels[edge], left, top)

    def _meet(self, front: _Front, bounce: int) -> Any:
        """Returns what the rays of a bounce after the first hit meet."""
        look = np.asarray(bounce == 1)
        meet = lambda rays: _meet(self.context, *rays, look)
        return _in_chunks(meet, (front.ray, front.source_hit, front.cone), _RAYS)

    def _onward(self, ways: tuple[Any, ...], contribution: Contribution, bounce: int) -> _Front:
        """Returns the rays on from what others met, as they count."""
        fronts = []
        for way in ways:
            on = self._turned(contribution, way.turn, bounce)
            front = _Front(way.ray, way.source_hit, way.cone, on)
            fronts.append(front.kept(way.alive))
        return _concatenate(fronts)

    def _turned(self, contribution: Contribution, turn: np.ndarray, bounce: int) -> Contribution:
        """Returns how what is seen counts beyond a mirror or a bubble."""
        pixel, weight, turns = contribution
        if not self.free_turns:
            return Contribution(pixel, weight * self.turns[turn], turns)
        turns = turns.copy()
        turns[bounce] = turn
        return Contribution(pixel, weight, turns)

    # -- edges

    def _cover(self, pixels: np.ndarray, left: np.ndarray, top: np.ndarray) -> None:
        """Covers pixels with edges by layers, and those in what they see first."""
        settings = self.settings
        weight = np.full(pixels.size, settings.samples**-2, self.context.dtype)
        none = np.full((settings.bounces, pixels.size), len(self.turns) - 1, np.int32)
        nothing = Hit(np.full(pixels.size, -1, self.context.tables.id_type), pixels < 0)
        look = lambda pixels: _eye_differentials(self.context, pixels, left, top)
        ray = _in_chunks(look, pixels, _EDGE_PIXELS)
        front = _Front(ray, nothing, None, Contribution(pixels, weight, none))
        for bounce in range(min(settings.bounces, 1) + 1):
            front = self._cover_front(front, bounce)
            if front is None:
                return
        # behind the second mirror or bubble single rays are followed
        front = front._replace(ray=_split(front.ray.value))
        for bounce in range(2, settings.bounces + 1):
            met = self._meet(front, bounce)
            at = np.flatnonzero(met.seen)
            self.points.append(_take((met.point, front.contribution), at))
            if bounce < settings.bounces:
                front = self._onward(met.ways, front.contribution, bounce)
            if not front.contribution.pixel.size:
                return

    def _cover_front(self, front: _Front, bounce: int) -> _Front | None:
        """Covers what rays with their differentials see; returns the rays on from there."""
        on: list[_Front] = []
        size = front.contribution.pixel.size
        for first in range(0, size, _EDGE_PIXELS):
            part = _take(front, np.arange(first, min(first + _EDGE_PIXELS, size)))
            layers = lambda inputs: _find_layers(self.context, *inputs)
            seen = _in_chunks(layers, (part.ray, part.source_hit), _EDGE_PIXELS)
            for k in range(seen.shown.shape[0]):
                at = np.flatnonzero(seen.shown[k] & (seen.area[k] > 0))
                if not at.size:
                    continue
                rays, contribution = _take((part.ray, part.contribution), at)
                weight = contribution.weight * seen.area[k][at]
                contribution = contribution._replace(weight=weight)
                sample = jax.tree.map(lambda x, k=k, at=at: x[k][..., at], seen.sample)
                self.layers.append((sample, contribution))
                if bounce < self.settings.bounces:
                    on += self._onward_from(rays, sample.layer.hit, contribution, bounce)
            if self.context.needs.background:
                contribution = part.contribution
                weight = contribution.weight * seen.uncovered[0]
                self.points.append((seen.sky, contribution._replace(weight=weight)))
        return _concatenate(on) if on else None

    def _onward_from(
        self, rays: Any, hit: Hit, contribution: Contribution, bounce: int
    ) -> Iterator[_Front]:
        """Yields the rays on from layers, with their differentials."""
        for choice in range(2 if self.context.needs.branching else 1):
            number = np.asarray(choice, np.int32)
            look = lambda inputs, n=number: _onward_from_layer(self.context, *inputs, n)
            way = _in_chunks(look, (rays, hit), _EDGE_PIXELS)
            turned = self._turned(contribution, way.turn, bounce)
            front = _Front(way.ray, way.source_hit, way.cone, turned).kept(way.alive)
            if front.contribution.pixel.size:
                yield front


# -- what is compiled


class _Met(NamedTuple):
    """What rays meet."""

    point: PointSample
    seen: Mask
    edge: Mask
    ways: tuple[_Way, ...]


class _Seen(NamedTuple):
    """The layers of pixels, and the sky behind them."""

    sample: LayerSample
    shown: Mask
    area: Array
    uncovered: Array  #: of shape `(1, pixels)`
    sky: PointSample | None


@compiled
def _context(scene: Scene, settings: RenderSettings) -> TraceContext:
    return build_context(scene, settings)


@compiled
def _turns(context: TraceContext) -> Float[Array, " turns"]:
    return all_turns(context)


@compiled
def _look_from_eye(context: TraceContext, pixels: Ids, left: Array, top: Array) -> _Met:
    scene, settings = context.scene, context.settings
    ray, cone = sample_rays(scene, settings, pixels, left, top), None
    if settings.antialias:
        side = scene.camera.window / settings.height * settings.side
        cone = pixel_cones(scene.camera, ray, side)
    return _met(context, ray, None, cone, jnp.array(True))


@compiled
def _meet(
    context: TraceContext, ray: Ray, source_hit: Hit, cone: RayCone | None, look: Mask
) -> _Met:
    return _met(context, ray, source_hit, cone, look)


def _met(
    context: TraceContext, ray: Ray, source_hit: Hit | None, cone: RayCone | None, look: Mask
) -> _Met:
    """Returns what rays meet, and the rays on. **Arguments:** `look`: whether to look for edges."""
    hit = closest_hit(context, ray, source_hit)
    nowhere = jnp.full(hit.id.shape, False)
    edge = nowhere
    if cone is not None:
        find = lambda: edge_mask(context, ray, cone, hit, source_hit)
        edge = lax.cond(look, find, lambda: nowhere)
    surface = surface_at(context, ray, hit)
    path, ways = first_path(ray, hit, ~nowhere, cone), []
    if context.settings.bounces:
        for choice in range(2 if context.needs.branching else 1):
            on = next_path(context, path, choice, surface)
            turn = turn_number(context, hit, choice)
            ways.append(_Way(continues(context, path, choice), turn, on.ray, on.hit, on.cone))
    point = PointSample(hit, surface, ray.direction, _tint(context, hit, surface, ray.direction))
    seen = ~nowhere if context.needs.background else hit.id >= 0
    return _Met(point, seen, edge, tuple(ways))


def _tint(context: TraceContext, hit: Hit, surface: Surface, direction: Vec) -> Vec | None:
    needs = context.needs
    if not (needs.textures or needs.planes or needs.background):
        return None
    return surface_tint(context, hit, surface, direction)


@compiled
def _eye_differentials(
    context: TraceContext, pixels: Ids, left: Array, top: Array
) -> Differential[Ray]:
    ray = eye_differentials(context, pixels, left, top)
    return spread(ray, pixels.shape)


@compiled
def _find_layers(context: TraceContext, ray: Differential[Ray], source_hit: Hit) -> _Seen:
    everywhere = jnp.full(ray.value.direction.x.shape, True)
    (layer, shown, area), uncovered = visible_layers(context, ray, everywhere, source_hit)
    direction = ray.value.direction
    tint = jax.vmap(lambda layer: _tint(context, layer.hit, layer.surface, direction))(layer)
    sky = None
    if context.needs.background:
        nothing = Hit(jnp.full_like(source_hit.id, -1), ~everywhere)
        surface = split(jax.tree.map(lambda x: jnp.zeros_like(x[0]), layer.surface))
        color = _tint(context, nothing, surface, direction)
        sky = PointSample(nothing, surface, split(direction), color)
    return _Seen(LayerSample(layer, tint), shown, area, uncovered[None], sky)


@compiled
def _onward_from_layer(
    context: TraceContext, ray: Differential[Ray], hit: Hit, choice: Index
) -> _Way:
    everywhere = jnp.full(hit.id.shape, True)
    on, path = secondary_differential(context, ray, hit, everywhere, choice)
    alive = continues(context, first_path(ray.value, hit, everywhere), choice)
    zero = jnp.zeros_like(ray.value.direction.x)
    return _Way(alive, turn_number(context, hit, choice), on, path.hit, RayCone(zero, zero))


# -- on the host


def _in_chunks(function: Callable[[Any], T], inputs: Any, size: int) -> T:
    """Applies a compiled function to samples, `size` at a time, and joins the results in NumPy."""
    count = jax.tree.leaves(inputs)[0].shape[-1]
    parts = []
    for first in range(0, max(count, 1), size):
        rows = np.minimum(np.arange(first, first + size), count - 1)
        parts.append((function(_take(inputs, rows)), min(size, count - first)))
    parts = [jax.tree.map(lambda x, n=n: np.asarray(x)[..., :n], part) for part, n in parts]
    return parts[0] if len(parts) == 1 else _concatenate(parts)


def _take(tree: T, rows: np.ndarray) -> T:
    return jax.tree.map(lambda x: np.asarray(x)[..., rows], tree)


def _concatenate(trees: list[T]) -> T:
    return jax.tree.map(lambda *x: np.concatenate(x, axis=-1), *trees)


def _split(ray: Ray) -> Ray:
    """Returns rays with split vectors, in NumPy."""
    return jax.tree.map(np.asarray, split(ray))


def _nowhere() -> Contribution:
    return Contribution(np.zeros(0, np.int32), np.zeros(0), np.zeros((0, 0), np.int32))
