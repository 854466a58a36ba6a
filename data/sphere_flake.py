"""Builds the sphere flake: a sphere that bears nine of a third of its size, and these nine more.

The scene "balls" of Eric Haines, "A Proposal for Standard Graphics Environments", IEEE CG&A 7(11),
1987, with its floor, eye, three lights and colours; mirrors and highlights as in its pictures. The
spheres' places follow from its words: nine on the half turned away from the parent, six of them
around its equator, three above these.

    python data/sphere_flake.py flake.txt 4     # writes the scene file of 7,381 spheres
"""

import sys

import numpy as np

import spheretrace_jax as st

EYE, WIDTH_OF_VIEW = np.array([2.1, 1.3, 1.7]), np.radians(45)
LIGHTS = [[4.0, 3, 2], [1, -4, 4], [-3, 1, 5]]


def child_directions() -> np.ndarray:
    """Returns the nine directions in which a sphere that points up bears others."""
    root = np.sqrt(0.5)
    trio = np.array([[root, root, 0], [root, 0, -root], [0, root, -root]])
    # so that one of the three stands above the equator and two lie on it
    axis, angle = np.array([1, -1, 0]) * root, np.arcsin(2 / np.sqrt(6))
    trio = trio @ rotation(axis, angle).T
    thirds = [rotation(np.array([0, 0, 1.0]), 2 * np.pi * k / 3) for k in range(3)]
    return np.concatenate([trio @ turn.T for turn in thirds])


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """Returns the matrix of a rotation around a unit axis (Rodrigues' formula)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def from_up(direction: np.ndarray) -> np.ndarray:
    """Returns the rotation that takes up, +z, to a direction by the shortest way."""
    axis = np.array([-direction[1], direction[0], 0])
    length = np.linalg.norm(axis)
    if length < 1e-9:
        return np.eye(3) if direction[2] > 0 else np.diag([-1.0, 1, -1])
    return rotation(axis / length, np.arctan2(length, direction[2]))


def sphere_flake(size_factor: int = 4, reflection: float = 0.3) -> st.Scene:
    """Builds the scene: (9^(size_factor + 1) - 1)/8 spheres over a floor, antialiased."""
    children = child_directions()
    center, up, radius = np.zeros((1, 3)), np.array([[0, 0, 1.0]]), 0.5
    spheres = [(center, np.full(1, radius))]
    for _ in range(size_factor):
        ways = np.concatenate([children @ from_up(direction).T for direction in up])
        center = np.repeat(center, 9, axis=0) + ways * (radius * 4 / 3)
        up, radius = ways, radius / 3
        spheres.append((center, np.full(len(center), radius)))
    center, radius = (np.concatenate(part) for part in zip(*spheres, strict=True))
    mu = np.linalg.norm(EYE)
    return st.Scene(
        st.Spheres(
            center, radius, np.tile([1.0, 0.9, 0.7], (len(center), 1)), ka=0.1, kd=0.5, ks=0.5,
            exponent=15.0, kgr=reflection,
        ),
        st.Lights(LIGHTS, np.full(3, 1 / np.sqrt(3))),
        st.Camera(
            np.arctan2(EYE[1], EYE[0]), np.arccos(EYE[2] / mu), mu, mu,
            2 * mu * np.tan(WIDTH_OF_VIEW / 2),
        ),
        st.Planes([[0, 0, -0.5]], [[0, 0, 1.0]], [[1, 0.75, 0.33]], ka=0.1, kd=0.8, ks=0.0),
        background=[0.078, 0.361, 0.753],
        antialias=1,
    )  # fmt: skip


if __name__ == "__main__":
    st.save_scene(sys.argv[1], sphere_flake(int(sys.argv[2]) if len(sys.argv) > 2 else 4))
