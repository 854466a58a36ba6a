"""Rays that leave surfaces.
Spheres, eyes and lights of very different sizes, 2^21 or 2^19 trials each in float32, after pbrt's
test of rounding errors. Rays that leave a sphere skip this sphere by its number. So there is no
epsilon, and no scale at which an epsilon would be too small or too large.
"""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from helpers.contexts import context_of

import spheretrace_jax as st
from extremes.case import Case, case
from spheretrace_jax.base.vec import Vec, unit, vec
from spheretrace_jax.scene.camera import Ray
from spheretrace_jax.scene.light import Light
from spheretrace_jax.tracing.context import TraceContext
from spheretrace_jax.tracing.hit import Hit
from spheretrace_jax.tracing.queries import closest_hit, light_visible
from spheretrace_jax.tracing.surface import surface_at

PBRT = "Pharr, Jakob, Humphreys, Physically Based Rendering, 4th ed., 6.8, and its tests"
TRIALS, FEWER = 1 << 21, 1 << 19
EPS = np.finfo(np.float32).eps
NEEDS = dataclasses.replace(st.Needs(), planes=False)
OUTSIDE = dataclasses.replace(NEEDS, inside=False)


def sizes(rng, exponent: float, *shape: int) -> np.ndarray:
    """Draws lengths 10^U[-exponent, exponent] in float32."""
    return (10 ** rng.uniform(-exponent, exponent, shape)).astype(np.float32)


def points(rng, exponent: float, *shape: int) -> np.ndarray:
    """Draws points with such coordinates of random signs."""
    return sizes(rng, exponent, *shape, 3) * rng.choice(np.float32([-1, 1]), (*shape, 3))


def directions(rng, count: int) -> np.ndarray:
    """Draws directions in float32, of any length."""
    return rng.standard_normal((count, 3)).astype(np.float32)


