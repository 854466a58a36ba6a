"""Variable projection: for given lights the materials are known in closed form.

A picture without reflections is linear in ka color, kd color and ks of each sphere, seven numbers
that least squares find at once, sphere by sphere. With these eliminated only the lights are left
to look for (Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973): from far off that leads to them
where steps in all unknowns at once lose their way. Some of the picture's pixels are enough.
"""

import dataclasses
from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax import lax
from jaxtyping import Array, Float, Int, PyTree

from ...base.types import Ids, Index
from ...base.vec import vec
from ...rendering.render import rays_through
from ...scene.scene import Scene
from ...scene.settings import RenderSettings
from ...tracing.path import light_terms_at
from ...tracing.queries import closest_hit
from ...tracing.tables import build_tables
from ...xla.jit import compiled
from ..model.parameters import Parameters
from ..model.target import Target
from .levenberg_marquardt import BoundedLevenbergMarquardt

# So many pixels are looked at, and of each sphere so many at least, altogether in lots.
_PIXELS, _LEAST, _LOT = 1500, 64, 1024

# What comes out negative is 0, found out so many times; each time the solution is refined.
_ROUNDS = 3

# Lights are tried so many at a time, whatever their number: what that takes is compiled once.
_BLOCK = 64

# The steps for the lights end where they move by less than this, or after so many.
_TOLERANCE, _MOST_STEPS = 1e-6, 40

Terms = Float[Array, "lights 2 pixels"]
"""N.L and the highlight of lights, 0 where they do not reach."""

Materials = Float[Array, "spheres 7"]
"""ka color A, kd color and ks of each sphere, A the mean colour of the lights."""


class SampledPixels(eqx.Module):
    """Some pixels of a picture, each of which shows a sphere."""

    scene: Scene
    pixels: Ids
    sphere: Int[Array, " pixels"]  #: which one
    image: Float[Array, "pixels 3"]
    weight: Float[Array, "pixels 3"]
    known: Materials  #: nan where they are free
    settings: RenderSettings = eqx.field(static=True)

    def sums(self, terms: Terms) -> Float[Array, "2 pixels 3"]:
        """What all lights do together, per channel."""
        return jnp.einsum("ltp,lc->tpc", terms, self.scene.lights.color)

    def materials(self, sums: Float[Array, "2 pixels 3"]) -> Materials:
        """Those whose picture is nearest to the target."""
        n = len(self.scene.spheres)
        columns = jnp.stack([self.weight, *(self.weight * s for s in sums)])
        # of each sphere and channel the products of its three columns, and those with the target
        of_sphere = lambda x: jax.ops.segment_sum(x, self.sphere, num_segments=n)
        products = of_sphere(jnp.einsum("apc,bpc->pcab", columns, columns))
        wanted = of_sphere(jnp.einsum("apc,pc->pca", columns, self.weight * self.image))
        square = jnp.zeros((n, 7, 7), columns.dtype)
        right = jnp.zeros((n, 7), columns.dtype)
        for c in range(3):
            at = np.array([c, 3 + c, 6])
            square = square.at[:, at[:, None], at[None, :]].add(products[:, c])
            right = right.at[:, at].add(wanted[:, c])
        ridge = 1e3 * jnp.finfo(square.dtype).eps * jnp.diagonal(square, axis1=1, axis2=2) + 1e-30
        free = jnp.isnan(self.known)

        def solve(_: Index, state: tuple) -> tuple:
            x, free = state
            both = free[:, :, None] & free[:, None, :]
            diagonal = jnp.where(free, ridge, 1)[:, :, None] * jnp.eye(7, dtype=x.dtype)[None]
            rest = jnp.where(free, right - jnp.einsum("nij,nj->ni", square, x), 0)
            step = jnp.linalg.solve(jnp.where(both, square, 0) + diagonal, rest[..., None])
            x = x + step[..., 0]
            return jnp.maximum(x, 0), free & (x >= 0)

        start = jnp.where(free, 0, self.known), free
        return lax.fori_loop(0, _ROUNDS, solve, start)[0]

    def residual(self, terms: Terms) -> Float[Array, "pixels 3"]:
        """What is left of the target with the best materials."""
        diffuse, shine = sums = self.sums(terms)
        x = self.materials(sums)[self.sphere]
        seen = x[:, :3] + x[:, 3:6] * diffuse + x[:, 6:] * shine
        return self.weight * (seen - self.image)


