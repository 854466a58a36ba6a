"""The tracer of shading samples: bounce by bounce, from the host, so that only paths that go on are
traced.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np

from ..scene.scene import Scene
from ..scene.settings import RenderSettings
from ..tracing.hit import Hit
from .shading_samples import (
    Contribution,
    ShadingSamples,
    eye_rays,
    eye_rays_with_differentials,
    find_layers,
    meet,
    onward_from_layer,
    sample_context,
    split_rays,
    take,
)

T = TypeVar("T")

# Rays are traced this many at a time, and pixels with edges: always as many, so that pictures of
# any size share their programs. Larger chunks waste more in the last one.
_RAYS, _EDGE_PIXELS = 1 << 14, 1 << 11


class _Front(NamedTuple):
    """Rays of one bounce, on the host, and how what they see counts."""

    ray: Any
    source_hit: Any
    cone: Any
    contribution: Contribution

    def kept(self, mask: Any) -> "_Front":
        return take(self, np.flatnonzero(mask))


def trace_samples(scene: Scene, settings: RenderSettings) -> ShadingSamples:
    """Traces a picture's shading samples, from the host."""
    return _Tracer(scene, settings).trace()


class _Tracer:
    """The state of `trace_samples`: the samples found so far."""

    def __init__(self, scene: Scene, settings: RenderSettings):
        self.context, turns, positions = sample_context(scene, settings)
        self.settings, self.free_turns = settings, settings.needs.dark_paths
        self.turns, self.positions = np.asarray(turns), [np.asarray(p) for p in positions]
        self.points: list[tuple[Any, Contribution]] = []
        self.layers: list[tuple[Any, Contribution]] = []
        self.edge = np.zeros(settings.width * settings.height, bool)

    def trace(self) -> ShadingSamples:
        settings = self.settings
        pixels = np.arange(self.edge.size, dtype=np.int32)
        for left, top in zip(*self.positions, strict=True):
            self._trace_sample(pixels, left, top)
        shape = settings.height, settings.width
        points, point_contribution = _concatenate(self.points)
        layers, layer_contribution = (
            _concatenate(self.layers) if self.layers else (None, _nowhere())
        )
        return ShadingSamples(
            points, point_contribution, layers, layer_contribution, self.edge.reshape(shape)
        )

    def _trace_sample(self, pixels: np.ndarray, left: Any, top: Any) -> None:
        """Traces one sample of each pixel: single rays, and areas where they may meet edges."""
        look = lambda pixels: eye_rays(self.context, pixels, left, top)
        ray, cone = _in_chunks(look, pixels, _RAYS)
        front = _Front(ray, self._from_eye(pixels), cone, self._contribution(pixels))
        edge, found = np.zeros(pixels.size, bool), []
        for bounce in range(self.settings.bounces + 1):
            met, contribution = self._meet(front, bounce), front.contribution
            edge[contribution.pixel[met.edge]] = True
            found.append((met.point, met.seen, contribution))
            if bounce == self.settings.bounces:
                break
            front = self._onward(met.ways, contribution, bounce)
            if not front.contribution.pixel.size:
                break
        for point, seen, contribution in found:
            at = np.flatnonzero(seen & ~edge[contribution.pixel])
            self.points.append(take((point, contribution), at))
        self.edge |= edge
        if edge.any():
            self._cover(pixels[edge], left, top)

    def _contribution(self, pixels: np.ndarray) -> Contribution:
        """Returns how one sample of pixels counts that is seen directly."""
        weight = np.full(pixels.size, self.settings.samples**-2, self.context.dtype)
        no_turn = np.full((self.settings.bounces, pixels.size), len(self.turns) - 1, np.int32)
        return Contribution(pixels, weight, no_turn)

    def _from_eye(self, pixels: np.ndarray) -> Hit:
        """Returns the hits that rays from the eye start from: none."""
        nothing = np.full(pixels.size, -1, self.context.tables.id_type), pixels < 0
        return Hit(*jax.device_put(nothing))

    def _meet(self, front: _Front, bounce: int) -> Any:
        """Returns what the rays of a bounce meet."""
        look = jax.device_put(np.asarray(bounce <= 1))
        trace = lambda rays: meet(self.context, rays[0], rays[1], rays[2], look)
        return _in_chunks(trace, (front.ray, front.source_hit, front.cone), _RAYS)

    def _onward(self, ways: tuple[Any, ...], contribution: Contribution, bounce: int) -> _Front:
        """Returns the rays on from what others met, as they count."""
        fronts = []
        for way in ways:
            on = self._turned(contribution, way.turn, bounce)
            front = _Front(way.ray, way.source_hit, way.cone, on)
            fronts.append(front.kept(way.alive))
        return _concatenate(fronts)

    def _turned(self, contribution: Contribution, turn: Any, bounce: int) -> Contribution:
        """Returns how what is seen counts beyond a mirror or a bubble."""
        pixel, weight, turns = contribution
        if not self.free_turns:
            return Contribution(pixel, weight * self.turns[turn], turns)
        turns = turns.copy()
        turns[bounce] = turn
        return Contribution(pixel, weight, turns)

    # -- edges

    def _cover(self, pixels: np.ndarray, left: Any, top: Any) -> None:
        """Covers pixels with edges by layers, and those in what they see first."""
        settings = self.settings
        look = lambda pixels: eye_rays_with_differentials(self.context, pixels, left, top)
        ray = _in_chunks(look, pixels, _EDGE_PIXELS)
        front = _Front(ray, self._from_eye(pixels), None, self._contribution(pixels))
        for bounce in range(min(settings.bounces, 1) + 1):
            front = self._cover_front(front, bounce)
            if front is None:
                return
        # behind the second mirror or bubble single rays are followed
        front = front._replace(ray=_in_chunks(split_rays, front.ray, _EDGE_PIXELS))
        for bounce in range(2, settings.bounces + 1):
            met = self._meet(front, bounce)
            at = np.flatnonzero(met.seen)
            self.points.append(take((met.point, front.contribution), at))
            if bounce < settings.bounces:
                front = self._onward(met.ways, front.contribution, bounce)
            if not front.contribution.pixel.size:
                return

    def _cover_front(self, front: _Front, bounce: int) -> _Front | None:
        """Covers what rays with their differentials see; returns the rays on from there."""
        met: list[tuple[Any, Hit, Contribution]] = []
        size = front.contribution.pixel.size
        for first in range(0, size, _EDGE_PIXELS):  # layers are many: kept only where they show
            part = take(front, np.arange(first, min(first + _EDGE_PIXELS, size)))
            layers = lambda rays: find_layers(self.context, *rays)
            seen = _in_chunks(layers, (part.ray, part.source_hit), _EDGE_PIXELS)
            for k in range(seen.shown.shape[0]):
                at = np.flatnonzero(seen.shown[k] & (seen.area[k] > 0))
                rays, contribution = take((part.ray, part.contribution), at)
                weight = contribution.weight * seen.area[k][at]
                contribution = contribution._replace(weight=weight)
                sample = take(jax.tree.map(lambda x, k=k: x[k], seen.sample), at)
                self.layers.append((sample, contribution))
                met.append((rays, sample.layer.hit, contribution))
            if self.context.needs.background:
                contribution = part.contribution
                weight = contribution.weight * seen.uncovered[0]
                self.points.append((seen.sky, contribution._replace(weight=weight)))
        rays, hit, contribution = _concatenate(met)
        if bounce == self.settings.bounces or not contribution.pixel.size:
            return None
        front = _concatenate(list(self._onward_from(rays, hit, contribution, bounce)))
        return front if front.contribution.pixel.size else None

    def _onward_from(
        self, rays: Any, hit: Hit, contribution: Contribution, bounce: int
    ) -> Iterator[_Front]:
        """Yields the rays on from layers, with their differentials."""
        for choice in range(2 if self.context.needs.branching else 1):
            number = jax.device_put(np.asarray(choice, np.int32))
            look = lambda rays, n=number: onward_from_layer(self.context, rays[0], rays[1], n)
            way = _in_chunks(look, (rays, hit), _EDGE_PIXELS)
            turned = self._turned(contribution, way.turn, bounce)
            yield _Front(way.ray, way.source_hit, way.cone, turned).kept(way.alive)


# -- on the host


def _in_chunks(function: Callable[[Any], T], inputs: Any, size: int) -> T:
    """Applies a compiled function to samples, `size` at a time, and joins the results in NumPy."""
    count = jax.tree.leaves(inputs)[0].shape[-1]
    parts = []
    for first in range(0, max(count, 1), size):
        rows = np.minimum(np.arange(first, first + size), count - 1)
        parts.append((function(take(inputs, rows)), min(size, count - first)))
    parts = [jax.tree.map(lambda x, n=n: np.asarray(x)[..., :n], part) for part, n in parts]
    return parts[0] if len(parts) == 1 else _concatenate(parts)


def _concatenate(trees: list[T]) -> T:
    return jax.tree.map(lambda *x: np.concatenate(x, axis=-1), *trees)


def _nowhere() -> Contribution:
    return Contribution(np.zeros(0, np.int32), np.zeros(0, np.float32), np.zeros((0, 0), np.int32))
