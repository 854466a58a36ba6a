"""Which objects show in a pixel, from front to back: the discrete half of covered edges."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from ..base.safe_math import safe_sqrt
from ..base.types import Mask, PixelArray
from ..base.vec import dot, norm, where
from ..scene.camera import Ray
from ..scene.needs import Needs
from ..tracing.intersect import perpendicular
from ..tracing.queries import table_row
from ..tracing.tables import Hit, SceneTables
from ..xla.barriers import barrier
from ..xla.loops import loop
from .differential import Differential
from .polygon import contain_pixel
from .silhouette import mean_surface, silhouette_distance, surface_crossing

#: Layers of one pixel; the last one is taken to cover all that is left of it.
MOST_LAYERS = 8


class Layer(eqx.Module):
    """What shows in a pixel, the discrete half."""

    hit: Hit
    behind: Hit | None  #: the layer behind it, where surfaces may cut one another


class Candidate(eqx.Module):
    """An object that covers some of a pixel."""

    hit: Hit
    t: PixelArray  #: how deep it lies
    covers_all: Mask


def peel_layers(
    world: SceneTables, beam: Differential[Ray], needs: Needs, alive: Mask, leaving: Hit | None
) -> tuple[Layer, Mask]:
    """The layers from front to back, stacked, and which pixels have them; without derivatives."""
    world, beam = lax.stop_gradient((world, beam))
    no = jnp.full(alive.shape, False)
    none = Hit(jnp.full(alive.shape, -1, world.id_type), no)
    start = Candidate(none, jnp.zeros(alive.shape, world.window.dtype), no)

    def two_more(state: tuple[Candidate, Mask], _: None) -> tuple:
        def look() -> tuple:
            found = next_layers(world, beam, needs, state[0], leaving)
            layers, shown, some = [], [], state[1]
            for k in range(2):
                behind = found[k + 1].hit if needs.crossings else None
                layers.append(Layer(found[k].hit, behind))
                shown.append(some & (found[k].hit.id >= 0))
                some = shown[k] & ~found[k].covers_all
                if needs.crossings:
                    rim = silhouette_distance(world, beam, found[k].hit, needs)
                    surface = mean_surface(world, beam, found[k].hit, rim, needs)
                    cut = surface_crossing(world, beam, surface, found[k + 1].hit, needs)
                    some = some | shown[k] & ~contain_pixel((cut.ahead,))
            layers = jax.tree.map(lambda a, b: jnp.stack([a, b]), *layers)
            return (found[1], some), (layers, jnp.stack(shown))

        def stop() -> tuple:
            layer = Layer(none, none if needs.crossings else None)
            layers = jax.tree.map(lambda x: jnp.stack([x, x]), layer)
            return state, (layers, jnp.stack([no, no]))

        return lax.cond(jnp.any(state[1]), look, stop)

    layers = lax.scan(two_more, (start, alive), None, length=most_layers(world) // 2)[1]
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), layers)


def most_layers(world: SceneTables) -> int:
    """How many layers are looked for: an even number, as two are found at once."""
    most = min(MOST_LAYERS, world.spheres + world.planes + 1)
    return most + most % 2


def next_layers(
    world: SceneTables, beam: Differential[Ray], needs: Needs, last: Candidate, leaving: Hit | None
) -> list[Candidate]:
    """The nearest two objects, three where they may cut one another, behind the last one."""
    shape, dtype = last.t.shape, last.t.dtype

    def enter(best: list[Candidate], new: Candidate, covers: Mask) -> list[Candidate]:
        after = (new.t > last.t) | (new.t == last.t) & (new.hit.id > last.hit.id)
        # kept, or all of it is found again for each part of what is carried
        new, covers = barrier((new, covers & after & (new.t > 0)))
        before = [covers & (new.t < old.t) for old in best]
        here = [where(sooner, new, old) for sooner, old in zip(before, best, strict=True)]
        moved = zip(before, best, here[1:], strict=False)
        return [here[0], *(where(sooner, old, next_) for sooner, old, next_ in moved)]

    def found(number, inside: Mask, t: PixelArray, covers_all: Mask) -> Candidate:
        number = jnp.full(shape, number).astype(world.id_type)
        return Candidate(Hit(number, inside), t, covers_all)

    def sphere(i, best: list[Candidate]) -> list[Candidate]:
        ball = table_row(world.balls, i)
        foot = beam.map(lambda ray: perpendicular(ray.origin, ray.direction, ball.center))
        along, q = foot.value
        reach, length = (norm(foot.dx[1]) + norm(foot.dy[1])) / 2, norm(q)
        square = ball.radius * ball.radius - dot(q, q)
        half_chord = safe_sqrt(square)
        t, inside = along - half_chord, jnp.full(shape, False)
        covers, covers_all = length < ball.radius + reach, length + reach <= ball.radius
        own = inside if leaving is None else leaving.id == i
        if not needs.inside:
            return enter(best, found(i, inside, t, covers_all), covers & ~own)
        inside = (t <= 0) & (square > 0)
        if leaving is not None:
            covers, inside = covers & (~own | leaving.inside), inside | own
        t = jnp.where(inside, along + half_chord, t)
        return enter(best, found(i, inside, t, covers_all | inside), covers)

    def plane(i, best: list[Candidate]) -> list[Candidate]:
        flat = table_row(world.flats, i)
        slope = beam.map(lambda ray: dot(ray.direction, flat.normal))
        away = dot(flat.point - beam.value.origin, flat.normal)
        side = jnp.where(away < 0, -1, 1).astype(dtype)
        reach = (jnp.abs(slope.dx) + jnp.abs(slope.dy)) / 2
        toward = side * slope.value
        t = jnp.abs(away) / jnp.maximum(toward, jnp.where(reach > 0, 0.1 * reach, 1))
        covers = (toward > -reach) & (away != 0)
        number = i + world.spheres
        if leaving is not None:
            covers = covers & (leaving.id != number)
        return enter(best, found(number, jnp.full(shape, False), t, toward >= reach), covers)

    none = found(
        -1, jnp.full(shape, False), jnp.full(shape, jnp.inf, dtype), jnp.full(shape, False)
    )
    best = loop(world.spheres, sphere, [none] * (3 if needs.crossings else 2), unroll=0)
    return loop(world.planes, plane, best, unroll=0) if needs.planes else best
