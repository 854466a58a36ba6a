"""`Stop`: what the ray of a pixel meets, bounce by bounce, with the numbers that decide there."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..camera import Ray
from ..options import Options
from ..paths import Path, next_path, shade
from ..phases import compiled
from ..render import rays_through
from ..scene import Scene
from ..shading import HIGHLIGHTS, lambert, power, toward_light
from ..vec import parts, vec
from ..visibility import nearest, unoccluded
from ..world import World, build_world, surface_at


class Stop(eqx.Module):
    """Where rays are at one bounce. Arrays of shape `(pixels, ...)`, or `(bounces, pixels, ...)`.

    Where `alive` is false the others mean nothing.
    """

    alive: Bool[Array, "*bounces pixels"]
    id: Int[Array, "*bounces pixels"]  #: the object that is met, -1 for none
    inside: Bool[Array, "*bounces pixels"]  #: whether it is a sphere met from inside
    lit: Bool[Array, "*bounces pixels lights"]  #: whether no other object is in a light's way
    turned: Bool[Array, "*bounces pixels lights"]  #: whether N.L > 0
    facing: Float[Array, "*bounces pixels"]  #: N.V
    steep: Float[Array, "*bounces pixels"]  #: n / (R.V): by what the highlight's errors grow
    shine: Float[Array, "*bounces pixels"]  #: what of the colour is highlights
    color: Float[Array, "*bounces pixels 3"]  #: what the hit adds to the picture
    origin: Float[Array, "*bounces pixels 3"]  #: where the ray comes from
    direction: Float[Array, "*bounces pixels 3"]
    point: Float[Array, "*bounces pixels 3"]  #: where it meets the object


@compiled
def trail(
    scene: Scene,
    options: Options,
    pixels: Int[Array, " pixels"],
    left: Float[Array, ""],
    top: Float[Array, ""],
    choice: int = 0,
) -> Stop:
    """All stops of one ray through each of some pixels, in the scene's own precision.

    **Arguments:** `pixels`: numbered row by row. `left`, `top`: where in a pixel the ray is, in
    pixels. `choice`: 0 to follow reflections where objects also transmit, 1 to go straight on.
    """
    world, needs = build_world(scene), options.needs
    ray = rays_through(scene, options, pixels, left, top)
    whole = lambda x: jnp.broadcast_to(x, pixels.shape)
    ray = Ray(jax.tree.map(whole, ray.origin), ray.direction)
    one = jnp.ones_like(ray.direction.x)
    hit = nearest(world, ray, needs)
    start = Path(ray, hit, one, one > 0, None)

    def bounce(path: Path, _: None) -> tuple[Path, Stop]:
        stop = _stop(scene, world, path, options)
        on = next_path(world, path, needs, choice)
        return eqx.tree_at(lambda p: p.hit, on, nearest(world, on.ray, needs, on.hit)), stop

    if not options.bounces:
        return jax.tree.map(lambda x: x[None], _stop(scene, world, start, options))
    return lax.scan(bounce, start, None, options.bounces + 1)[1]


def _stop(scene: Scene, world: World, path: Path, options: Options) -> Stop:
    ray, hit, needs = path.ray, path.hit, options.needs
    surface = surface_at(world, ray, hit, needs)
    ks, exponent = world.material(hit.id, lambda m: (m.ks, m.exponent))
    lit, turned, shine, grown = [], [], jnp.zeros_like(ks), jnp.zeros_like(ks)
    for position, light_color in zip(scene.lights.position, scene.lights.color, strict=True):
        light = vec(position)
        to_light = toward_light(surface, light)
        lit.append((hit.id >= 0) & unoccluded(world, surface.point, hit, light, needs))
        turned.append(lambert(surface, to_light) > 0)
        cosine = HIGHLIGHTS[options.highlight](surface, to_light, ray.direction)
        shows = lit[-1] & turned[-1] & (cosine > 0)
        each = jnp.where(shows, power(cosine, exponent), 0) * ks * jnp.max(light_color)
        shine = shine + each
        grown = grown + each * exponent / jnp.where(shows, cosine, 1)
    masks = lambda of: jnp.stack(of, -1) if of else jnp.zeros((*ks.shape, 0), bool)
    rows = lambda v: jnp.stack(jnp.broadcast_arrays(*parts(v), ks)[:3], -1)
    return Stop(
        alive=path.alive,
        id=jnp.where(path.alive, hit.id, -1).astype(jnp.int32),
        inside=hit.inside,
        lit=masks(lit),
        turned=masks(turned),
        facing=surface.facing,
        steep=grown / jnp.where(shine > 0, shine, 1),
        shine=shine * path.weight,
        color=rows(shade(scene, world, path, options)),
        origin=rows(ray.origin),
        direction=rows(ray.direction),
        point=rows(surface.point),
    )
