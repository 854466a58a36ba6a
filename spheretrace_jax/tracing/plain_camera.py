"""The plain path tracer's vectors, and its camera. (`plain.py` says what the letters mean.)"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..scene.camera import Camera, with_defaults

Vectors = Float[Array, "#rays 3"]
Numbers = Float[Array, "#rays 1"]


def dot(a: Vectors, b: Vectors) -> Numbers:
    """Returns a.b = a_x b_x + a_y b_y + a_z b_z."""
    return jnp.sum(a * b, axis=-1, keepdims=True)


def length(a: Vectors) -> Numbers:
    """Returns |a| = sqrt(a.a), with derivative 0 at the zero vector."""
    square = dot(a, a)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)


def unit(a: Vectors) -> Vectors:
    """Returns a / |a|; the zero vector stays zero."""
    size = length(a)
    return a / jnp.where(size > 0, size, 1)


def camera_axes(camera: Camera) -> tuple[Vectors, Vectors, Vectors, Vectors]:
    """Returns eye, right, up and forward: the eye is on a sphere and looks at its centre.

    eye = look_at + mu (sin phi cos theta, sin phi sin theta, cos phi). A camera that rolls turns
    right and up by Rodrigues' formula: v cos roll + (forward x v) sin roll.
    """
    c = with_defaults(camera)
    angles = c.phi, c.theta, c.roll
    (sp, cp), (st, ct), (sr, cr) = ((jnp.sin(x), jnp.cos(x)) for x in angles)
    vector = lambda x, y, z: jnp.stack([x, y, z])[None]
    outward = vector(sp * ct, sp * st, cp)
    turn = lambda v: v * cr + jnp.cross(-outward, v) * sr
    eye = c.look_at[None] + c.mu * outward
    return eye, turn(vector(-st, ct, 0 * st)), turn(vector(-ct * cp, -st * cp, sp)), -outward


def plain_rays(
    camera: Camera, columns: Float[Array, " rays"], rows: Float[Array, " rays"], size: tuple
) -> tuple[Vectors, Vectors]:
    """Returns the camera rays E + t D through points of the window, which is on the view plane.

    D is along x right + y up + distance forward, with x = (column - cx) pitch aspect,
    y = (cy - row) pitch and pitch = window/height. The axis is seen at (cx, cy) = (width/2,
    height/2) + height principal_point. Orthographic: E = eye + x right + y up, D = forward.

    **Arguments:** `columns`, `rows`: positions in pixels from the picture's left and top edge; the
    centre of pixel (i, j) is at (i + 1/2, j + 1/2). `size`: the picture's (width, height).
    """
    c, (eye, right, up, forward) = with_defaults(camera), camera_axes(camera)
    pitch, (px, py) = c.window / size[1], c.principal_point
    x = (columns[:, None] - size[0] / 2 - size[1] * px) * pitch * c.pixel_aspect
    y = (size[1] / 2 + size[1] * py - rows[:, None]) * pitch
    across = x * right + y * up
    if c.orthographic:
        return eye + across, jnp.broadcast_to(forward, across.shape)
    return jnp.broadcast_to(eye, across.shape), unit(across + c.distance * forward)
