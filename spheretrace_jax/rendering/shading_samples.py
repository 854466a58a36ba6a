"""Shading samples: a picture's geometry, traced once (the G-buffer of deferred shading).

What a pixel shows is a weighted sum over samples: points that single rays meet, and layers that
cover edges (Saito and Takahashi, "Comprehensible Rendering of 3-D Shapes", SIGGRAPH 1990). Where
geometry and camera stay, samples stay, and only materials and lights are left to evaluate. Samples
are found from the host, bounce by bounce, so that only paths that go on are traced.
"""

from typing import NamedTuple, TypeVar

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


def take(tree: T, samples: np.ndarray) -> T:
    """Returns some samples of NumPy arrays whose last axis is that of samples."""
    return jax.tree.map(lambda x: np.asarray(x)[..., samples], tree)


class Way(NamedTuple):
    """Where rays go on from what they meet."""

    alive: Mask
    turn: Ids
    ray: Ray | Differential[Ray]
    source_hit: Hit
    cone: RayCone | None


class RaysMet(NamedTuple):
    """What rays meet."""

    point: PointSample
    seen: Mask
    edge: Mask
    ways: tuple[Way, ...]


class LayersSeen(NamedTuple):
    """The layers of pixels, and the sky behind them."""

    sample: LayerSample
    shown: Mask
    area: Array
    uncovered: Array  #: of shape `(1, pixels)`
    sky: PointSample | None


@compiled
def sample_context(
    scene: Scene, settings: RenderSettings
) -> tuple[TraceContext, Float[Array, " turns"], tuple[Array, Array]]:
    """Returns the context of a picture's samples, `all_turns`, and `samples.sample_positions`."""
    context = build_context(scene, settings)
    return context, all_turns(context), sample_positions(scene, settings)


@compiled
def eye_rays(
    context: TraceContext, pixels: Ids, left: Array, top: Array
) -> tuple[Ray, RayCone | None]:
    """Returns the rays of pixels, and their cones where edges are looked for.

    **Arguments:** as for `samples.sample_rays`.
    """
    scene, settings = context.scene, context.settings
    ray, cone = sample_rays(scene, settings, pixels, left, top), None
    if settings.antialias:
        side = scene.camera.window / settings.height * settings.side
        cone = pixel_cones(scene.camera, ray, side)
    return spread((ray, cone), pixels.shape)


@compiled
def meet(
    context: TraceContext, ray: Ray, source_hit: Hit, cone: RayCone | None, look: Mask
) -> RaysMet:
    """Returns what rays meet that start from hits, and the rays on.

    **Arguments:** `source_hit`: -1 for rays from the eye. `look`: whether to look for edges.
    """
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
            ways.append(Way(continues(context, path, choice), turn, on.ray, on.hit, on.cone))
    point = PointSample(hit, surface, ray.direction, _tint(context, hit, surface, ray.direction))
    seen = ~nowhere if context.needs.background else hit.id >= 0
    return RaysMet(point, seen, edge, tuple(ways))


def _tint(context: TraceContext, hit: Hit, surface: Surface, direction: Vec) -> Vec | None:
    needs = context.needs
    if not (needs.textures or needs.planes or needs.background):
        return None
    return surface_tint(context, hit, surface, direction)


@compiled
def eye_rays_with_differentials(
    context: TraceContext, pixels: Ids, left: Array, top: Array
) -> Differential[Ray]:
    """Returns the rays of pixels with their differentials. **Arguments:** as for `eye_rays`."""
    return spread(eye_differentials(context, pixels, left, top), pixels.shape)


@compiled
def find_layers(context: TraceContext, ray: Differential[Ray], source_hit: Hit) -> LayersSeen:
    """Returns the layers that rays see with all of their pixels."""
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
    return LayersSeen(LayerSample(layer, tint), shown, area, uncovered[None], sky)


@compiled
def onward_from_layer(
    context: TraceContext, ray: Differential[Ray], hit: Hit, choice: Index
) -> Way:
    """Returns the rays on from layers, with their differentials."""
    everywhere = jnp.full(hit.id.shape, True)
    on, path = secondary_differential(context, ray, hit, everywhere, choice)
    alive = continues(context, first_path(ray.value, hit, everywhere), choice)
    zero = jnp.zeros_like(ray.value.direction.x)
    return Way(alive, turn_number(context, hit, choice), on, path.hit, RayCone(zero, zero))


@compiled
def split_rays(ray: Differential[Ray]) -> Ray:
    """Returns rays without their differentials, as `meet` takes them."""
    return split(ray.value)
