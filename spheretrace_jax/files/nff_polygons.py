"""Polygons of other programs' scenes: those that bound the scene become whole planes.

Planes here have no edges. A floor or a wall, with the rest of the scene on one side, looks much the
same without its edges. The plane of a face in the middle of a scene would cut the rest, so such a
face is left out.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .tokens import Token
from .view import unit_vector

# How far vertices may be from the plane of a polygon, and spheres behind it, as a part of the size
# of the scene: files have six digits.
_ROUNDING = 1e-4

# Numbers of a table of distances, polygons by points: a few megabytes.
_TABLE = 1_000_000


class Polygon(NamedTuple):
    """A polygon of a file: its first token, the number of its fill, and its vertices."""

    token: Token
    fill: int
    vertices: Float[np.ndarray, "vertices columns"]  #: columns 3 to 5 are normals, if there are any


def bounding_planes(
    polygons: list[Polygon],
    solid: Float[np.ndarray, "points 4"],
    say: Callable[[Token, str], None],
) -> list[tuple[Polygon, np.ndarray, np.ndarray]]:
    """Chooses the polygons that become planes: all of the scene is on one side of these.

    **Arguments:** `solid`: centres and radii of what must be on one side, the eye first. `say`:
    called with a token and what became of its polygon.

    **Returns:** for each plane the polygon, a point and the unit normal toward the eye.
    """
    size = max((np.ptp(p.vertices[:, :3], axis=0).max() for p in polygons), default=0.0)
    flat, faces = [], []
    for polygon in polygons:
        normal = _normal(polygon.vertices[:, :3])
        if normal is None:
            say(polygon.token, "polygon: left out, as its vertices are in no one plane")
        else:
            flat.append(polygon)
            faces.append((normal, polygon.vertices[0, :3]))
    if not flat:
        return []
    vertices = np.concatenate([np.pad(p.vertices[:, :3], ((0, 0), (0, 1))) for p in flat])
    solid = np.concatenate([solid, np.unique(vertices, axis=0)])
    size = max(size, float(np.ptp(solid[:, :3], axis=0).max()))
    planes: list[tuple[Polygon, np.ndarray, np.ndarray]] = []
    step = max(_TABLE // len(solid), 1)
    for start in range(0, len(flat), step):
        part = slice(start, start + step)
        normals = np.array([normal for normal, _ in faces[part]])
        offset = np.einsum("pi,pi->p", normals, np.array([point for _, point in faces[part]]))
        apart = solid[:, :3] @ normals.T - offset
        side = np.where(apart[0] < 0, -1.0, 1.0)
        # at least the radius of each sphere on the eye's side, and the eye off the plane
        clear = ((apart * side - solid[:, 3:]).min(axis=0) > -_ROUNDING * size) & (
            np.abs(apart[0]) > _ROUNDING * size
        )
        for polygon, (normal, point), good, way in zip(
            flat[part], faces[part], clear, side, strict=True
        ):
            if good:
                _add(planes, (polygon, point, normal * way), size, say)
            else:
                say(polygon.token, "polygon: left out, as its whole plane would cut the scene")
    return planes


def _normal(vertices: Float[np.ndarray, "vertices 3"]) -> np.ndarray | None:
    """Returns the unit normal of a polygon by its first edges, None if it is not flat."""
    edges = vertices[1:] - vertices[0]
    size = np.abs(edges).max()
    if size == 0:
        return None
    crossed = np.cross(edges[:-1] / size, edges[1:] / size)
    largest = crossed[np.argmax(np.einsum("ni,ni->n", crossed, crossed))]
    if np.linalg.norm(largest) < _ROUNDING**2:
        return None
    normal = unit_vector(largest)
    return normal if np.abs(edges @ normal).max() <= _ROUNDING * size else None


def _add(
    planes: list[tuple[Polygon, np.ndarray, np.ndarray]],
    plane: tuple[Polygon, np.ndarray, np.ndarray],
    size: float,
    say: Callable[[Token, str], None],
) -> None:
    """Adds a plane, unless one of those before is the same plane."""
    polygon, point, normal = plane
    for other, place, upward in planes:
        if normal @ upward > 1 - _ROUNDING**2 and abs((point - place) @ normal) < _ROUNDING * size:
            if polygon.fill != other.fill:
                say(
                    polygon.token,
                    "polygon: left out, as the plane of the polygon of another fill on line "
                    f"{other.token.line} is there",
                )
            return
    planes.append(plane)
    say(polygon.token, "polygon: the whole plane, without edges")
    if polygon.vertices.shape[1] > 3:
        turned = np.abs(polygon.vertices[:, 3:] @ normal)
        if (turned < (1 - _ROUNDING) * np.linalg.norm(polygon.vertices[:, 3:], axis=1)).any():
            say(polygon.token, "normals of a polygon's vertices: the plane is flat")
