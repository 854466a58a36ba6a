"""Rays and spheres.
Roots along rays in float32 are compared with roots in numbers of 50 digits. An ulp is one of the
larger length: the distance to the centre, or the radius.
"""

import jax
import jax.numpy as jnp
import numpy as np

import spheretrace_jax as st
from extremes.case import Case, case
from extremes.exact import EXACT, line_distance, ray, sphere_roots, to_exact
from spheretrace_jax.base.vec import components, vec
from spheretrace_jax.scene.camera import pixel_rays
from spheretrace_jax.tracing.shapes.sphere import ray_sphere

GEMS = "Ray Tracing Gems (2019), ch. 7"
RAYS = 200
EPS = np.finfo(np.float32).eps


def aimed(rng, center, radius, off, eye):
    """Returns directions in float32 from eyes past the centres, `off` radii away from these."""
    across = np.cross(center - eye, rng.standard_normal(np.shape(eye)))
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    distance = np.linalg.norm(center - eye, axis=-1, keepdims=True)
    # the ray touches a sphere of off * radius
    sine = np.minimum(np.asarray(off)[..., None] * radius / distance, 1)
    toward = (center - eye) / distance * np.sqrt(1 - sine**2) + across * sine
    return (toward / np.linalg.norm(toward, axis=-1, keepdims=True)).astype(np.float32)


def roots(eye, direction, center, radius):
    """Returns near and far roots in float32, and exact ones: arrays `(rays, 2)`, nan for a miss."""
    arrays = [np.broadcast_to(x, direction.shape) for x in (eye, direction, center)]
    vectors = (vec(jnp.asarray(x.T, jnp.float32)) for x in arrays)
    found = np.stack(ray_sphere(*vectors, jnp.asarray(radius, jnp.float32)), axis=-1)
    true = [
        sphere_roots(*map(to_exact, row), EXACT.mpf(float(radius))) or [EXACT.nan, EXACT.nan]
        for row in zip(*arrays, strict=True)
    ]
    return found.astype(np.float64), np.array(true).astype(float)


def ulps(off, eye, center, radius):
    """Returns errors in ulps of the distance to the centre, or of the radius."""
    distance = np.linalg.norm(np.float64(center) - np.float64(eye), axis=-1)
    return np.abs(off) / np.spacing(np.maximum(distance, radius).astype(np.float32))[..., None]


def unit_sphere(distance: float) -> Case:
    def check() -> str:
        rng = np.random.default_rng(0)
        center = rng.standard_normal((RAYS, 3))
        center *= distance / np.linalg.norm(center, axis=1, keepdims=True)
        if distance >= 1e7:  # only along an axis is a direction of float32 exact enough
            center = np.eye(3)[rng.integers(0, 3, RAYS)] * distance
        center, eye = center.astype(np.float32), np.zeros((RAYS, 3), np.float32)
        off = rng.uniform(0, 0.7, RAYS) * (distance < 1e7)
        direction = aimed(rng, center.astype(np.float64), 1, off, eye)
        found, true = roots(eye, direction, center, 1)
        assert np.isfinite(true).all()
        worst = ulps(found - true, eye, center, 1).max()
        assert worst <= 4, worst
        return f"{worst:.2g} ulp at most"

    aim = "" if distance < 1e7 else ", seen along an axis"
    promise = f"both roots of {RAYS} rays to 4 ulp"
    return Case(f"a unit sphere {distance:,.0f} away{aim}", promise, check, GEMS)


UNIT_SPHERES = [unit_sphere(d) for d in (1e2, 2e3, 4.1e3, 8e3, 1e5, 1e6, 1e7)]


@case("a sphere of radius 1e6 as a floor, seen from 1 to 1e4 above it", "both roots to 4 ulp", GEMS)
def floor() -> str:
    rng = np.random.default_rng(1)
    center, radius = np.array([0, 0, -1e6]), 1e6
    eye = rng.uniform(-500, 500, (RAYS, 3)).astype(np.float32)
    eye[:, 2] = 10 ** rng.uniform(0, 4, RAYS)
    direction = aimed(rng, center, radius, rng.uniform(0, 0.7, RAYS), eye)
    found, true = roots(eye, direction, center, radius)
    worst = ulps(found - true, eye, center, radius).max()
    assert worst <= 4, worst
    return (
        f"{worst:.2g} ulp at most, which is {worst * np.spacing(np.float32(1e6)):.2g} of the unit"
    )


