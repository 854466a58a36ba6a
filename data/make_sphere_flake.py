"""Builds the sphere flake: a sphere that bears nine of a third of its size, and these nine more.

The scene "balls" of Eric Haines, "A Proposal for Standard Graphics Environments", IEEE CG&A 7(11),
1987, with its floor, eye, three lights and colours, as an NFF file. The spheres' places follow from
its words: nine on the half turned away from the parent, six of them around its equator, three above
these.

    python data/make_sphere_flake.py 4 > flake.nff     # the size factor: 7,381 spheres
"""

import sys
from collections.abc import Iterator

import numpy as np

HEADER = """\
# sphere flake of size factor {}: {} spheres
v
from 2.1 1.3 1.7
at 0 0 0
up 0 0 1
angle 45
hither 1
resolution 512 512
b 0.078 0.361 0.753
l 4 3 2
l 1 -4 4
l -3 1 5
f 1 0.75 0.33 0.8 0 0 0 0
p 4
12 12 -0.5
-12 12 -0.5
-12 -12 -0.5
12 -12 -0.5
f 1 0.9 0.7 0.5 0.5 15 0 0
"""


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


def sphere_flake(size_factor: int) -> Iterator[tuple[np.ndarray, float]]:
    """Yields the centres and the radius of each generation, 9^k spheres of radius 1/2 (1/3)^k."""
    children = child_directions()
    center, up, radius = np.zeros((1, 3)), np.array([[0, 0, 1.0]]), 0.5
    yield center, radius
    for _ in range(size_factor):
        ways = np.concatenate([children @ from_up(direction).T for direction in up])
        center = np.repeat(center, 9, axis=0) + ways * (radius * 4 / 3)
        up, radius = ways, radius / 3
        yield center, radius


def flake_text(size_factor: int) -> str:
    """Returns the NFF file of (9^(size_factor + 1) - 1)/8 spheres over a floor."""
    lines = []
    for center, radius in sphere_flake(size_factor):
        lines += [f"s {x:.9g} {y:.9g} {z:.9g} {radius:.9g}" for x, y, z in center]
    return HEADER.format(size_factor, len(lines)) + "\n".join(lines) + "\n"


if __name__ == "__main__":
    if len(sys.argv) != 2 or not sys.argv[1].isdecimal() or int(sys.argv[1]) > 6:
        sys.exit("usage: python data/make_sphere_flake.py SIZE_FACTOR, a number in 0..6")
    sys.stdout.write(flake_text(int(sys.argv[1])))