def boxed(rng, center: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Draws points in the boxes around spheres."""
    return center + radius[:, None] * rng.uniform(-1, 1, center.shape).astype(np.float32)


def lengths(v: np.ndarray) -> np.ndarray:
    return np.linalg.norm(v.astype(np.float64), axis=-1)


def _context(center, radius, needs: st.Needs) -> TraceContext:
    scene = st.Scene(st.Spheres(center, radius), st.Lights(jnp.zeros((1, 3))))
    return context_of(scene, needs)


def _rows(v: Vec) -> jax.Array:
    return jnp.stack([v.x, v.y, v.z])


@partial(jax.jit, static_argnames="needs")
def arrive(center, radius, eye, aim, needs: st.Needs = NEEDS) -> tuple[Hit, jax.Array, jax.Array]:
    """Returns the hits of rays from `eye` to `aim`, their points, and normals towards the eye.

    Each trial has its own spheres: `center` of shape `(trials, spheres, 3)`.
    """

    def trial(center, radius, eye, aim):
        context, ray = _context(center, radius, needs), Ray(vec(eye), unit(vec(aim - eye)))
        hit = closest_hit(context, ray)
        surface = surface_at(context, ray, hit)
        return hit, _rows(surface.point), _rows(surface.normal)

    return jax.vmap(trial)(center, radius, eye, aim)


@partial(jax.jit, static_argnames="needs")
def depart(center, radius, hit, point, toward, light, needs: st.Needs = NEEDS) -> tuple:
    """Returns the hits of rays that leave spheres, their directions, and the lights' visibility.

    A hit is the number of the sphere, -1 for a miss.

    **Arguments:** `toward`: directions of any length.
    """

    def trial(center, radius, hit, point, toward, light):
        context, ray = _context(center, radius, needs), Ray(vec(point), unit(vec(toward)))
        again = closest_hit(context, ray, hit).id
        lit = light_visible(context, ray.origin, hit, Light(vec(light), None, False))
        return again, _rows(ray.direction), lit

    return jax.vmap(trial)(center, radius, hit, point, toward, light)


def alone(tried: str, spread: float | None, needs: st.Needs) -> Case:
    """Makes a case of one sphere, whose centre is 10^U[-spread, spread], 0 for None."""

    def check() -> str:
        rng = np.random.default_rng(0)
        radius, eye, light = sizes(rng, 4, TRIALS), points(rng, 8, TRIALS), points(rng, 8, TRIALS)
        center = np.zeros_like(eye) if spread is None else points(rng, spread, TRIALS)
        spheres = center[:, None], radius[:, None]
        hit, point, normal = jax.device_get(
            arrive(*spheres, eye, boxed(rng, center, radius), needs)
        )
        outwards = directions(rng, TRIALS)
        outwards *= np.sign((outwards * normal).sum(1, keepdims=True))
        again, _, lit = jax.device_get(depart(*spheres, hit, point, outwards, light, needs))
        outside = (hit.id == 0) & (lengths(eye - center) > radius)
        front = outside & (((light - point) * normal).sum(1) > 0)
        front &= lengths(light - center) > radius
        false_hits, false_shadows = (outside & (again == 0)).sum(), (front & ~lit).sum()
        assert outside.sum() >= 1e6 and front.sum() >= 4e5, (outside.sum(), front.sum())
        assert false_hits == 0 and false_shadows == 0, (false_hits, false_shadows)
        return f"0 of {outside.sum():,} rays, 0 of {front.sum():,} shadow rays"

    promise = "no ray that leaves outwards hits its source, which blocks no light in front of it"
    return Case(tried, promise, check, PBRT)


_PBRT = "radius 10^U[-4,4], eye and light 10^U[-8,8], centre "
ALONE = [
    alone(_PBRT + "0", None, OUTSIDE),
    alone(_PBRT + "0; eyes may be inside", None, NEEDS),
    alone(_PBRT + "10^U[-4,4]", 4, OUTSIDE),
]


@case(
    "from the inner wall of a sphere, radius 10^U[-4,4], rays as flat as N.D = 10^-6",
    "all hit the wall again; lights inside are visible from the whole wall, lights outside are not",
)
def room() -> str:
    rng = np.random.default_rng(1)
    radius, center = sizes(rng, 4, FEWER), np.zeros((FEWER, 3), np.float32)
    spheres, aim = (center[:, None], radius[:, None]), directions(rng, FEWER)
    hit, point, normal = jax.device_get(arrive(*spheres, center, aim * radius[:, None]))
    across = np.cross(np.float64(normal), directions(rng, FEWER))
    climb = 10 ** rng.uniform(-6, 0, (FEWER, 1))
    toward = (across / lengths(across)[:, None] + climb * normal).astype(np.float32)
    light = 2 * boxed(rng, center, radius)
    again, _, lit = jax.device_get(depart(*spheres, hit, point, toward, light))
    away = lengths(light) / radius
    wrong = (np.abs(away - 1) > 4 * EPS) & (lit != (away < 1))
    leaks = again != 0
    assert (hit.id == 0).all() and hit.inside.all()
    assert not leaks.any() and not wrong.any(), (leaks.sum(), wrong.sum())
    return f"0 of {FEWER:,} rays go through the wall; 0 lights are wrong"


def second(tried: str, spread: float, giant: float | None = None) -> Case:
    """Makes a case of rays and shadow rays from one sphere past another, against float64.

    **Arguments:** `giant`: the radius of a third sphere, below and out of the way.
    """

    def check() -> str:
        rng = np.random.default_rng(2)
        radius, center = sizes(rng, spread, FEWER, 2), points(rng, spread, FEWER, 2)
        eye = center[:, 0] + directions(rng, FEWER) * 10 * radius[:, :1]
        if giant is not None:
            below = np.broadcast_to(np.float32([0, 0, -3 * giant]), (FEWER, 1, 3))
            center = np.concatenate([center, below], axis=1)
            radius = np.concatenate([radius, np.full((FEWER, 1), giant, np.float32)], axis=1)
        hit, point, normal = jax.device_get(
            arrive(center, radius, eye, boxed(rng, center[:, 0], radius[:, 0]))
        )
        toward = boxed(rng, center[:, 1], radius[:, 1]) - point
        light = point + toward * rng.uniform(0.2, 5, (FEWER, 1)).astype(np.float32)
        again, direction, lit = jax.device_get(depart(center, radius, hit, point, toward, light))

        apart = lengths(center[:, 1] - center[:, 0]) > 2 * radius[:, :2].astype(float).sum(1)
        front = ((toward * normal).sum(1) > 0) & (lengths(eye - center[:, 0]) > radius[:, 0])
        good = apart & front & (hit.id == 0)
        oc = center[:, 1] - np.float64(point)
        results = []
        for way, most, met in (
            (direction, np.inf, again == 1),
            (light - np.float64(point), 1, ~lit),
        ):
            way = np.float64(way)
            t = np.clip((oc * way).sum(1) / (way * way).sum(1), 0, most)
            depth = radius[:, 1] - lengths(oc - t[:, None] * way)
            longest = np.maximum(lengths(oc), radius[:, 1])
            if most == 1:
                longest = np.maximum(longest, lengths(way))
            clear = good & (np.abs(depth) > 4 * EPS * longest)
            wrong = clear & (met != (depth > 0))
            results += [wrong.sum(), clear.sum()]
        assert results[0] == results[2] == 0, results
        return "0 of {1:,} rays, 0 of {3:,} shadow rays ({0}, {2})".format(*results)

    promise = (
        "the second is hit, or blocks the light, as in float64, unless the ray passes within 4 ulp"
        " of its surface: ulps of the longest of radius, distance to it and distance to the light"
    )
    return Case(tried, promise, check)


_TWO = "a second sphere, well away; radii and centres 10^U"
SECOND = [
    second(_TWO + "[-4,4]", 4),
    second(_TWO + "[-2,2], near a planet of 1e8", 2, 1e8),
]
