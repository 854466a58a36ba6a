"""Paths of rays through mirrors and bubbles: what they see at each hit, and where they go on.

The lecture's formulas with the rows of the objects met: what JAX differentiates.
"""

from collections.abc import Callable
from functools import partial
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ..base.types import Ids, Index, Mask, PixelArray
from ..base.vec import Vec, grey, reflect, where, zeros
from ..scene.camera import Ray
from ..scene.light import Light
from ..scene.settings import RenderSettings
from ..xla.rematerialization import save_residuals
from .cone import RayCone, next_cone
from .context import TraceContext
from .hit import Hit, Surface
from .material import background_color, finish_of, local_color, sum_lights
from .queries import closest_hit, light_visible
from .shading import Finish, light_terms
from .surface import surface_at

T = TypeVar("T")


class Path(eqx.Module):
    """The state of paths after some bounces."""

    ray: Ray
    hit: Hit  #: what the ray meets
    weight: PixelArray  #: the product of kgr and kt so far, by which colours count
    alive: Mask  #: true where there is a ray at all
    cone: RayCone | None  #: how wide the pixel is; None if edges do not matter any more


def first_path(ray: Ray, hit: Hit, alive: Mask, cone: RayCone | None = None) -> Path:
    """Returns paths that begin with the rays to these hits."""
    return Path(ray, hit, jnp.ones(alive.shape, ray.direction.x.dtype), alive, cone)


def shade_path(context: TraceContext, path: Path) -> Vec:
    """Returns what the present hit of paths adds to the picture."""
    needs, ray, hit = context.needs, path.ray, path.hit
    sums = sum_lights(context, hit.id.shape, partial(light_terms_at, context, ray, hit))

    def color_seen() -> Vec:
        surface = surface_at(context, ray, hit)
        color, seen = local_color(context, hit, surface, sums), path.alive
        if needs.background:
            color = where(hit.id >= 0, color, background_color(context.scene, ray.direction))
        else:
            seen = seen & (hit.id >= 0)
        return where(seen, color * path.weight, zeros(path.weight.shape, context.dtype))

    if needs.colors:
        return context.compute_once(color_seen)
    return grey(context.compute_once(lambda: color_seen().x))


def light_terms_at(
    context: TraceContext,
    ray: Ray,
    hit: Hit,
    light: Light,
    shadows: bool,
    finish: Finish | None = None,
    surface: Surface | None = None,
) -> tuple[PixelArray, PixelArray]:
    """Returns N.L and the highlight of one light at hits, 0 where the light does not reach.

    **Arguments:** `shadows`: false where no object can stand in the light's way. `finish`: None
    for that of the objects. `surface`: None for that where the rays hit.
    """
    highlight = context.settings.highlight if context.needs.highlights else None
    lit = hit.id >= 0
    # found again in each phase, which is faster than to read it
    surface_of_hit = lambda: surface_at(context, ray, hit) if surface is None else surface
    if shadows:

        def sees_light() -> Mask:
            return light_visible(context, surface_of_hit().point, hit, light)

        lit = lit & save_residuals(context.compute_once(sees_light))

    def terms() -> tuple[PixelArray, PixelArray]:
        of_hit = finish_of(context, hit.id) if finish is None else finish
        return light_terms(surface_of_hit(), ray.direction, light, of_hit, lit, highlight)

    return context.compute_pair_once(terms) if highlight else terms()


def continues(context: TraceContext, path: Path, choice: Index | Ids) -> Mask:
    """Tests which paths do not end at their present hit."""
    return _alive(context, path, path.weight * _turn(context, path.hit, choice)[1])


def next_path(
    context: TraceContext, path: Path, choice: Index | Ids, surface: Surface | None = None
) -> Path:
    """Returns the path mirrored in what it hits, or straight on through that, with its weight.

    The ray straight on skips the object (a bubble without refraction); see `closest_hit`.

    **Arguments:** `choice`: where an object both reflects and transmits, 0 to reflect. `surface`:
    None for where the path's ray meets the object.
    """
    surface = surface_at(context, path.ray, path.hit) if surface is None else surface
    straight, part = _turn(context, path.hit, choice)
    weight = path.weight * part
    alive = _alive(context, path, weight)
    direction = reflect(path.ray.direction, surface.normal)
    hit = path.hit
    if straight is not None:
        direction = where(straight, path.ray.direction, direction)
        hit = Hit(hit.id, hit.inside & ~straight)
    cone = path.cone
    if cone is not None:
        mirrored = jnp.full(weight.shape, True) if straight is None else ~straight
        cone = next_cone(cone, path.ray, surface, context.curvature_of_hit(path.hit), mirrored)
    return Path(Ray(surface.point, direction), hit, weight, alive, cone)


