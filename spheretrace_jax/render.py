"""From a scene to a picture: paths of rays, strips of pixels, samples per pixel.

Each bounce has two halves. The discrete one finds, without derivatives, which object is met and
which lights reach it; the smooth one evaluates the lecture's formulas with those objects' rows and
is what jax differentiates.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ._types import Highlight, Mask, Picture, Plane
from .camera import Ray, pixel_rays
from .errors import InputError
from .needs import ANTIALIAS_SAMPLES, Needs, needs as needs_of
from .phases import STRIP_PIXELS, UNROLL, fetch, materialise_pair
from .scene import Scene
from .shading import HIGHLIGHTS, light_terms
from .texture import lookup, other_square, sphere_uv, worn
from .vec import Vec, reflect, vec, where
from .visibility import nearest, unoccluded
from .world import Hit, Material, Surface, World, build_world, surface_at

#: More samples along a pixel's side, or more bounces where paths branch, would never end.
MOST_SAMPLES, MOST_BRANCHINGS = 256, 16


class Options(eqx.Module):
    """What is static about a picture besides its scene."""

    width: int = eqx.field(static=True)
    height: int = eqx.field(static=True)
    highlight: Highlight = eqx.field(static=True)
    bounces: int = eqx.field(static=True)
    samples: int = eqx.field(static=True)
    needs: Needs = eqx.field(static=True)


class Path(eqx.Module):
    """Where a path is after some bounces."""

    ray: Ray
    hit: Hit  #: what the ray meets
    weight: Plane  #: what its colour counts: the product of the kgr and kt so far
    alive: Mask  #: whether there is a ray at all


def render(
    scene: Scene,
    *,
    width: int = 512,
    height: int = 512,
    highlight: Highlight = "phong",
    bounces: int = 5,
    samples: int | None = None,
    needs: Needs | None = None,
) -> Picture:
    """The picture of a scene: a pure function, differentiable in every array of the scene.

    Compiled once per shape and need of the scene; other numbers never compile again. Derivatives
    are those of the surfaces' colours: a point-sampled picture has none where edges move. For
    derivatives by ks, kgr or kt where they are 0, pass `needs(scene, free=("ks", "kgr", "kt"))`.

    **Arguments:**

    - `width`, `height`: the picture's size in pixels.
    - `highlight`: `"phong"` for (R.V)^n or `"blinn"` for (H.N)^n.
    - `bounces`: how many reflections and transmissions n a path goes through at most. Where an
      object both reflects and transmits, 2^n paths are followed.
    - `samples`: k for k x k rays per pixel on a regular grid; by default 2 where the scene's
      antialias flag is 1, else 1.
    - `needs`: what to compute, by default what `spheretrace_jax.needs(scene)` finds; to be given
      under jit, grad and vmap, where the scene's numbers are not known.

    **Returns:** linear RGB of shape `(height, width, 3)`, unclamped, in the scene's dtype. Row 0
    is the top.

    **Raises:** `InputError` for sizes, samples or bounces out of range and unknown highlights.
    """
    return _render(scene, options(scene, width, height, highlight, bounces, samples, needs))


def options(
    scene: Scene,
    width: int,
    height: int,
    highlight: Highlight = "phong",
    bounces: int = 5,
    samples: int | None = None,
    needs: Needs | None = None,
) -> Options:
    """Checks and completes the static arguments of `render`."""
    for name, value, least in (("width", width, 1), ("height", height, 1), ("bounces", bounces, 0)):
        if value < least:
            raise InputError(f"{name} must be at least {least}, got {value}")
    if samples is not None and not 1 <= samples <= MOST_SAMPLES:
        raise InputError(f"samples must be in 1..{MOST_SAMPLES}, got {samples}")
    if highlight not in HIGHLIGHTS:
        raise InputError(f"highlight must be one of {', '.join(HIGHLIGHTS)}, got {highlight!r}")
    needs = needs_of(scene) if needs is None else needs
    samples = samples or (ANTIALIAS_SAMPLES if needs.antialias else 1)
    bounces = bounces if needs.bounces else 0
    if needs.branching and bounces > MOST_BRANCHINGS:
        raise InputError(
            "where an object both reflects and transmits, n bounces follow 2^n paths: "
            f"bounces must be at most {MOST_BRANCHINGS}, got {bounces}"
        )
    return Options(width, height, highlight, bounces, samples, needs)


@eqx.filter_jit
def _render(scene: Scene, options: Options) -> Picture:
    world = build_world(scene)
    width, height, samples = options.width, options.height, options.samples
    strips = -(-width * height // STRIP_PIXELS)
    rows = -(-height // strips)
    strips = -(-height // rows)
    dtype = scene.dtype
    places = (jnp.arange(samples, dtype=dtype) + 0.5) / samples

    def strip(first_row: Int[Array, ""]) -> Float[Array, "rows width 3"]:
        def sample(total: Vec, place: tuple) -> tuple[Vec, None]:
            columns = jnp.arange(width, dtype=dtype) + place[0]
            lines = first_row.astype(dtype) + jnp.arange(rows, dtype=dtype) + place[1]
            ray = pixel_rays(scene.camera, columns, lines, (width, height))
            return total + radiance(scene, world, ray, options), None

        if samples == 1:
            color = sample(_zeros((rows, width), dtype), (places[0], places[0]))[0]
        else:
            grid = [g.reshape(-1) for g in jnp.meshgrid(places, places)]
            start = _zeros((rows, width), dtype)
            color = lax.scan(jax.checkpoint(sample), start, tuple(grid))[0] * (1 / samples**2)
        return jnp.stack([color.x, color.y, color.z], axis=-1)

    if strips == 1:
        return strip(jnp.zeros((), jnp.int32))
    # the reverse pass traces a strip again rather than keep the temporaries of all of them
    picture = lax.map(jax.checkpoint(strip), jnp.arange(strips, dtype=jnp.int32) * rows)
    return picture.reshape(strips * rows, width, 3)[:height]


def _zeros(shape: tuple[int, ...], dtype) -> Vec:
    zero = jnp.zeros(shape, dtype)
    return Vec(zero, zero, zero)


def radiance(scene: Scene, world: World, ray: Ray, options: Options) -> Vec:
    """The colour that each ray from the eye sees."""
    hit = nearest(world, ray, options.needs)
    one = jnp.ones_like(ray.direction.x)
    first = Path(ray, hit, one, jnp.full(one.shape, True))
    if options.bounces == 0:
        return shade(scene, world, first, options)[0]
    if options.needs.branching:
        return _branching(scene, world, first, options)
    color, path = shade(scene, world, first, options)
    return _follow(scene, world, path, color, options, jnp.zeros((), jnp.int32))


def _branching(scene: Scene, world: World, first: Path, options: Options) -> Vec:
    """The sum over all paths where objects both reflect and transmit.

    A path is a sequence of choices, bit b of a number: reflect (0) or go straight on (1) at hit b.
    Paths share beginnings, so hit b counts only in the path that chooses 0 from there on.
    """

    def path(total: Vec, choices: Int[Array, ""]) -> tuple[Vec, None]:
        color, path = shade(scene, world, first, options, choices & 1)
        color = color * (choices == 0).astype(scene.dtype)
        return total + _follow(scene, world, path, color, options, choices), None

    numbers = jnp.arange(1 << options.bounces, dtype=jnp.int32)
    zero = _zeros(first.weight.shape, scene.dtype)
    return lax.scan(jax.checkpoint(path), zero, numbers)[0]


def _follow(
    scene: Scene,
    world: World,
    path: Path,
    color: Vec,
    options: Options,
    choices: Int[Array, ""],
) -> Vec:
    """Adds what a path sees from its first bounce on, as long as any ray of the strip is alive."""

    def bounce(state: tuple[Path, Vec], number: Int[Array, ""]) -> tuple[tuple[Path, Vec], None]:
        def go_on(path: Path, color: Vec) -> tuple[Path, Vec]:
            hit = nearest(world, path.ray, options.needs, path.hit)
            path = eqx.tree_at(lambda p: p.hit, path, hit)
            later = choices >> number
            more, path = shade(scene, world, path, options, later & 1)
            return path, color + more * (later == 0).astype(scene.dtype)

        def stop(path: Path, color: Vec) -> tuple[Path, Vec]:
            return path, color

        return lax.cond(jnp.any(state[0].alive), go_on, stop, *state), None

    (_, color), _ = lax.scan(
        bounce, (path, color), jnp.arange(1, options.bounces + 1, dtype=jnp.int32)
    )
    return color


def shade(
    scene: Scene,
    world: World,
    path: Path,
    options: Options,
    choice: Int[Array, ""] | int = 0,
) -> tuple[Vec, Path]:
    """What a path's present hit adds to the picture, and the path that goes on from there.

    **Arguments:** `choice`: where an object both reflects and transmits, 0 to reflect.
    """
    needs, ray, hit = options.needs, path.ray, path.hit
    surface = surface_at(world, ray, hit, needs)
    material = fetch(world.materials, hit.id)
    color = local_color(scene, world, ray, hit, surface, material, options)
    if needs.background:
        color = where(hit.id >= 0, color, background(scene, ray.direction))
        seen = path.alive
    else:
        seen = path.alive & (hit.id >= 0)
    color = where(seen, color * path.weight, _zeros(path.weight.shape, scene.dtype))
    return color, (next_path(path, surface, material, needs, choice) if needs.bounces else path)


def local_color(
    scene: Scene,
    world: World,
    ray: Ray,
    hit: Hit,
    surface: Surface,
    material: Material,
    options: Options,
) -> Vec:
    """The lecture's C = ka A S + sum_l lit_l C_l (kd (N.L_l) S + ks highlight_l) at a hit."""
    needs, lights = options.needs, scene.lights
    highlight = options.highlight if needs.highlights else None
    own_color = surface_color(scene, world, hit, surface, material, needs)
    ambient = vec(jnp.mean(lights.color, axis=0) if len(lights) else jnp.zeros(3, scene.dtype))

    def add_light(sums: tuple[Vec, Vec], light: tuple) -> tuple[tuple[Vec, Vec], None]:
        position, light_color = vec(light[0]), vec(light[1])
        lit = hit.id >= 0
        if needs.shadows:
            lit = lit & unoccluded(world, surface.point, hit, position, needs)

        def terms() -> tuple[Plane, Plane]:
            return light_terms(surface, ray.direction, position, material.exponent, lit, highlight)

        diffuse, shine = materialise_pair(terms, world.window) if highlight else terms()
        return (sums[0] + light_color * diffuse, sums[1] + light_color * shine), None

    zeros = _zeros(hit.id.shape, scene.dtype)
    sums = zeros, zeros
    if len(lights) <= UNROLL // 4:
        for i in range(len(lights)):
            sums, _ = add_light(sums, (lights.position[i], lights.color[i]))
    else:
        sums, _ = lax.scan(add_light, sums, (lights.position, lights.color))
    diffuse, shine = sums
    color = own_color * (ambient * material.ka + diffuse * material.kd)
    return color + shine * material.ks if highlight else color


