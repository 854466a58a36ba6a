"""Paths of rays: what a ray sees where it meets an object, and where the path goes on.

The lecture's formulas with the rows of the objects met: what jax differentiates.
"""

from functools import partial

import equinox as eqx
import jax.numpy as jnp
from jax import lax

from ..antialiasing.edge_mask import RayCone, next_cone
from ..base.types import Index, Mask, PixelArray
from ..base.vec import Vec, grey, reflect, where, zeros
from ..scene.camera import Ray
from ..scene.needs import Needs
from ..scene.scene import Scene
from ..scene.settings import RenderSettings
from ..xla.barriers import compute_once, compute_pair_once
from ..xla.rematerialization import save_residuals
from .material import background_color, local_color, sum_lights
from .queries import light_visible
from .shading import light_terms
from .tables import Hit, SceneTables, Surface, surface_at


class Path(eqx.Module):
    """Where a path is after some bounces."""

    ray: Ray
    hit: Hit  #: what the ray meets
    weight: PixelArray  #: what its colour counts: the product of the kgr and kt so far
    alive: Mask  #: whether there is a ray at all
    cone: RayCone | None  #: how wide the pixel is; None if edges do not matter any more


def shade_path(scene: Scene, world: SceneTables, path: Path, settings: RenderSettings) -> Vec:
    """What a path's present hit adds to the picture."""
    needs, ray, hit = settings.needs, path.ray, path.hit
    terms = partial(light_terms_at, world, ray, hit, settings)
    sums = sum_lights(scene, hit.id.shape, needs, terms)

    def seen_color() -> Vec:
        surface = surface_at(world, ray, hit, needs)
        color, seen = local_color(scene, world, hit, surface, needs, sums), path.alive
        if needs.background:
            color = where(hit.id >= 0, color, background_color(scene, ray.direction))
        else:
            seen = seen & (hit.id >= 0)
        return where(seen, color * path.weight, zeros(path.weight.shape, scene.dtype))

    if needs.colors:
        return compute_once(seen_color, world.window)
    return grey(compute_once(lambda: seen_color().x, world.window))


def light_terms_at(
    world: SceneTables,
    ray: Ray,
    hit: Hit,
    settings: RenderSettings,
    light: Vec,
    shadows: bool,
    exponent: PixelArray | None = None,
) -> tuple[PixelArray, PixelArray]:
    """N.L and the highlight of one light where rays meet objects, 0 where it does not reach.

    **Arguments:** `shadows`: whether objects may stand in its way. `exponent`: None for that of
    the objects.
    """
    needs = settings.needs
    highlight = settings.highlight if needs.highlights else None
    lit = hit.id >= 0
    if shadows:

        def sees_light() -> Mask:
            point = surface_at(world, ray, hit, needs).point
            return light_visible(world, point, hit, light, needs)

        lit = lit & save_residuals(compute_once(sees_light, world.window))

    def terms() -> tuple[PixelArray, PixelArray]:
        surface = surface_at(world, ray, hit, needs)
        n = world.material(hit.id, lambda m: m.exponent) if exponent is None else exponent
        return light_terms(surface, ray.direction, light, n, lit, highlight)

    return compute_pair_once(terms, world.window) if highlight else terms()


def _turn(
    world: SceneTables, hit: Hit, needs: Needs, choice: Index
) -> tuple[Mask | None, PixelArray]:
    """Whether paths go straight on, None for none, and the kgr or kt of the way they take."""
    kgr, kt = world.material(hit.id, lambda m: (m.kgr, m.kt))
    if not needs.transmission:
        return None, kgr
    if not needs.reflection:
        return jnp.full(kt.shape, True), kt
    straight = jnp.full(kt.shape, choice == 1) if needs.branching else lax.stop_gradient(kt) != 0
    return straight, jnp.where(straight, kt, kgr)


def continues(world: SceneTables, path: Path, needs: Needs, choice: Index) -> Mask:
    """Which paths do not end at their present hit."""
    return _alive(path, path.weight * _turn(world, path.hit, needs, choice)[1], needs)


def _alive(path: Path, weight: PixelArray, needs: Needs) -> Mask:
    """Which paths go on. **Arguments:** `weight`: theirs from there on."""
    alive = path.alive & (path.hit.id >= 0)
    return alive if needs.dark_paths else alive & (lax.stop_gradient(weight) != 0)


def next_path(
    world: SceneTables,
    path: Path,
    needs: Needs,
    choice: Index,
    surface: Surface | None = None,
) -> Path:
    """The path mirrored in what it hits, or straight on through that, with its weight.

    The ray straight on skips the object (a bubble without refraction); see `nearest`.

    **Arguments:** `choice`: where an object both reflects and transmits, 0 to reflect. `surface`:
    None for where the path's ray meets the object.
    """
    surface = surface_at(world, path.ray, path.hit, needs) if surface is None else surface
    straight, part = _turn(world, path.hit, needs, choice)
    weight = path.weight * part
    alive = _alive(path, weight, needs)
    direction = reflect(path.ray.direction, surface.normal)
    hit = path.hit
    if straight is not None:
        direction = where(straight, path.ray.direction, direction)
        hit = Hit(hit.id, hit.inside & ~straight)
    cone = path.cone
    if cone is not None:
        mirrored = jnp.full(weight.shape, True) if straight is None else ~straight
        cone = next_cone(cone, world, path.ray, path.hit, surface, mirrored)
    return Path(Ray(surface.point, direction), hit, weight, alive, cone)
