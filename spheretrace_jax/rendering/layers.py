"""Layers: depth, normal, object and coverage of each pixel, besides its colour."""

import dataclasses
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.sharding import NamedSharding
from jaxtyping import Array, Float, Int

from ..base.types import Ids, Picture, PixelArray
from ..base.vec import dot, where, zeros
from ..scene.camera import Ray
from ..scene.lights import Lights
from ..scene.needs import Needs, needs_of
from ..scene.planes import BackPlane, Planes
from ..scene.scene import Scene, check_scene
from ..scene.settings import RenderSettings, render_settings
from ..scene.spheres import Spheres
from ..tracing.context import TraceContext, build_context
from ..tracing.queries import closest_hit
from ..tracing.surface import surface_at
from ..xla.jit import compiled
from ..xla.sharding import on_devices, replicate
from .pixel_filter import interleave
from .render import draw
from .samples import sample_positions, trace_strips

# What a picture of black objects before a white background does not need.
_NOT_NEEDED = (
    "shadows", "highlights", "reflection", "transmission", "branching", "dark_paths", "textures",
    "checkers", "tinted", "colors", "coated", "falloff",
)  # fmt: skip


class Layers(eqx.Module):
    """What pixels show besides colour, row 0 at the top.

    Depth, normal and object are those of the ray through the pixel's centre, at its first hit.
    """

    depth: Float[Array, "height width"]  #: along the ray from its start, world units; inf for none
    normal: Float[Array, "height width 3"]  #: of unit length, world axes, towards the eye; or 0
    object: Int[Array, "height width"]  #: spheres from 0, planes, the back plane; -1 for none
    coverage: Float[Array, "height width"]  #: the part of the pixel that shows objects, 0..1


def render_layers(
    scene: Scene,
    *,
    width: int = 512,
    height: int = 512,
    samples: int = 1,
    needs: Needs | None = None,
    sharding: NamedSharding | None = None,
) -> Layers:
    """Renders depth, normal, object number and coverage: pictures besides that of `render`.

    A pure function for jit and vmap, compiled once per shape and need of the scene. Depth and
    normal are differentiable in spheres, planes and camera, for as long as the pixel shows the same
    object. Coverage is differentiable in these where the scene's antialias flag is 1: it is then
    the exact area inside of silhouettes and horizons, as in `render`. Where the flag is 0, it is
    the part of the samples that hit an object, without derivative. Numbers of objects have none.

    **Arguments:** `width`, `height`, `needs`, `sharding`: as for `render`; a pixel here is the same
    pixel there. `samples`: k for the coverage of k x k parts of each pixel.

    **Returns:** `Layers` of shape `(height, width)`, in the scene's dtype, the objects in int32.

    **Raises:** `InputError` as `render` does.
    """
    scene = check_scene(scene)
    needs = needs_of(scene) if needs is None else needs
    settings = partial(render_settings, scene, width, height, bounces=0, sharding=sharding)
    of_points = settings(needs=needs)
    flat = dataclasses.replace(needs, background=True, **dict.fromkeys(_NOT_NEEDED, False))
    of_coverage = settings(samples=samples, needs=flat)
    with jax.debug_infs(False):  # where nothing is hit the depth is infinite on purpose
        return _draw_layers(replicate(scene, of_points.sharding), of_points, of_coverage)


@compiled
def _draw_layers(scene: Scene, settings: RenderSettings, of_coverage: RenderSettings) -> Layers:
    if settings.sharding is None:
        points = _draw_points(scene, settings)
    else:
        of_device = lambda inputs, _: _draw_points(*inputs)
        points = on_devices(of_device, settings.sharding, (scene, settings.of_device))
        points = jax.tree.map(lambda x: x[: settings.height], points)
    depth, normal, number = points
    return Layers(depth, normal, number, 1 - draw(_silhouettes(scene), of_coverage)[..., 0])


def _draw_points(scene: Scene, settings: RenderSettings) -> tuple[PixelArray, Picture, Ids]:
    """Returns depth, normal and object of the pixels' centres, row by row."""
    context = build_context(scene, settings)
    left, top = sample_positions(scene, settings)
    return trace_strips(context, left[0], top[0], _first_points)


def _first_points(context: TraceContext, ray: Ray) -> tuple[PixelArray, Picture, Ids]:
    """Returns depth, normal and object of the points that rays from the eye hit first."""
    hit = closest_hit(context, ray)
    surface, hits = surface_at(context, ray, hit), hit.id >= 0
    depth = jnp.where(hits, dot(surface.point - ray.origin, ray.direction), jnp.inf)
    normal = where(hits, surface.normal, zeros(hits.shape, context.dtype))
    return depth, interleave(normal), hit.id.astype(jnp.int32)


def _silhouettes(scene: Scene) -> Scene:
    """Returns the scene in black before a white background, without lights."""
    black, spheres, planes = (0.0, 0.0, 0.0), scene.spheres, scene.planes
    return Scene(
        Spheres(spheres.center, spheres.radius, black),
        Lights(jnp.zeros((0, 3), scene.dtype)),
        scene.camera,
        Planes(planes.point, planes.normal, black),
        background=(1.0, 1.0, 1.0),
        back_plane=None if scene.back_plane is None else BackPlane(black),
        antialias=scene.antialias,
    )
