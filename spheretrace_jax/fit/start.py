"""A start from nothing: where the lights are, and what the spheres are made of, geometry known.

For given lights a picture without reflections is linear in ka color, kd color and ks of each
sphere, which least squares find in closed form. So directions all around are tried for the lights,
one after the other, on some of the picture's pixels, and then finer ones around the best. That is
variable projection (Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973) on a grid: deterministic, and
blind to local minima that are wider than the grid.
"""

import dataclasses
from collections.abc import Iterator

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from ..options import Options
from ..paths import light_terms_at
from ..render import rays_through
from ..scene import Scene
from ..vec import vec
from ..visibility import nearest
from ..world import build_world, surface_at
from .parameters import extent
from .target import Target

# So many pixels are looked at, so many directions first, at these distances in units of the scene.
_PIXELS, _DIRECTIONS, _DISTANCES = 1500, 160, (1.6, 5.0)

# Around the best: turned by so many degrees at most, in a grid of 5 x 5, and nearer and further.
_ZOOMS, _STRETCH = (12.0, 5.0, 2.0), (0.6, 1.0, 1.7)

# So many of the best first directions are followed.
_STARTS = 4


def propose(
    scene: Scene, target: Target, options: Options, free: tuple[str, ...]
) -> Iterator[Scene]:
    """Scenes to start from, one after the other, the most promising first.

    **Arguments:** `scene`: its geometry, number of lights, and what is not free, are used.
    """
    look = _Look(scene, target, options, frozenset(free))
    middle, size = (np.asarray(x, np.float64) for x in extent(scene))
    grid = np.concatenate([middle + size * far * _all_around(_DIRECTIONS) for far in _DISTANCES])
    around = look.terms(grid)
    count = len(scene.lights)
    if "light_position" not in free:
        yield look.scene_at(np.asarray(scene.lights.position, np.float64))
        return

    nothing = np.zeros((count, *around.shape[1:]), around.dtype)
    first = look.costs(nothing, around, 0)
    for i in _apart(grid - middle, np.argsort(first))[:_STARTS]:
        lights, terms = np.repeat(grid[i][None], count, axis=0), nothing.copy()
        terms[0] = around[i]
        for k in [*range(1, count), *range(count if count > 1 else 0)]:
            terms[k] = 0
            j = int(np.argmin(look.costs(terms, around, k)))
            lights[k], terms[k] = grid[j], around[j]
        for turn in _ZOOMS:
            for k in range(count):
                near = middle + _turned(lights[k] - middle, np.radians(turn))
                found = look.terms(near)
                j = int(np.argmin(look.costs(terms, found, k)))
                lights[k], terms[k] = near[j], found[j]
        yield look.scene_at(lights)


