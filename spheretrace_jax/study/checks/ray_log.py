"""`RayRecord`: what a pixel's ray meets, bounce by bounce, with the numbers that decide there."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ...base.vec import components
from ...rendering.samples import sample_rays
from ...scene.camera import Ray
from ...scene.light import each_light
from ...scene.scene import Scene
from ...scene.settings import RenderSettings
from ...tracing.context import TraceContext, build_context
from ...tracing.path import Path, first_path, next_path, shade_path
from ...tracing.queries import closest_hit, light_visible
from ...tracing.shading import HIGHLIGHTS, lambert, power
from ...tracing.surface import surface_at
from ...xla.jit import compiled


class RayRecord(eqx.Module):
    """Where rays are at one bounce. Arrays of shape `(pixels, ...)`, or `(bounces, pixels, ...)`.

    Where `alive` is false the others mean nothing.
    """

    alive: Bool[Array, "*bounces pixels"]
    id: Int[Array, "*bounces pixels"]  #: the object that is met, -1 for none
    inside: Bool[Array, "*bounces pixels"]  #: whether it is a sphere met from inside
    lit: Bool[Array, "*bounces pixels lights"]  #: whether no other object is in a light's way
    turned: Bool[Array, "*bounces pixels lights"]  #: whether N.L > 0
    cos_view: Float[Array, "*bounces pixels"]  #: N.V
    steep: Float[Array, "*bounces pixels"]  #: n / (R.V): by what the highlight's errors grow
    shine: Float[Array, "*bounces pixels"]  #: what of the colour is highlights
    color: Float[Array, "*bounces pixels 3"]  #: what the hit adds to the picture
    origin: Float[Array, "*bounces pixels 3"]  #: where the ray comes from
    direction: Float[Array, "*bounces pixels 3"]
    point: Float[Array, "*bounces pixels 3"]  #: where it meets the object


@compiled
def log_rays(
    scene: Scene,
    settings: RenderSettings,
    pixels: Int[Array, " pixels"],
    left: Float[Array, ""],
    top: Float[Array, ""],
    choice: int = 0,
) -> RayRecord:
    """Records all hits of one ray through each of some pixels, in the scene's own precision.

    **Arguments:** `pixels`: numbered row by row. `left`, `top`: where in a pixel the ray is, in
    pixels. `choice`: 0 to follow reflections where objects also transmit, 1 to go straight on.
    """
    context = build_context(scene, settings, accelerated=False)
    ray = sample_rays(scene, settings, pixels, left, top)
    to_pixels = lambda x: jnp.broadcast_to(x, pixels.shape)
    ray = Ray(jax.tree.map(to_pixels, ray.origin), ray.direction)
    start = first_path(ray, closest_hit(context, ray), jnp.full(pixels.shape, True))

    def bounce(path: Path, _: None) -> tuple[Path, RayRecord]:
        record = _record(context, path)
        path = next_path(context, path, choice)
        hit = closest_hit(context, path.ray, path.hit)
        return eqx.tree_at(lambda p: p.hit, path, hit), record

    if not settings.bounces:
        return jax.tree.map(lambda x: x[None], _record(context, start))
    return lax.scan(bounce, start, None, settings.bounces + 1)[1]


def _record(context: TraceContext, path: Path) -> RayRecord:
    """Records what the rays of paths meet."""
    ray, hit, lights = path.ray, path.hit, context.scene.lights
    surface = surface_at(context, ray, hit)
    ks, exponent = context.material(hit.id, lambda m: (m.ks, m.exponent))
    lit, turned, shine, grown = [], [], jnp.zeros_like(ks), jnp.zeros_like(ks)
    each = each_light(lights, context.needs.falloff)
    for light, light_color in zip(each, lights.color, strict=True):
        to_light = light.direction(surface.point)
        lit.append((hit.id >= 0) & light_visible(context, surface.point, hit, light))
        turned.append(lambert(surface, to_light) > 0)
        cosine = HIGHLIGHTS[context.settings.highlight].cosine(surface, to_light, ray.direction)
        shows = lit[-1] & turned[-1] & (cosine > 0)
        seen = jnp.where(shows, power(cosine, exponent), 0) * ks * jnp.max(light_color)
        seen = light.faded(surface.point, seen)
        shine = shine + seen
        grown = grown + seen * exponent / jnp.where(shows, cosine, 1)
    masks = lambda of: jnp.stack(of, -1) if of else jnp.zeros((*ks.shape, 0), bool)
    rows = lambda v: jnp.stack(jnp.broadcast_arrays(*components(v), ks)[:3], -1)
    return RayRecord(
        alive=path.alive,
        id=jnp.where(path.alive, hit.id, -1).astype(jnp.int32),
        inside=hit.inside,
        lit=masks(lit),
        turned=masks(turned),
        cos_view=surface.cos_view,
        steep=grown / jnp.where(shine > 0, shine, 1),
        shine=shine * path.weight,
        color=rows(shade_path(context, path)),
        origin=rows(ray.origin),
        direction=rows(ray.direction),
        point=rows(surface.point),
    )
