"""Random scenes in which each feature of a scene is there or not, whatever stands beside it."""

from typing import Any

import numpy as np

import spheretrace_jax as st


def random_scene(seed: int, dtype: Any = np.float64) -> st.Scene:
    """Returns the scene of a seed: the same at every call, its eye in a sphere or outside all.

    One to eight spheres, which may overlap; up to three lights, two planes and two textures.
    """
    random = np.random.default_rng(seed)
    some = lambda part=0.5: bool(random.uniform() < part)
    number = lambda low, high, *shape: random.uniform(low, high, shape).astype(dtype)
    # a coefficient that is 0 everywhere, or on some objects only
    sparse = lambda rows, high, part=0.5: (
        number(0.1, high, rows) * (random.uniform(size=rows) < 0.6) * some(part)
    )
    texture = lambda: st.Texture(number(0, 1, random.integers(1, 7), random.integers(1, 9), 3))

    n, m, p = random.integers(1, 9), random.choice([0, 1, 2, 3], p=[0.1, 0.4, 0.3, 0.2]), 0
    if some():
        p = random.integers(1, 3)
    textures = [texture() for _ in range(random.integers(1, 3))] if some(0.4) else []
    eye_distance = number(300, 600)
    center, radius = number(-170, 170, n, 3), number(25, 110, n)
    if some(0.3):  # the eye is in the last sphere, and with it most or all of the world
        center[-1], radius[-1] = number(-30, 30, 3), eye_distance + number(60, 400)
    exponent = random.choice([0, 1, 2.5, 20, 70], n + p).astype(dtype)
    spheres = st.Spheres(
        center, radius, number(0, 1, n, 3), number(0, 0.5, n), number(0, 1, n),
        sparse(n, 0.8, 0.8), exponent[:n], sparse(n, 0.7, 0.6), sparse(n, 0.7, 0.4),
        random.integers(0, len(textures) + 1, n).tolist(),
    )  # fmt: skip
    color = number(0.1, 1, m, 3) if some() else np.ones((m, 3), dtype)
    lights = st.Lights(number(-600, 600, m, 3), color)
    # planes pass by the spheres, and most of them also by the eye
    normal = number(-1, 1, p, 3)
    point = normal / np.linalg.norm(normal, axis=-1, keepdims=True) * number(-250, -60, p, 1)
    planes = st.Planes(
        point, normal, number(0, 1, p, 3), number(0, 0.5, p),
        number(0, 1, p), sparse(p, 0.8), exponent[n:], sparse(p, 0.7), number(0, 1, p, 3),
        sparse(p, 80, 0.7),
    )  # fmt: skip
    angles = number(0, 2 * np.pi), number(0, np.pi)
    camera = st.Camera(*angles, eye_distance, number(500, 1000), number(400, 700))
    return st.Scene(
        spheres,
        lights,
        camera,
        planes,
        textures,
        number(0, 0.5, 3) if some() else np.zeros(3, dtype),
        texture() if some(0.3) else None,
        st.BackPlane(number(0, 1, 3), *number(0, 1, 2)) if some(0.3) else None,
        antialias=int(some()),
    )