class _Look:
    """Some pixels of a picture that show spheres, and what lights do there."""

    def __init__(self, scene: Scene, target: Target, options: Options, free: frozenset[str]):
        self.scene, self.free = scene, free
        self.options = dataclasses.replace(options, bounces=0, antialias=False, samples=1)
        weight, image = (np.asarray(x, np.float64) for x in (target.weight, target.image))
        weight, image = weight.reshape(-1, 3), image.reshape(-1, 3)
        pixels = np.flatnonzero((weight > 0).any(axis=1)).astype(np.int32)
        ids = np.asarray(_first_hits(scene, self.options, jnp.asarray(pixels)))
        sphere = (ids >= 0) & (ids < len(scene.spheres))
        pixels, ids = pixels[sphere], ids[sphere]
        step = max(1, len(pixels) // _PIXELS)
        # every step-th of each sphere's, so that small spheres are not lost
        order = np.argsort(ids, kind="stable")
        small = np.bincount(ids, minlength=len(scene.spheres))[ids[order]] < 64
        some = order[small | (np.arange(len(order)) % step == 0)]
        self.pixels = pixels[some]
        self.image, self.weight = image[self.pixels], weight[self.pixels] ** 2
        self.of = np.zeros((len(some), len(scene.spheres)))
        self.of[np.arange(len(some)), ids[some]] = 1
        self.colors = np.asarray(scene.lights.color, np.float64)

    def terms(self, positions: Float[np.ndarray, "c 3"]) -> Float[np.ndarray, "c 2 pixels"]:
        """N.L and the highlight of lights at some positions, 0 where they do not reach."""
        lights = jnp.asarray(positions, self.scene.dtype)
        found = _terms(self.scene, self.options, jnp.asarray(self.pixels), lights)
        return np.asarray(found, np.float32)

    def costs(
        self,
        others: Float[np.ndarray, "m 2 pixels"],
        candidates: Float[np.ndarray, "c 2 pixels"],
        k: int,
    ) -> Float[np.ndarray, " c"]:
        """What least squares leave if light k is one of the candidates, and the others stay."""
        rest = others.copy()
        rest[k] = 0
        return self._solve(np.einsum("mtp,mc->ctp", rest, self.colors), candidates, k)[0]

    def _solve(self, fixed, candidates, k: int):
        """**Arguments:** `fixed`: the sums over the other lights, per channel."""
        n, c = self.of.shape[1], len(candidates)
        square, right = np.zeros((c, n, 7, 7)), np.zeros((c, n, 7))
        for channel in range(3):
            of = (self.of * self.weight[:, channel, None]).astype(np.float32)
            image = self.image[None, :, channel].astype(np.float32)
            one = np.ones_like(image)
            u, s = (
                (fixed[channel, t][None] + candidates[:, t] * self.colors[k, channel]).astype(
                    np.float32
                )
                for t in range(2)
            )
            columns = ((channel, one), (3 + channel, u), (6, s))
            for i, x in columns:
                right[:, :, i] += (x * image) @ of
                for j, y in columns:
                    if i <= j:
                        square[:, :, i, j] += (x * y) @ of
        square = np.maximum(square, np.swapaxes(square, 2, 3))
        x0 = self._known()
        free = np.isnan(x0)
        x = np.where(free, 0, x0) * np.ones((c, n, 7))
        active = np.broadcast_to(free, x.shape).copy()
        for _ in range(3):  # what comes out negative is 0
            x = np.where(active, 0, x)
            a = square * active[..., None] * active[..., None, :]
            diagonal = np.einsum("cnii->cni", square)
            ridge = np.where(active, 1e-9 * diagonal + 1e-30, 1.0)
            a = a + ridge[..., None] * np.eye(7)
            b = np.where(active, right - np.einsum("cnij,cnj->cni", square, x), 0)
            x = x + np.linalg.solve(a, b[..., None])[..., 0]
            below = active & (x < 0)
            if not below.any():
                break
            x, active = np.where(below, 0, x), active & ~below
        total = np.sum(self.weight * self.image**2)
        cost = np.einsum("cni,cnij,cnj->c", x, square, x) - 2 * np.einsum("cni,cni->c", x, right)
        return cost + total, x

    def _known(self) -> Float[np.ndarray, "n 7"]:
        """ka color A, kd color and ks of each sphere where they are not free; else nan."""
        s, free = self.scene.spheres, self.free
        color, ka, kd, ks = (np.asarray(x, np.float64) for x in (s.color, s.ka, s.kd, s.ks))
        ambient = self.colors.mean(axis=0)
        x = np.concatenate([ka[:, None] * color * ambient, kd[:, None] * color, ks[:, None]], 1)
        if free & {"color", "ka"}:
            x[:, :3] = np.nan
        if free & {"color", "kd"}:
            x[:, 3:6] = np.nan
        if "ks" in free:
            x[:, 6] = np.nan
        return x

    def scene_at(self, lights: Float[np.ndarray, "m 3"]) -> Scene:
        """The scene with these lights and the least squares' spheres."""
        terms = self.terms(lights)
        last = len(lights) - 1
        fixed = np.einsum("mtp,mc->ctp", terms[:last], self.colors[:last])
        _, x = self._solve(fixed, terms[last:], last)
        color, ka, kd, ks = self._materials(x[0])
        start = self.scene
        new = {"color": color, "ka": ka, "kd": kd, "ks": ks}
        for name in self.free & set(new):
            value = jnp.asarray(new[name], start.dtype)
            start = eqx.tree_at(lambda x, name=name: getattr(x.spheres, name), start, value)
        position = jnp.asarray(lights, start.dtype)
        return eqx.tree_at(lambda x: x.lights.position, start, position)

    def _materials(self, x: Float[np.ndarray, "n 7"]) -> tuple[np.ndarray, ...]:
        s = self.scene.spheres
        ambient = self.colors.mean(axis=0)
        a = np.clip(x[:, :3] / np.where(ambient > 0, ambient, 1), 0, None)
        b, ks = np.clip(x[:, 3:6], 0, None), np.clip(x[:, 6], 0, 1)
        seen = a + b
        if "color" in self.free:
            brightest = np.maximum(seen.max(axis=1, keepdims=True), 1e-6)
            color = np.clip(seen / brightest, 0, 1) * np.clip(brightest * 1.2, 0.5, 1)
        else:
            color = np.asarray(s.color, np.float64)
        square = np.maximum(np.sum(color**2, axis=1), 1e-12)
        ka, kd = (np.clip(np.sum(t * color, axis=1) / square, 0, 1) for t in (a, b))
        hidden = self.of.sum(axis=0) == 0  # of what is not seen the start is kept
        keep = lambda old, new: np.where(
            hidden.reshape(-1, *[1] * (new.ndim - 1)), np.asarray(old, np.float64), new
        )
        return keep(s.color, color), keep(s.ka, ka), keep(s.kd, kd), keep(s.ks, ks)


@eqx.filter_jit
def _first_hits(scene: Scene, options: Options, pixels: Int[Array, " p"]) -> Int[Array, " p"]:
    half = jnp.asarray(0.5, scene.dtype)
    ray = rays_through(scene, options, pixels, half, half)
    return nearest(build_world(scene), ray, options.needs).id.astype(jnp.int32)


@eqx.filter_jit
def _terms(
    scene: Scene, options: Options, pixels: Int[Array, " p"], lights: Float[Array, "c 3"]
) -> Float[Array, "c 2 p"]:
    world, half = build_world(scene), jnp.asarray(0.5, scene.dtype)
    ray = rays_through(scene, options, pixels, half, half)
    hit = nearest(world, ray, options.needs)
    surface = surface_at(world, ray, hit, options.needs)
    material = world.material(hit.id)

    def one(light: Float[Array, " 3"]) -> Float[Array, "2 p"]:
        return jnp.stack(light_terms_at(world, ray, hit, surface, material, vec(light), options))

    return lax.map(one, lights)


def _all_around(count: int) -> Float[np.ndarray, "count 3"]:
    """Directions all around, evenly spread (the Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)


def _turned(away: Float[np.ndarray, " 3"], angle: float) -> Float[np.ndarray, "c 3"]:
    """Vectors around one, turned by up to `angle` and stretched."""
    length = np.linalg.norm(away)
    along = away / length
    first = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    first /= np.linalg.norm(first)
    second = np.cross(along, first)
    steps = np.linspace(-np.tan(angle), np.tan(angle), 5)
    found = [along + a * first + b * second for a in steps for b in steps]
    found = np.stack([v / np.linalg.norm(v) for v in found])
    return np.concatenate([found * length * stretch for stretch in _STRETCH])


def _apart(vectors: Float[np.ndarray, "c 3"], order: Int[np.ndarray, " c"]) -> list[int]:
    """Of ordered vectors those that differ in direction from all better ones."""
    units = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    kept: list[int] = []
    for i in order:
        if all(units[i] @ units[j] < 0.8 for j in kept):
            kept.append(int(i))
    return kept
