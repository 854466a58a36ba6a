"""A chrome ball, drawn in NumPy."""

import numpy as np

from spheretrace_jax.calibration.ball_pixels import ball_hits


def mirror_picture(outline, size, lights, sizes, brightness, fine=4):
    """Draws discs of light at infinity, of angular radii `sizes`, mirrored by a ball."""
    y, x = (np.mgrid[: size[0] * fine, : size[1] * fine] + 0.5) / fine
    normals, views, hit = ball_hits(np.column_stack([x.ravel(), y.ravel()]), outline)
    mirrored = 2 * (normals * views).sum(1, keepdims=True) * normals - views
    picture = np.where(hit, 0.05 + 0.02 * mirrored[:, 0], 0.02)
    for light, size_of_light, bright in zip(lights, sizes, brightness, strict=True):
        picture = np.where(hit & (mirrored @ light > np.cos(size_of_light)), bright, picture)
    return picture.reshape(size[0], fine, size[1], fine).mean((1, 3))