def sample_pixels(
    scene: Scene, target: Target, settings: RenderSettings, free: tuple[str, ...]
) -> SampledPixels:
    """Some of the pixels that count and show spheres; more of each small sphere's."""
    settings = dataclasses.replace(settings, bounces=0, antialias=False, samples=1)
    weight, image = target.weight.reshape(-1, 3), target.image.reshape(-1, 3)
    pixels = np.flatnonzero((np.asarray(weight) > 0).any(axis=1)).astype(np.int32)
    ids = np.asarray(_first_hits(scene, settings, jnp.asarray(pixels)))
    sphere = (ids >= 0) & (ids < len(scene.spheres))
    pixels, ids = pixels[sphere], ids[sphere]
    order = np.argsort(ids, kind="stable")
    small = np.bincount(ids, minlength=len(scene.spheres))[ids[order]] < _LEAST
    every = max(1, len(pixels) // _PIXELS)
    some = order[small | (np.arange(len(order)) % every == 0)]
    # a round number of them, so that another scene does not compile again; the rest weigh nothing
    short = max(1, -(-len(some) // _LOT)) * _LOT - len(some)
    at, sphere = (jnp.asarray(np.pad(x[some], (0, short))) for x in (pixels, ids))
    weight = jnp.where(jnp.arange(at.size)[:, None] < len(some), weight[at], 0)
    return SampledPixels(scene, at, sphere, image[at], weight, _known(scene, free), settings)


def _known(scene: Scene, free: tuple[str, ...]) -> Materials:
    s = scene.spheres
    ambient = jnp.mean(scene.lights.color, axis=0)
    parts = (
        (s.ka[:, None] * s.color * ambient[None], {"color", "ka"}),
        (s.kd[:, None] * s.color, {"color", "kd"}),
        (s.ks[:, None], {"ks"}),
    )
    return jnp.concatenate([jnp.full_like(x, jnp.nan) if n & {*free} else x for x, n in parts], 1)


@compiled
def _first_hits(scene: Scene, settings: RenderSettings, pixels: Ids) -> Ids:
    half = jnp.asarray(0.5, scene.dtype)
    ray = rays_through(scene, settings, pixels, half, half)
    return closest_hit(build_tables(scene), ray, settings.needs).id.astype(jnp.int32)


def terms_at(look: SampledPixels, positions: Float[Array, "lights 3"]) -> Terms:
    """What lights at some positions do."""
    scene, settings = look.scene, look.settings
    world, half = build_tables(scene), jnp.asarray(0.5, scene.dtype)
    ray = rays_through(scene, settings, look.pixels, half, half)
    hit = closest_hit(world, ray, settings.needs)

    def one(light: Float[Array, " 3"]) -> Float[Array, "2 pixels"]:
        shadows = settings.needs.shadows
        return jnp.stack(light_terms_at(world, ray, hit, settings, vec(light), shadows))

    return lax.map(one, positions)


@compiled
def refine_lights(
    look: SampledPixels, lights: Float[Array, "lights 3"]
) -> Float[Array, "lights 3"]:
    """The lights from which the picture is nearest to the target, as far as steps downhill lead."""
    scene = eqx.tree_at(lambda s: s.lights.position, look.scene, lights)
    parameters = Parameters(scene, ("light_position",))

    def residual(values: PyTree, args: tuple) -> Float[Array, "pixels 3"]:
        look, parameters = args
        return look.residual(terms_at(look, _positions(parameters, values)))

    solver = BoundedLevenbergMarquardt(_TOLERANCE, _TOLERANCE, *parameters.bounds())
    found = optx.least_squares(
        residual, solver, parameters.start(), (look, parameters), max_steps=_MOST_STEPS, throw=False
    )
    return _positions(parameters, found.value)


def _positions(parameters: Parameters, values: PyTree) -> Float[Array, "lights 3"]:
    return parameters.natural(values)["light_position"]


def scene_with(
    look: SampledPixels, free: tuple[str, ...], lights: Float[Array, "lights 3"]
) -> Scene:
    """The scene with these lights and the materials that suit them best."""
    x = np.asarray(_materials(look, try_lights(look, np.asarray(lights))), np.float64)
    scene, spheres = look.scene, look.scene.spheres
    ambient = np.mean(np.asarray(scene.lights.color, np.float64), axis=0)
    a = x[:, :3] / np.where(ambient > 0, ambient, 1)
    b, seen = x[:, 3:6], a + x[:, 3:6]
    if "color" in free:
        brightest = np.maximum(seen.max(axis=1, keepdims=True), 1e-6)
        color = np.clip(seen / brightest, 0, 1) * np.clip(brightest * 1.2, 0.5, 1)
    else:
        color = np.asarray(spheres.color, np.float64)
    square = np.maximum(np.sum(color**2, axis=1), 1e-12)
    ka, kd = (np.clip(np.sum(t * color, axis=1) / square, 0, 1) for t in (a, b))
    new = {"color": color, "ka": ka, "kd": kd, "ks": np.clip(x[:, 6], 0, 1)}
    shown = np.isin(np.arange(len(spheres)), np.asarray(look.sphere))
    values = [lights]
    names = [name for name in new if name in free]
    for name in names:  # of what is not seen the start is kept
        old = getattr(spheres, name)
        values.append(np.where(shown[:, None] if old.ndim > 1 else shown, new[name], old))
    places = lambda s: [s.lights.position, *(getattr(s.spheres, name) for name in names)]
    return eqx.tree_at(places, scene, [jnp.asarray(value, scene.dtype) for value in values])


@compiled
def _materials(look: SampledPixels, terms: Terms) -> Materials:
    return look.materials(look.sums(terms))


def try_lights(look: SampledPixels, positions: Float[np.ndarray, "lights 3"]) -> Terms:
    """`terms_at` for any number of lights, from the host."""
    return _in_blocks(partial(_terms, look), jnp.asarray(positions, look.scene.dtype))


@compiled
def _terms(look: SampledPixels, positions: Float[Array, "lights 3"]) -> Terms:
    return terms_at(look, positions)


def projected_costs(
    look: SampledPixels, terms: Terms, candidates: Float[Array, "c 2 pixels"], k: int
) -> np.ndarray:
    """What is left if light k is one of the candidates, and the others stay; from the host."""
    return np.asarray(_in_blocks(partial(_costs, look, terms, jnp.asarray(k)), candidates))


@compiled
def _costs(
    look: SampledPixels, terms: Terms, k: Index, candidates: Float[Array, "c 2 pixels"]
) -> Float[Array, " c"]:
    cost = lambda candidate: jnp.sum(look.residual(terms.at[k].set(candidate)) ** 2)
    return lax.map(cost, candidates)


def _in_blocks(
    function: Callable[[Float[Array, "block ..."]], Array], rows: Float[Array, "count ..."]
) -> Array:
    """A function of rows, which is given so many at a time."""
    beyond = [(0, -len(rows) % _BLOCK), *[(0, 0)] * (rows.ndim - 1)]
    blocks = jnp.pad(rows, beyond, mode="edge").reshape(-1, _BLOCK, *rows.shape[1:])
    return jnp.concatenate([function(block) for block in blocks])[: len(rows)]
