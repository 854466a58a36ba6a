"""Points, normals and view directions of all pixels that show a ball."""

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from .camera import Number
from .conic import Ball, BallOutline, outline_distance

Vectors = Float[np.ndarray, "n 3"]


class BallPixels(eqx.Module):
    """The pixels that show a ball, in the order of `picture[mask]`.

    Vectors are in the camera's frame: x right, y down, z forward.
    """

    mask: Bool[np.ndarray, "height width"]  #: which pixels show the ball at their centre
    normals: Vectors  #: outward unit normals at the pixels' centres
    views: Vectors  #: unit vectors from the points to the camera
    depth: Float[np.ndarray, " n"]  #: distance of the pixels' centres to the outline, pixels
    ball: Ball  #: centre of the ball, in radii

    @property
    def points(self) -> Vectors:
        """The points that the pixels show, in radii, in the camera's frame."""
        return self.ball.center + self.normals


def ball_pixels(outline: BallOutline, size: tuple[int, int], *, margin: Number = 0.0) -> BallPixels:
    """Computes what each pixel of a ball shows, exact for perspective and orthographic cameras.

    **Arguments:** `size`: (height, width) of the picture. `margin`: leaves pixels out whose centre
    is closer to the outline than this, in pixels: they show a part of the background.
    """
    rows, columns = _box(outline, size)
    y, x = np.mgrid[rows, columns]
    points = np.stack([x, y], -1).reshape(-1, 2) + 0.5
    depth = outline_distance(points, outline.numbers, outline.intrinsics)[0]
    normals, views, hit = ball_hits(points, outline)
    inside = hit & (depth >= margin)
    mask = np.zeros(size, bool)
    mask[rows, columns] = inside.reshape(y.shape)
    return BallPixels(mask, normals[inside], views[inside], depth[inside], outline.ball())


def ball_hits(
    points: Float[np.ndarray, "n 2"], outline: BallOutline
) -> tuple[Vectors, Vectors, Bool[np.ndarray, " n"]]:
    """Intersects the rays through points of the picture with a ball.

    **Arguments:** `points`: (x, y) in pixels.

    **Returns:** outward unit normals, unit vectors to the camera, and which rays hit the ball. A
    ray that misses the ball gets the normal of the outline next to it.
    """
    camera = outline.intrinsics
    if camera.orthographic:
        forward = np.broadcast_to(np.array([0.0, 0, 1]), (len(points), 3))
        across = np.column_stack([(points - outline.center) / outline.radius, 0 * points[:, 0]])
    else:
        q = points - camera.principal_point
        forward = np.column_stack([q / camera.focal, np.ones(len(q))])
        forward /= np.linalg.norm(forward, axis=1, keepdims=True)
        center = outline.ball().center
        across = (forward @ center)[:, None] * forward - center  # from the centre to the ray
    length = np.sqrt((across * across).sum(1))
    hit = length <= 1
    across = across / np.where(hit, 1, length)[:, None]
    along = np.sqrt(np.where(hit, (1 - length) * (1 + length), 0))
    return across - along[:, None] * forward, -forward, hit


def _box(outline: BallOutline, size: tuple[int, int]) -> tuple[slice, slice]:
    """Returns the rows and columns that hold the outline, within the picture."""
    half = np.sqrt(np.diag(outline.ellipse.shape))
    low = np.floor(outline.ellipse.center - half).astype(int)
    high = np.ceil(outline.ellipse.center + half).astype(int) + 1
    columns, rows = (slice(*np.clip([low[i], high[i]], 0, size[1 - i]).tolist()) for i in (0, 1))
    return rows, columns