@case(
    "rays that touch a sphere: past it at 1 +- 10^-7..-2 of its radius, 1 to 1e4 radii away",
    "hits and misses are those of exact numbers, unless the ray passes within 4 ulp of the surface",
)
def tangent() -> str:
    rng, rays = np.random.default_rng(2), 2000
    distance = 10 ** rng.uniform(0.01, 4, (rays, 1))
    center = rng.standard_normal((rays, 3))
    center = (center / np.linalg.norm(center, axis=1, keepdims=True) * distance).astype(np.float32)
    off = 1 + rng.choice([-1, 1], rays) * 10 ** rng.uniform(-7, -2, rays)
    eye = np.zeros((rays, 3), np.float32)
    direction = aimed(rng, center.astype(np.float64), 1, off, eye)
    found, _ = roots(eye, direction, center, 1)
    distances = [
        line_distance(*map(to_exact, row)) for row in zip(eye, direction, center, strict=True)
    ]
    depth = 1 - np.array(distances).astype(float)
    clear = ulps(depth[:, None], eye, center, 1)[:, 0] > 4
    hits = np.isfinite(found[:, 0])
    wrong = clear & (hits != (depth > 0))
    assert not wrong.any(), depth[wrong]
    assert np.isnan(found[~hits]).all()
    return f"{clear.sum()} of {rays} rays pass further off; none is wrong"


@case(
    "eyes on a sphere, and 1 ulp to 1e-3 of the radius inside and outside of it; radii 1e-4..1e4",
    "both roots to 4 ulp, so that the near root is 0 to 4 ulp; eyes 8 ulp inside see the far root",
)
def near_the_surface() -> str:
    rng, worst, shown = np.random.default_rng(3), 0.0, 0
    for radius in np.float32([1e-4, 1e-2, 1, 1e2, 1e4]):
        normal = rng.standard_normal((RAYS, 3))
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        height = rng.choice([-1, 0, 1], RAYS) * 10 ** rng.uniform(-7, -3, RAYS)
        center = rng.uniform(-1, 1, (RAYS, 3)).astype(np.float32) * radius
        eye = (center + normal * (1 + height[:, None]) * radius).astype(np.float32)
        # up to 64 degrees from the normal, inwards or outwards
        turn = rng.standard_normal((RAYS, 3))
        turn *= 0.9 / np.linalg.norm(turn, axis=1, keepdims=True)
        direction = normal * rng.choice([-1, 1], (RAYS, 1)) + turn
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        direction = direction.astype(np.float32)
        found, true = roots(eye, direction, center, radius)
        assert (np.isfinite(found) == np.isfinite(true)).all()
        worst = max(worst, np.nanmax(ulps(found - true, eye, center, radius)))
        depth = radius - np.linalg.norm(eye.astype(np.float64) - center, axis=1)
        inside = (depth > 0) & (ulps(depth[:, None], eye, center, radius)[:, 0] > 8)
        assert (found[inside, 0] < 0).all() and (found[inside, 1] > 0).all()
        shown += inside.sum()
    assert worst <= 4, worst
    return f"{worst:.2g} ulp at most; {shown} eyes were so far inside"


@case(
    "windows of 3e-30 to 3e30 at distances of 9e-30 to 9e30, whose squares float32 cannot hold",
    "directions of rays to 2 eps, of length 1",
)
def pixels() -> str:
    centers, size, worst = jnp.arange(5, dtype=jnp.float32) + 0.5, (5, 5), 0.0
    directions = jax.jit(
        lambda camera: pixel_rays(camera, centers[None], centers[:, None], size).direction
    )
    for exponent in range(-30, 31, 3):
        lengths = 9 * 10.0**exponent, 3 * 10.0**exponent
        camera = st.Camera(*map(jnp.float32, (0.3, 0.4, 500, *lengths)))
        found = np.stack(components(directions(camera)), axis=-1)
        exact_camera = jax.tree.map(lambda x: to_exact(np.asarray(x)), camera)
        for row in range(5):
            for column in range(5):
                _, direction = ray(exact_camera, column, row, size)
                off = np.abs(found[row, column] - direction.astype(float)).max()
                worst = max(worst, off / EPS)
    assert worst <= 2, worst
    return f"{worst:.2g} eps at most"
