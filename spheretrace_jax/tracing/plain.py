"""A plain path tracer: the lecture's formulas one by one, to be read beside the slides.

It shares no code with the fast renderer, so tests compare the two and studies take references from
it. A ray is a row: vectors are arrays of shape `(rays, 3)`, numbers are columns `(rays, 1)`.
Letters are the lecture's: O and D are a ray's origin and unit direction, P the point it meets, N
the normal there, V the direction to the viewer, L to a light, R mirrors L, H is halfway between
L and V, S is the surface's colour. Objects are numbered: spheres, planes, the back plane.
"""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._types import Highlight, Picture
from ..errors import InputError
from ..scene import Camera, Scene

Vectors = Float[Array, "#rays 3"]
Numbers = Float[Array, "#rays 1"]
Mask = Bool[Array, "#rays 1"]


class Hit(NamedTuple):
    """The object that each ray meets, and how it meets it."""

    t: Numbers  #: the distance along the ray; 0 where it meets nothing
    object: Int[Array, "rays 1"]  #: its number, -1 for none
    behind: Mask  #: whether a sphere is met from inside, or a plane against its normal


def dot(a: Vectors, b: Vectors) -> Numbers:
    """Multiplies vectors: a.b = a_x b_x + a_y b_y + a_z b_z."""
    return jnp.sum(a * b, axis=-1, keepdims=True)


def length(a: Vectors) -> Numbers:
    """Measures vectors: |a| = sqrt(a.a), with derivative 0 at the zero vector."""
    square = dot(a, a)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)


def unit(a: Vectors) -> Vectors:
    """Scales vectors to length 1: a / |a|; the zero vector stays zero."""
    size = length(a)
    return a / jnp.where(size > 0, size, 1)


def power(cosine: Numbers, n: Numbers) -> Numbers:
    """Raises to the highlight's exponent: max(cosine, 0)^n, with 0^0 = 1."""
    some = cosine > 0
    return jnp.where(some, jnp.where(some, cosine, 1) ** n, jnp.where(n == 0, 1.0, 0.0))


# --- the camera -----------------------------------------------------------------------------------


def camera_axes(camera: Camera) -> tuple[Vectors, Vectors, Vectors, Vectors]:
    """Returns eye, right, up and forward: the lecture's view from azimuth theta, polar angle phi.

    eye = mu (sin phi cos theta, sin phi sin theta, cos phi), and the eye looks at the origin.
    """
    sin, cos = jnp.sin, jnp.cos
    theta, phi, zero = camera.theta, camera.phi, jnp.zeros_like(camera.theta)
    vector = lambda x, y, z: jnp.stack([x, y, z])[None]
    outward = vector(sin(phi) * cos(theta), sin(phi) * sin(theta), cos(phi))
    right = vector(-sin(theta), cos(theta), zero)
    up = vector(-cos(theta) * cos(phi), -sin(theta) * cos(phi), sin(phi))
    return camera.mu * outward, right, up, -outward


def plain_rays(
    camera: Camera,
    columns: Float[Array, " rays"],
    rows: Float[Array, " rays"],
    size: tuple[int, int],
) -> tuple[Float[Array, "rays 3"], Float[Array, "rays 3"]]:
    """Returns camera rays O + t D: from the eye through points of the window on the view plane.

    D is along x right + y up + distance forward. x = (column - width/2) pitch and
    y = (height/2 - row) pitch, with pitch = window/height.

    **Arguments:** `columns`, `rows`: positions in pixels from the picture's left and top edge; the
    centre of pixel (i, j) is at (i + 1/2, j + 1/2). `size`: the picture's (width, height).
    """
    eye, right, up, forward = camera_axes(camera)
    pitch = camera.window / size[1]
    x, y = (columns[:, None] - size[0] / 2) * pitch, (size[1] / 2 - rows[:, None]) * pitch
    direction = unit(x * right + y * up + camera.distance * forward)
    return jnp.broadcast_to(eye, direction.shape), direction


# --- objects --------------------------------------------------------------------------------------


def spheres(scene: Scene) -> Iterator[tuple[int, Vectors, Numbers]]:
    """Yields each sphere's number, centre and radius."""
    for i in range(len(scene.spheres)):
        yield i, scene.spheres.center[i][None], scene.spheres.radius[i][None, None]


def planes(scene: Scene) -> Iterator[tuple[int, Vectors, Vectors]]:
    """Yields each plane's number, a point of it and its unit normal; last the back plane.

    The back plane is the view plane made visible, `distance` before the eye.
    """
    first = len(scene.spheres)
    for j in range(len(scene.planes)):
        yield first + j, scene.planes.point[j][None], unit(scene.planes.normal[j][None])
    if scene.back_plane is not None:
        eye, _, _, forward = camera_axes(scene.camera)
        yield first + len(scene.planes), eye + scene.camera.distance * forward, -forward


