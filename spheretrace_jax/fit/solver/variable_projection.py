"""Variable projection: for given lights the materials are known in closed form.

A picture without reflections is linear in ka color, kd color and ks of each sphere, seven numbers
that least squares find at once, sphere by sphere. With these eliminated only the lights are left
to sample for (Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973): from far off that leads to them
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
from jaxtyping import Array, Bool, Float, Int, PyTree

from ...base.types import Ids, Index, PixelArray
from ...rendering.samples import sample_rays
from ...scene.camera import Ray
from ...scene.light import make_light, map_lights
from ...scene.lights import Lights
from ...scene.scene import Scene
from ...scene.settings import RenderSettings
from ...tracing.context import TraceContext, build_context
from ...tracing.path import light_terms_at
from ...tracing.queries import closest_hit
from ...xla.jit import compiled
from ..model.constraints import Constraint
from ..model.parameters import Parameters
from ..model.target import Target
from .levenberg_marquardt import BoundedLevenbergMarquardt

# About so many pixels are sampled, and of each sphere at least so many. Their number is a multiple
# of the last one, so that another scene does not compile again. More pixels take longer.
_PIXELS, _LEAST, _MULTIPLE = 1500, 64, 1024

# What comes out negative is held at 0, found out so many times; each time the solution is refined.
_ROUNDS = 3

# Lights are tried so many at a time, whatever their number: what that takes is compiled once.
_BLOCK = 64

# The steps for the lights end where they move by less than this, or after so many.
_TOLERANCE, _MOST_STEPS = 1e-6, 40

# The colour of a start is this much brighter than what shows, so that ka and kd begin inside of
# their bounds, of which that at 1 would hold them; but it is no darker than the second number.
_BRIGHTER, _DARKEST_COLOR = 1.2, 0.5

LightTerms = Float[Array, "lights 2 pixels"]
"""N.L and the highlight of lights, 0 where they do not reach."""

Materials = Float[Array, "spheres 7"]
"""ka color A, kd color and ks of each sphere, A the mean colour of the lights."""


class SampledPixels(eqx.Module):
    """A sample of a picture's pixels, each of which shows a sphere."""

    scene: Scene
    pixels: Ids
    sphere: Int[Array, " pixels"]  #: the number of the sphere that a pixel shows
    image: Float[Array, "pixels 3"]
    weight: Float[Array, "pixels 3"]
    known: Materials  #: where they are not free; else 0
    free: Bool[Array, "spheres 7"]  #: which materials are free
    settings: RenderSettings = eqx.field(static=True)

    def sums(self, terms: LightTerms) -> Float[Array, "2 pixels 3"]:
        """Sums the terms of all lights, per channel."""
        return jnp.einsum("ltp,lc->tpc", terms, self.scene.lights.color)

    def materials(self, sums: Float[Array, "2 pixels 3"]) -> Materials:
        """Returns the materials whose picture is nearest to the target (linear least squares)."""
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

        def solve(_: Index, state: tuple) -> tuple:
            x, free = state
            both = free[:, :, None] & free[:, None, :]
            diagonal = jnp.where(free, ridge, 1)[:, :, None] * jnp.eye(7, dtype=x.dtype)[None]
            rest = jnp.where(free, right - jnp.einsum("nij,nj->ni", square, x), 0)
            step = jnp.linalg.solve(jnp.where(both, square, 0) + diagonal, rest[..., None])
            x = x + step[..., 0]
            return jnp.maximum(x, 0), free & (x >= 0)

        return lax.fori_loop(0, _ROUNDS, solve, (self.known, self.free))[0]

    def residual(self, terms: LightTerms) -> Float[Array, "pixels 3"]:
        """Returns the residual of the target with the best materials."""
        sums = self.sums(terms)
        color = linear_shading(self.materials(sums)[self.sphere], sums)
        return self.weight * (color - self.image)


def linear_shading(materials: Materials, sums: Float[Array, "2 pixels 3"]) -> Array:
    """Returns C = ka A S + kd S u + ks h, linear in the materials: `material.local_color` again.

    Here the products ka A S, kd S and ks are the unknowns, so that least squares find them; a test
    holds the two together.

    **Arguments:** `materials`: per pixel. `sums`: u and h, summed over the lights per channel.
    """
    diffuse, shine = sums
    return materials[:, :3] + materials[:, 3:6] * diffuse + materials[:, 6:] * shine