def surface_color(
    scene: Scene, world: World, hit: Hit, surface: Surface, material: Material, needs: Needs
) -> Vec:
    """S: the object's colour, under its texture or checker."""
    color = material.color
    if needs.textures:
        outward = where(hit.inside, -surface.normal, surface.normal)
        images = tuple(t.image for t in scene.textures)
        color = color * worn(hit.id, outward, images, scene.spheres.pic)
    if needs.checkers:
        other, checker_color = other_square(world, hit.id, surface.point)
        color = where(other, checker_color, color)
    return color


def background(scene: Scene, direction: Vec) -> Vec:
    """What rays see that leave the world: the sky's picture all around, or one colour."""
    if scene.sky is not None:
        return lookup(scene.sky.image, *sphere_uv(direction))
    return vec(scene.background)


def next_path(
    path: Path, surface: Surface, material: Material, needs: Needs, choice: Int[Array, ""] | int
) -> Path:
    """The path mirrored in the surface, or straight on through it, with its weight.

    The ray straight on skips the object (a bubble without refraction); see `nearest`.
    """
    kgr, kt = material.kgr, material.kt
    if not needs.transmission:
        straight, weight = None, kgr
    elif not needs.reflection:
        straight, weight = jnp.full(kt.shape, True), kt
    elif needs.branching:
        straight = jnp.full(kt.shape, choice == 1)
        weight = jnp.where(straight, kt, kgr)
    else:
        straight = lax.stop_gradient(kt) != 0
        weight = jnp.where(straight, kt, kgr)
    weight = path.weight * weight
    alive = path.alive & (path.hit.id >= 0)
    if not needs.dark_paths:
        alive = alive & (lax.stop_gradient(weight) != 0)
    direction = reflect(path.ray.direction, surface.normal)
    hit = path.hit
    if straight is not None:
        direction = where(straight, path.ray.direction, direction)
        hit = Hit(hit.id, hit.inside & ~straight)
    return Path(Ray(surface.point, direction), hit, weight, alive)