def coefficient(scene: Scene, name: str, hit: Hit) -> Numbers:
    """Returns ka, kd, ks, exponent, kgr or kt of the objects met; 0 for rays that meet nothing."""
    absent = jnp.zeros_like(scene.planes.ka)  # no plane transmits
    parts = [getattr(scene.spheres, name), getattr(scene.planes, name, absent)]
    nothing = jnp.zeros(1, scene.dtype)  # the last row, which is that of number -1
    if scene.back_plane is not None:
        parts.append(getattr(scene.back_plane, name, nothing[0])[None])
    return jnp.concatenate([*parts, nothing])[hit.object]


def meet_sphere(O: Vectors, D: Vectors, C: Vectors, R: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """Solves |O + t D - C|^2 = R^2 (slides "Computing Coefficients", "Solving the Equation").

    The roots are t = a -+ sqrt(R^2 - |q|^2), with a = (C - O).D the way to the point of the ray
    nearest to C, and q = C - O - a D from there to C. This form of the discriminant does not
    cancel (Haines, Günther, Akenine-Möller, Ray Tracing Gems, 2019, ch. 7).

    **Returns:** the near and the far root, infinite where the ray misses, and a.
    """
    a = dot(C - O, D)
    q = C - O - a * D
    discriminant = R * R - dot(q, q)
    meets = discriminant > 0
    half_chord = jnp.sqrt(jnp.where(meets, discriminant, 1))
    return jnp.where(meets, a - half_chord, jnp.inf), jnp.where(meets, a + half_chord, jnp.inf), a


def meet_plane(O: Vectors, D: Vectors, point: Vectors, n: Vectors) -> Numbers:
    """Solves (O + t D - point).n = 0: t = (point - O).n / D.n, infinite along the plane."""
    slope = dot(D, n)
    return jnp.where(slope != 0, dot(point - O, n) / jnp.where(slope != 0, slope, 1), jnp.inf)


# --- what rays meet -------------------------------------------------------------------------------


def closest_hit(scene: Scene, O: Vectors, D: Vectors, left: Hit | None = None) -> Hit:
    """Finds the nearest object in front of each ray's origin; of equally near ones, the first.

    A sphere is met at its near root, from inside at its far one. A ray skips the object that it
    leaves, with no epsilon: a sphere is convex. Only a ray mirrored on the inside of a sphere may
    meet that sphere again: its roots are 0 and 2 a.

    **Arguments:** `left`: the hits that the rays leave, None for rays from the eye.
    """
    t = jnp.full_like(D[:, :1], jnp.inf)
    best = Hit(t, jnp.full(t.shape, -1), jnp.full(t.shape, False))

    def nearer(t: Numbers, i: int, behind: Mask) -> Hit:
        closer = (t > 0) & (t < best.t)
        new = Hit(t, jnp.full(t.shape, i), jnp.broadcast_to(behind, t.shape))
        return Hit(*(jnp.where(closer, x, y) for x, y in zip(new, best, strict=True)))

    for i, C, R in spheres(scene):
        near, far, a = meet_sphere(O, D, C, R)
        inside = near <= 0
        t = jnp.where(inside, far, near)
        if left is not None:
            own, again = left.object == i, (left.object == i) & left.behind
            t = jnp.where(again, 2 * a, jnp.where(own, jnp.inf, t))
            inside = inside | again
        best = nearer(t, i, inside)
    for j, point, n in planes(scene):
        t = meet_plane(O, D, point, n)
        if left is not None:
            t = jnp.where(left.object == j, jnp.inf, t)
        best = nearer(t, j, dot(D, n) > 0)
    return best._replace(t=jnp.where(best.object >= 0, best.t, 0))


def light_visible(scene: Scene, P: Vectors, L: Vectors, distance: Numbers, hit: Hit) -> Mask:
    """Tests for shadow: tells whether the segment from P to a light meets no other object.

    It meets one if a root t of the ray P + t L is between 0 and the light's distance. This holds
    too for spheres that contain P, the light or both. The outside of the sphere that P is on stays
    out: if it hid the light, N.L would be negative.
    """
    blocked = jnp.full(distance.shape, False)
    between = lambda t: (t > 0) & (t < distance)
    for i, C, R in spheres(scene):
        near, far, a = meet_sphere(P, L, C, R)
        own = hit.object == i
        wall = jnp.where(own, hit.behind & between(2 * a), between(near) | between(far))
        blocked = blocked | wall
    for j, point, n in planes(scene):
        blocked = blocked | (hit.object != j) & between(meet_plane(P, L, point, n))
    return ~blocked


# --- the surface ----------------------------------------------------------------------------------


def normal(scene: Scene, P: Vectors, hit: Hit) -> Vectors:
    """Returns N, turned to the viewer: (P - C)/R on spheres, the normal of planes."""
    N = jnp.zeros_like(P)
    for i, C, R in spheres(scene):
        N = jnp.where(hit.object == i, (P - C) / R, N)
    for j, _, n in planes(scene):
        N = jnp.where(hit.object == j, n, N)
    return jnp.where(hit.behind, -N, N)


def texture_color(image: Float[Array, "rows columns 3"], direction: Vectors) -> Vectors:
    """Looks up a bitmap around the globe: u = azimuth / 2 pi, v = polar angle / pi from +z.

    The four nearest texels are mixed linearly. It wraps around in u and ends at the poles in v; u
    is 0 at the poles.
    """
    x, y, z = direction[:, :1], direction[:, 1:2], direction[:, 2:]
    pole = (x == 0) & (y == 0)
    u = jnp.arctan2(y, jnp.where(pole, 1, x)) / (2 * jnp.pi)
    v = jnp.arctan2(length(jnp.concatenate([x, y, jnp.zeros_like(z)], axis=-1)), z) / jnp.pi
    rows, columns, _ = image.shape
    column, row = u * columns - 0.5, v * rows - 0.5  # from the centre of the first texel
    j, i = jnp.floor(column), jnp.floor(row)

    def texel(i: Numbers, j: Numbers) -> Vectors:
        i, j = jnp.clip(i, 0, rows - 1), j % columns
        return image[i[:, 0].astype(int), j[:, 0].astype(int)]

    upper = texel(i, j) * (j + 1 - column) + texel(i, j + 1) * (column - j)
    lower = texel(i + 1, j) * (j + 1 - column) + texel(i + 1, j + 1) * (column - j)
    return upper * (i + 1 - row) + lower * (row - i)


def other_square(P: Vectors, point: Vectors, n: Vectors, size: Numbers) -> Mask:
    """Tells whether P is on a checker's other squares, of which one has a corner at `point`.

    Their sides run along the world's x axis laid into the plane, and across it; along y where n is
    nearest to x. A checker of size 0 has none.
    """
    steep = jnp.argmax(jnp.abs(n), axis=-1, keepdims=True) == 0
    axis = jnp.where(steep, jnp.array([[0.0, 1, 0]], n.dtype), jnp.array([[1.0, 0, 0]], n.dtype))
    along = unit(axis - dot(axis, n) * n)
    across = jnp.cross(n, along)
    side = jnp.where(size > 0, size, 1)
    square = jnp.floor(dot(P - point, along) / side) + jnp.floor(dot(P - point, across) / side)
    return (size > 0) & (square % 2 != 0)


def surface_color(scene: Scene, P: Vectors, N: Vectors, hit: Hit) -> Vectors:
    """Returns S: a sphere's colour times its texture's, or the colour of a plane's square."""
    S, outward = jnp.zeros_like(P), jnp.where(hit.behind, -N, N)
    for i, pic in enumerate(scene.spheres.pic):
        color = scene.spheres.color[i][None]
        if pic > 0:
            color = color * texture_color(scene.textures[pic - 1].image, outward)
        S = jnp.where(hit.object == i, color, S)
    tables = scene.planes.color, scene.planes.checker_color, scene.planes.checker_size
    rows = [(color[None], other[None], size[None, None]) for color, other, size in zip(*tables)]
    if scene.back_plane is not None:
        rows.append((scene.back_plane.color[None],) * 2 + (jnp.zeros((1, 1), scene.dtype),))
    for (j, point, n), (color, other, size) in zip(planes(scene), rows, strict=True):
        color = jnp.where(other_square(P, point, n, size), other, color)
        S = jnp.where(hit.object == j, color, S)
    return S


# --- shading --------------------------------------------------------------------------------------


def highlight_term(N: Vectors, L: Vectors, V: Vectors, n: Numbers, highlight: Highlight) -> Numbers:
    """Returns the highlight of a light, with exponent n.

    Phong: max(R.V, 0)^n with R = 2 (N.L) N - L (slide "Specular Reflection"). Blinn:
    max(H.N, 0)^n with H = (L + V)/|L + V| (slide "Halfway Vector").
    """
    if highlight == "phong":
        R = 2 * dot(N, L) * N - L
        return power(dot(R, V), n)
    if highlight == "blinn":
        H = unit(L + V)
        return power(dot(H, N), n)
    raise InputError(f"highlight must be phong or blinn, got {highlight!r}")


def shade(
    scene: Scene, P: Vectors, N: Vectors, V: Vectors, hit: Hit, highlight: Highlight
) -> Vectors:
    """Shades points: C = ka A S + sum over lights of lit C_l (kd (N.L) S + ks highlight).

    C_l is a light's colour, A the mean of all C_l. A point is lit where N.L > 0 and it sees the
    light; else it has its ambient part only.
    """
    ka, kd, ks, n = (coefficient(scene, name, hit) for name in ("ka", "kd", "ks", "exponent"))
    S = surface_color(scene, P, N, hit)
    A = sum(scene.lights.color, jnp.zeros(3, scene.dtype))[None] / max(len(scene.lights), 1)
    C = ka * A * S
    for light, C_l in zip(scene.lights.position, scene.lights.color, strict=True):
        to_light = light[None] - P
        L = unit(to_light)
        lit = (dot(N, L) > 0) & light_visible(scene, P, L, length(to_light), hit)
        diffuse, specular = kd * dot(N, L) * S, ks * highlight_term(N, L, V, n, highlight)
        C = C + jnp.where(lit, C_l[None] * (diffuse + specular), 0)
    return C


# --- paths ----------------------------------------------------------------------------------------


def may_be_used(scene: Scene, name: str) -> bool:
    """Tells whether some kgr or kt is not 0, or not known, as under `jit` and `grad`."""
    parts = [getattr(scene.spheres, name), getattr(scene.planes, name, None)]
    known = [not isinstance(x, jax.core.Tracer) for x in parts]
    return not all(known) or any(np.any(x) for x in parts if x is not None)


def plain_radiance(
    scene: Scene,
    origin: Float[Array, "rays 3"],
    direction: Float[Array, "rays 3"],
    highlight: Highlight = "phong",
    bounces: int = 5,
    left: Hit | None = None,
) -> Float[Array, "rays 3"]:
    """Traces rays and returns their colours: Whitted's recursion (CACM 23(6), 1980).

        color = shade(P) + kgr color(mirrored ray) + kt color(ray straight on)

    The mirrored ray has direction D - 2 (D.N) N. The ray straight on skips the object: a bubble
    without refraction. A ray that meets nothing sees the sky or the background.

    **Arguments:** `origin`, `direction`: as `plain_rays` gives them, directions of unit length.
    `bounces`: the depth of the recursion. `left`: the hits that the rays leave, None for the eye.
    Under `jit` each level doubles the program, unless the scene's kgr or kt are constants.
    """
    O, D = origin, direction
    hit = closest_hit(scene, O, D, left)
    P = O + hit.t * D
    N = normal(scene, P, hit)
    color = shade(scene, P, N, -D, hit, highlight)
    if bounces > 0 and may_be_used(scene, "kgr"):
        mirrored = D - 2 * dot(D, N) * N
        seen = plain_radiance(scene, P, mirrored, highlight, bounces - 1, hit)
        color = color + coefficient(scene, "kgr", hit) * seen
    if bounces > 0 and may_be_used(scene, "kt"):
        through = hit._replace(behind=jnp.full(hit.behind.shape, False))
        seen = plain_radiance(scene, P, D, highlight, bounces - 1, through)
        color = color + coefficient(scene, "kt", hit) * seen
    background = scene.background[None]
    if scene.sky is not None:
        background = texture_color(scene.sky.image, D)
    return jnp.where(hit.object >= 0, color, background)


def plain_picture(
    scene: Scene,
    width: int,
    height: int,
    highlight: Highlight = "phong",
    bounces: int = 5,
    samples: int = 1,
) -> Picture:
    """Traces a picture: linear RGB of shape `(height, width, 3)`, row 0 at the top.

    **Arguments:** `samples`: k for the mean of k x k rays per pixel, at the centres of its parts.
    The scene's antialias flag is ignored.
    """
    row, column = (x.ravel() for x in jnp.indices((height, width), scene.dtype))

    def add(k: int | Int[Array, ""], total: Vectors) -> Vectors:
        right, down = ((x + 0.5) / samples for x in (k % samples, k // samples))
        rays = plain_rays(scene.camera, column + right, row + down, (width, height))
        return total + plain_radiance(scene, *rays, highlight, bounces)

    black = jnp.zeros((width * height, 3), scene.dtype)
    total = add(0, black) if samples == 1 else jax.lax.fori_loop(0, samples**2, add, black)
    return total.reshape(height, width, 3) / samples**2