def sample_pixels(
    parameters: Parameters, target: Target, settings: RenderSettings
) -> SampledPixels:
    """Samples the pixels that count and show spheres; more of each small sphere's."""
    scene = parameters.scene
    if "ior" in parameters.free:  # coats are no materials here: those with which the fit begins
        scene, _ = parameters.scene_at({"ior": parameters.start()["ior"]})
    settings = dataclasses.replace(settings, bounces=0, antialias=False, samples=1)
    weight, image = target.weight.reshape(-1, 3), target.image.reshape(-1, 3)
    pixels = np.flatnonzero((np.asarray(weight) > 0).any(axis=1)).astype(np.int32)
    ids = np.asarray(_first_hits(scene, settings, jnp.asarray(pixels)))
    sphere = (ids >= 0) & (ids < len(scene.spheres))
    pixels, ids = pixels[sphere], ids[sphere]
    order = np.argsort(ids, kind="stable")
    small = np.bincount(ids, minlength=len(scene.spheres))[ids[order]] < _LEAST
    every = max(1, len(pixels) // _PIXELS)
    chosen = order[small | (np.arange(len(order)) % every == 0)]
    # what fills up the last multiple weighs nothing
    padding = max(1, -(-len(chosen) // _MULTIPLE)) * _MULTIPLE - len(chosen)
    at, sphere = (jnp.asarray(np.pad(x[chosen], (0, padding))) for x in (pixels, ids))
    weight = jnp.where(jnp.arange(at.size)[:, None] < len(chosen), weight[at], 0)
    known, is_free = _known(parameters)
    return SampledPixels(scene, at, sphere, image[at], weight, known, is_free, settings)


def _known(parameters: Parameters) -> tuple[Materials, Bool[Array, "spheres 7"]]:
    """Returns the materials that are not free, 0 for those that are, and which are."""
    s = parameters.scene.spheres
    ambient = jnp.mean(parameters.scene.lights.color, axis=0)
    color, ka, kd, ks = map(parameters.free_numbers, ("color", "ka", "kd", "ks"))
    parts = (
        (s.ka[:, None] * s.color * ambient[None], color | ka[:, None]),
        (s.kd[:, None] * s.color, color | kd[:, None]),
        (s.ks[:, None], ks[:, None]),
    )
    is_free = jnp.concatenate([jnp.asarray(free) for _, free in parts], axis=1)
    return jnp.where(is_free, 0, jnp.concatenate([x for x, _ in parts], axis=1)), is_free


@compiled
def _first_hits(scene: Scene, settings: RenderSettings, pixels: Ids) -> Ids:
    context = build_context(scene, settings, accelerated=False)
    return closest_hit(context, _center_rays(context, pixels)).id.astype(jnp.int32)


def _center_rays(context: TraceContext, pixels: Ids) -> Ray:
    """Returns the rays through the centres of pixels."""
    half = jnp.asarray(0.5, context.dtype)
    return sample_rays(context.scene, context.settings, pixels, half, half)


def terms_at(sample: SampledPixels, lights: Lights) -> LightTerms:
    """Returns the terms of lights, which may be others than the scene's."""
    context = build_context(sample.scene, sample.settings, accelerated=False)
    ray = _center_rays(context, sample.pixels)
    hit, needs = closest_hit(context, ray), context.needs

    def one(
        position: Float[Array, " 3"], falloff: PixelArray, directional: bool
    ) -> Float[Array, "2 pixels"]:
        light = make_light(position, falloff if needs.falloff else None, directional)
        return jnp.stack(light_terms_at(context, ray, hit, light, needs.shadows))

    return map_lights(one, lights)


@compiled
def refine_lights(
    sample: SampledPixels,
    lights: Float[Array, "lights 3"],
    places: tuple[str, ...],
    constraints: dict[str, Constraint],
) -> Float[Array, "lights 3"]:
    """Moves lights downhill to where the picture is nearest to the target.

    **Arguments:** `places`: those of `LIGHT_PLACES` that are free. `constraints`: theirs.
    """
    scene = eqx.tree_at(lambda s: s.lights.position, sample.scene, lights)
    parameters = Parameters(scene, places, constraints)

    def residual(values: PyTree, args: tuple) -> Float[Array, "pixels 3"]:
        sample, parameters = args
        scene, _ = parameters.scene_at(values)
        return sample.residual(terms_at(sample, scene.lights))

    solver = BoundedLevenbergMarquardt(_TOLERANCE, _TOLERANCE, *parameters.bounds())
    found = optx.least_squares(
        residual,
        solver,
        parameters.start(),
        (sample, parameters),
        max_steps=_MOST_STEPS,
        throw=False,
    )
    return parameters.scene_at(found.value)[0].lights.position


def scene_with(
    sample: SampledPixels, parameters: Parameters, lights: Float[Array, "lights 3"]
) -> Scene:
    """Returns the scene with these lights and the materials that suit them best."""
    moved = eqx.tree_at(lambda x: x.position, sample.scene.lights, lights)
    x = np.asarray(_materials(sample, _terms(sample, moved)), np.float64)
    scene, spheres = sample.scene, sample.scene.spheres
    ambient = np.mean(np.asarray(scene.lights.color, np.float64), axis=0)
    a = x[:, :3] / np.where(ambient > 0, ambient, 1)
    b, seen = x[:, 3:6], a + x[:, 3:6]
    brightest = np.maximum(seen.max(axis=1, keepdims=True), 1e-6)
    color = np.clip(seen / brightest, 0, 1) * np.clip(brightest * _BRIGHTER, _DARKEST_COLOR, 1)
    color = np.where(parameters.free_numbers("color"), color, np.asarray(spheres.color))
    square = np.maximum(np.sum(color**2, axis=1), 1e-12)
    ka, kd = (np.clip(np.sum(t * color, axis=1) / square, 0, 1) for t in (a, b))
    new = {"color": color, "ka": ka, "kd": kd, "ks": np.clip(x[:, 6], 0, 1)}
    shown = np.isin(np.arange(len(spheres)), np.asarray(sample.sphere))
    values = [lights]
    names = [name for name in new if name in parameters.free]
    for name in names:  # of what is not seen the start is kept
        old = getattr(spheres, name)
        values.append(np.where(shown[:, None] if old.ndim > 1 else shown, new[name], old))
    places = lambda s: [s.lights.position, *(getattr(s.spheres, name) for name in names)]
    return eqx.tree_at(places, scene, [jnp.asarray(value, scene.dtype) for value in values])


def best_residual(
    sample: SampledPixels, lights: Float[Array, "lights 3"]
) -> Float[Array, "pixels 3"]:
    """Returns the residual of lights with the materials that suit them best, from the host."""
    moved = eqx.tree_at(lambda x: x.position, sample.scene.lights, lights)
    terms = _terms(sample, moved)
    sums, materials = sample.sums(terms), _materials(sample, terms)
    return sample.weight * (linear_shading(materials[sample.sphere], sums) - sample.image)


@compiled
def _materials(sample: SampledPixels, terms: LightTerms) -> Materials:
    return sample.materials(sample.sums(terms))


def known_terms(sample: SampledPixels) -> LightTerms:
    """Returns `terms_at` for the scene's lights, from the host."""
    return _terms(sample, sample.scene.lights)


def try_lights(
    sample: SampledPixels, k: int, positions: Float[np.ndarray, "lights 3"]
) -> LightTerms:
    """Returns `terms_at` for a light of the scene at any number of places, from the host.

    **Arguments:** `k`: the light, of which the kind and the fall-off are. `positions`: or
    directions.
    """
    lights, dtype = sample.scene.lights, sample.scene.dtype
    directional, falloff = lights.directional[k], lights.falloff[k]
    white = jnp.ones(3, dtype)
    at = lambda block: _terms(sample, Lights(block, white, directional, falloff))
    return _in_blocks(at, jnp.asarray(positions, dtype))


@compiled
def _terms(sample: SampledPixels, lights: Lights) -> LightTerms:
    return terms_at(sample, lights)


def projected_costs(
    sample: SampledPixels, terms: LightTerms, candidates: Float[Array, "c 2 pixels"], k: int
) -> np.ndarray:
    """Returns the cost if light k is one of the candidates, and the others stay; from the host."""
    return np.asarray(_in_blocks(partial(_costs, sample, terms, jnp.asarray(k)), candidates))


@compiled
def _costs(
    sample: SampledPixels, terms: LightTerms, k: Index, candidates: Float[Array, "c 2 pixels"]
) -> Float[Array, " c"]:
    cost = lambda candidate: jnp.sum(sample.residual(terms.at[k].set(candidate)) ** 2)
    return lax.map(cost, candidates)


def _in_blocks(
    function: Callable[[Float[Array, "block ..."]], Array], rows: Float[Array, "count ..."]
) -> Array:
    """Applies a function to rows, so many at a time."""
    beyond = [(0, -len(rows) % _BLOCK), *[(0, 0)] * (rows.ndim - 1)]
    blocks = jnp.pad(rows, beyond, mode="edge").reshape(-1, _BLOCK, *rows.shape[1:])
    return jnp.concatenate([function(block) for block in blocks])[: len(rows)]