def turn_number(context: TraceContext, hit: Hit, choice: Index | Ids) -> Ids:
    """Returns which of `all_turns` a path's weight is multiplied by as it goes on from a hit."""
    straight, _ = _turn(context, hit, choice)
    number = hit.id.astype(jnp.int32)
    if straight is None:
        return number
    return number + jnp.where(straight, context.tables.object_count, 0).astype(number.dtype)


def all_turns(context: TraceContext) -> Float[Array, " turns"]:
    """Returns kgr of all objects, then kt of all objects, then 1 for no turn."""
    materials = context.tables.materials
    return jnp.concatenate([materials.kgr, materials.kt, jnp.ones(1, context.dtype)])


def _turn(context: TraceContext, hit: Hit, choice: Index | Ids) -> tuple[Mask | None, PixelArray]:
    """Returns which paths go straight on, None for none, and the kgr or kt of the way they take."""
    needs = context.needs
    kgr, kt = context.material(hit.id, lambda m: (m.kgr, m.kt))
    if not needs.transmission:
        return None, kgr
    if not needs.reflection:
        return jnp.full(kt.shape, True), kt
    straight = jnp.full(kt.shape, choice == 1) if needs.branching else lax.stop_gradient(kt) != 0
    return straight, jnp.where(straight, kt, kgr)


def _alive(context: TraceContext, path: Path, weight: PixelArray) -> Mask:
    """Tests which paths go on. **Arguments:** `weight`: theirs from there on."""
    alive = path.alive & (path.hit.id >= 0)
    return alive if context.needs.dark_paths else alive & (lax.stop_gradient(weight) != 0)


def trace_path(context: TraceContext, path: Path) -> Vec:
    """Traces a few paths from where they are, bounce by bounce; returns their colours, or 0.

    `rendering.wavefront` finds all hits first, since a picture's paths are many and few go on; to
    do the work of each bounce at once is a third as much to compile.

    **Arguments:** `path`: just after a hit, which it leaves.
    """
    settings = context.settings

    def trace_sequence(color: Vec, choices: Int[Array, ""]) -> tuple[Vec, None]:
        def bounce(state: tuple[Path, Vec], number: Index) -> tuple[tuple[Path, Vec], None]:
            def go_on(path: Path, color: Vec) -> tuple[Path, Vec]:
                hit = closest_hit(context, path.ray, path.hit)
                path = eqx.tree_at(lambda p: p.hit, path, hit)
                adds = (choices >> number == 0).astype(context.dtype)  # see `fold_sequences`
                color = color + shade_path(context, path) * adds
                return next_path(context, path, choices >> number & 1), color

            stay = lambda *state: state
            return lax.cond(jnp.any(state[0].alive), go_on, stay, *state), None

        numbers = jnp.arange(settings.bounces + 1, dtype=jnp.int32)
        return lax.scan(bounce, (path, color), numbers)[0][1], None

    black = zeros(path.alive.shape, context.dtype)
    return fold_sequences(trace_sequence, black, settings)


def fold_sequences(
    step: Callable[[T, Int[Array, ""]], tuple[T, None]], start: T, settings: RenderSettings
) -> T:
    """Folds `step` over all sequences of choices between reflection and transmission.

    Where objects both reflect and transmit, a path is a sequence of choices, bit b of a number:
    reflect (0) or go straight on (1) at hit b. Sequences share beginnings, so hit b counts only in
    the one that chooses 0 from there on.
    """
    if not settings.needs.branching:
        return step(start, jnp.zeros((), jnp.int32))[0]
    numbers = jnp.arange(1 << settings.bounces, dtype=jnp.int32)
    return lax.scan(jax.checkpoint(step), start, numbers)[0]
