"""A plain path tracer: the lecture's formulas one by one, to be read beside the slides.

It shares no code with the fast renderer, so tests compare the two and studies take references from
it. A ray is a row: vectors are arrays of shape `(rays, 3)`, numbers are columns `(rays, 1)`.
Letters are the lecture's: P is the point that a ray meets, N the unit normal there, V the direction
to the viewer, L to a light, R is L mirrored in N, H halfway between L and V, S the surface's
colour. E and D are a ray's start and unit direction, C and R a sphere's centre and radius.
"""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..base.errors import InputError
from ..base.types import Highlight, Picture, Scalar
from ..scene.planes import Planes
from ..scene.scene import Scene
from .plain_camera import Numbers, Vectors, camera_axes, dot, length, plain_rays, unit

Mask = Bool[Array, "#rays 1"]


class Hit(NamedTuple):
    """The object that each ray meets."""

    t: Numbers  #: how far along the ray; 0 where it meets nothing
    id: Int[Array, "rays 1"]  #: spheres are counted first, then planes; -1 for none
    behind: Mask  #: whether a sphere is met from inside, a plane against its normal


def spheres(scene: Scene) -> Iterator[tuple[int, tuple[Vectors, Numbers]]]:
    """Yields each sphere's number, centre C and radius R."""
    s = scene.spheres
    return enumerate(zip(s.center[:, None], s.radius[:, None, None], strict=True))


def planes(scene: Scene) -> Iterator[tuple[int, tuple[Vectors, Vectors]]]:
    """Yields each plane's number, a point of it and its unit normal."""
    p = all_planes(scene)
    rows = zip(p.point[:, None], unit(p.normal)[:, None], strict=True)
    return enumerate(rows, start=len(scene.spheres))


def all_planes(scene: Scene) -> Planes:
    """Returns the planes, last the back plane: the view plane made visible, across the view."""
    if (back := scene.back_plane) is None:
        return scene.planes
    eye, _, _, forward = camera_axes(scene.camera)
    plane = Planes(eye + scene.camera.distance * forward, -forward, back.color, back.ka, back.kd)
    return jax.tree.map(lambda *rows: jnp.concatenate(rows), scene.planes, plane)


def meet_sphere(E: Vectors, D: Vectors, C: Vectors, R: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """Solves |E + t D - C|^2 = R^2 (slides "Computing Coefficients", "Solving the Equation").

    The roots are t = a -+ sqrt(R^2 - |q|^2): a = (C - E).D is the way to the middle of the chord,
    q = C - E - a D leads from there to C. This discriminant does not cancel (Haines, Günther,
    Akenine-Möller, Ray Tracing Gems, 2019, ch. 7).

    **Returns:** the near and the far root, infinite where the ray misses, and a.
    """
    a = dot(C - E, D)
    q = C - E - a * D
    discriminant = R * R - dot(q, q)
    meets = discriminant > 0
    half_chord = jnp.sqrt(jnp.where(meets, discriminant, 1))
    return jnp.where(meets, a - half_chord, jnp.inf), jnp.where(meets, a + half_chord, jnp.inf), a


def meet_plane(E: Vectors, D: Vectors, point: Vectors, n: Vectors) -> Numbers:
    """Solves (E + t D - point).n = 0: t = (point - E).n / D.n, infinite along the plane."""
    slope = dot(D, n)
    return jnp.where(slope != 0, dot(point - E, n) / jnp.where(slope != 0, slope, 1), jnp.inf)


def closest_hit(scene: Scene, E: Vectors, D: Vectors, source: Hit | None = None) -> Hit:
    """Finds the nearest object in front of each ray's start; of equally near ones, the first.

    A sphere is met at its near root, from inside at its far one. A ray skips the object that it
    leaves, with no epsilon, as spheres are convex. Only a ray mirrored on the inside of a sphere
    meets that sphere again: its roots are 0 and 2 a.

    **Arguments:** `source`: the hits that the rays leave, None for rays from the eye.
    """
    nothing = jnp.full(D[:, :1].shape, False)
    source = Hit(0 * D[:, :1], jnp.where(nothing, 0, -2), nothing) if source is None else source
    best = Hit(jnp.full(nothing.shape, jnp.inf, D.dtype), jnp.where(nothing, 0, -1), nothing)

    def nearer(*new: Numbers | int | Mask) -> Hit:
        closer = (new[0] > 0) & (new[0] < best.t)
        return Hit(*(jnp.where(closer, x, y) for x, y in zip(new, best, strict=True)))

    for i, (C, R) in spheres(scene):
        near, far, a = meet_sphere(E, D, C, R)
        own, again = source.id == i, (source.id == i) & source.behind
        t = jnp.where(near > 0, near, far)
        t = jnp.where(again, 2 * a, jnp.where(own, jnp.inf, t))
        best = nearer(t, i, again | (near <= 0))
    for j, (point, n) in planes(scene):
        t = jnp.where(source.id == j, jnp.inf, meet_plane(E, D, point, n))
        best = nearer(t, j, dot(D, n) > 0)
    return best._replace(t=jnp.where(best.id >= 0, best.t, 0))


def light_visible(scene: Scene, P: Vectors, L: Vectors, distance: Numbers, hit: Hit) -> Mask:
    """Tests for shadow: whether the segment from P to a light meets no other object.

    It meets one if a root t of the ray P + t L is between 0 and the light's distance, which is
    infinite for a directional light, also where P or the light is in a sphere. The sphere that P
    is on counts only if P is on its inside: from its outside, N.L < 0 where it is in the way.
    """
    blocked = jnp.full(distance.shape, False)
    between = lambda t: (t > 0) & (t < distance)
    for i, (C, R) in spheres(scene):
        near, far, a = meet_sphere(P, L, C, R)
        own_wall = hit.behind & between(2 * a)
        blocked = blocked | jnp.where(hit.id == i, own_wall, between(near) | between(far))
    for j, (point, n) in planes(scene):
        blocked = blocked | (hit.id != j) & between(meet_plane(P, L, point, n))
    return ~blocked


def normal(scene: Scene, P: Vectors, hit: Hit) -> Vectors:
    """Returns N, turned to the viewer: (P - C)/R on a sphere."""
    N = jnp.zeros_like(P)
    for i, (C, R) in spheres(scene):
        N = jnp.where(hit.id == i, (P - C) / R, N)
    for j, (_, n) in planes(scene):
        N = jnp.where(hit.id == j, n, N)
    return jnp.where(hit.behind, -N, N)


def material(scene: Scene, name: str, hit: Hit) -> Numbers | Vectors:
    """Looks up the color, ka, kd, ks, exponent, kgr, kt or ior of what is met; 0 for nothing."""
    of_spheres, of_planes = getattr(scene.spheres, name), all_planes(scene)
    of_planes = 0 * of_planes.kgr if name == "kt" else getattr(of_planes, name)
    nothing = jnp.zeros((1, *of_spheres.shape[1:]), scene.dtype)  # the last row, that of id -1
    table = jnp.concatenate([of_spheres, of_planes, nothing])
    return table[hit.id[:, 0]].reshape(-1, table[0].size)


def texture_color(image: Float[Array, "rows columns 3"], direction: Vectors) -> Vectors:
    """Looks up a bitmap around the globe: u = azimuth / 2 pi around +z, v = polar angle / pi.

    The four nearest texels are mixed linearly. The bitmap wraps around in u and ends in v; u is 0
    at the poles.
    """
    x, y, z = direction[:, :1], direction[:, 1:2], direction[:, 2:]
    u = jnp.arctan2(y, jnp.where((x == 0) & (y == 0), 1, x)) / (2 * jnp.pi)
    v = jnp.arctan2(length(jnp.concatenate([x, y, 0 * z], axis=1)), z) / jnp.pi
    rows, columns, _ = image.shape
    column, row = u * columns - 0.5, v * rows - 0.5  # the centre of the first texel is at 0, 0
    j, i = jnp.floor(column), jnp.floor(row)

    def texel(i: Numbers, j: Numbers) -> Vectors:
        i, j = jnp.clip(i, 0, rows - 1), j % columns
        return image[i[:, 0].astype(int), j[:, 0].astype(int)]

    upper = texel(i, j) * (j + 1 - column) + texel(i, j + 1) * (column - j)
    lower = texel(i + 1, j) * (j + 1 - column) + texel(i + 1, j + 1) * (column - j)
    return upper * (i + 1 - row) + lower * (row - i)


def second_square(P: Vectors, point: Vectors, n: Vectors, size: Scalar) -> Mask:
    """Tests whether P is on a checker's second squares; no P is where the size is 0.

    A corner of a square is at `point`. Sides run along the world's x axis laid into the plane, and
    across it; along y where n is nearest to x.
    """
    x, y, z = jnp.abs(n[0])
    steep = ((x > y) & (x > z)).astype(n.dtype)
    axis = jnp.stack([1 - steep, steep, 0 * steep])[None]
    along = unit(axis - dot(axis, n) * n)
    side = jnp.where(size > 0, size, 1)
    square = lambda axis: jnp.floor(dot(P - point, axis) / side)
    return (size > 0) & ((square(along) + square(jnp.cross(n, along))) % 2 != 0)


def surface_color(scene: Scene, P: Vectors, N: Vectors, hit: Hit) -> Vectors:
    """Returns S: the object's colour, on spheres times the texture's, on planes the square's."""
    S, outward = material(scene, "color", hit), jnp.where(hit.behind, -N, N)
    for i, pic in enumerate(scene.spheres.pic):
        if pic > 0:
            S = jnp.where(hit.id == i, S * texture_color(scene.textures[pic - 1].image, outward), S)
    checkers = all_planes(scene)
    for k, (j, (point, n)) in enumerate(planes(scene)):
        other = (hit.id == j) & second_square(P, point, n, checkers.checker_size[k])
        S = jnp.where(other, checkers.checker_color[k][None], S)
    return S


def highlight_term(N: Vectors, L: Vectors, V: Vectors, n: Numbers, highlight: Highlight) -> Numbers:
    """Returns the highlight of one light: max(cosine, 0)^n, with 0^0 = 1.

    Phong: the cosine is R.V, R = 2 (N.L) N - L (slide "Specular Reflection"). Blinn: it is H.N,
    H = (L + V)/|L + V| (slide "Halfway Vector").
    """
    if highlight not in ("phong", "blinn"):
        raise InputError(f"highlight must be one of phong, blinn, got {highlight!r}")
    cosine = dot(2 * dot(N, L) * N - L, V) if highlight == "phong" else dot(unit(L + V), N)
    seen = cosine > 0
    return jnp.where(seen, jnp.where(seen, cosine, 1) ** n, jnp.where(n == 0, 1.0, 0.0))


def transmitted(c: Numbers, n: Numbers) -> Numbers:
    """Returns 1 - F (Fresnel): c is the cosine of incidence, t that of refraction (Snell)."""
    t = jnp.sqrt(1 - (1 - c * c) / (n * n))
    r_s, r_p = (c - n * t) / (c + n * t), (n * c - t) / (n * c + t)
    return 1 - (r_s**2 + r_p**2) / 2


def shade(
    scene: Scene, P: Vectors, N: Vectors, V: Vectors, hit: Hit, highlight: Highlight
) -> Vectors:
    """Shades points: C = ka A S + sum over l of lit_l C_l f_l (kd (N.L_l) S + ks highlight_l).

    C_l is a light's colour, A the mean of all. lit_l is 1 where N.L_l > 0 and P sees the light.
    f_l is 1, or (falloff / r)^2 at the distance r of a light with a fall-off. A coat lets
    (1 - F(N.L_l)) (1 - F(N.V)) of N.L_l through (Wolff, JOSA A 11(11), 1994).
    """
    ka, kd, ks, n = (material(scene, name, hit) for name in ("ka", "kd", "ks", "exponent"))
    S, ior = surface_color(scene, P, N, hit), jnp.where(hit.id < 0, 2, material(scene, "ior", hit))
    A = jnp.sum(scene.lights.color, axis=0)[None] / max(len(scene.lights), 1)
    C = ka * A * S
    lights = scene.lights
    rows = zip(lights.position, lights.color, lights.falloff, lights.directional, strict=True)
    for light, C_l, falloff, directional in rows:
        if directional:  # the same L everywhere, and nothing lies behind the light
            L, distance = unit(light[None]), jnp.full_like(P[:, :1], jnp.inf)
            L = jnp.broadcast_to(L, P.shape)
        else:
            L, distance = unit(light[None] - P), length(light[None] - P)
        lit = (dot(N, L) > 0) & light_visible(scene, P, L, distance, hit)
        diffuse = dot(N, L)
        if some(scene.spheres.ior - 1, scene.planes.ior - 1):
            diffuse *= transmitted(jnp.where(lit, diffuse, 1), ior) * transmitted(dot(N, V), ior)
        local = kd * diffuse * S + ks * highlight_term(N, L, V, n, highlight)
        fades = falloff > 0
        ratio = jnp.where(fades, falloff, 1) / jnp.where(fades, distance, 1)
        C = C + jnp.where(lit, C_l[None] * ratio**2 * local, 0)
    return C


def some(*coefficients: Float[Array, " _"]) -> bool:
    """Tests whether any is not 0, or not known yet, as under `jit` and `grad`."""
    return any(isinstance(k, jax.core.Tracer) or np.asarray(k).any() for k in coefficients)


def plain_radiance(
    scene: Scene,
    origin: Vectors,
    direction: Vectors,
    highlight: Highlight = "phong",
    bounces: int = 5,
    source: Hit | None = None,
) -> Vectors:
    """Traces rays and returns their colours: Whitted's recursion (CACM 23(6), 1980).

        color = C + kgr color(mirrored ray) + kt color(ray straight on)

    The mirrored ray has the direction D - 2 (D.N) N. The ray straight on skips the object, a bubble
    without refraction. A ray that leaves the world sees the sky or the background.

    **Arguments:** `origin`, `direction`: of rays, directions of unit length, as from `plain_rays`.
    `bounces`: how deep the recursion goes. If kgr and kt are traced, n bounces are 2^n programs.
    `source`: the hits that the rays leave, None for rays from the eye.
    """
    hit = closest_hit(scene, origin, direction, source)
    P = origin + hit.t * direction
    N = normal(scene, P, hit)
    color = shade(scene, P, N, -direction, hit, highlight)
    if bounces > 0 and some(scene.spheres.kgr, scene.planes.kgr):
        mirrored = direction - 2 * dot(direction, N) * N
        seen = plain_radiance(scene, P, mirrored, highlight, bounces - 1, hit)
        color = color + material(scene, "kgr", hit) * seen
    if bounces > 0 and some(scene.spheres.kt):
        outside = hit._replace(behind=jnp.zeros_like(hit.behind))
        seen = plain_radiance(scene, P, direction, highlight, bounces - 1, outside)
        color = color + material(scene, "kt", hit) * seen
    sky = scene.sky
    background = scene.background[None] if sky is None else texture_color(sky.image, direction)
    return jnp.where(hit.id >= 0, color, background)


def plain_picture(
    scene: Scene,
    width: int,
    height: int,
    highlight: Highlight = "phong",
    bounces: int = 5,
    samples: int = 1,
) -> Picture:
    """Traces a picture: linear RGB of shape `(height, width, 3)`, row 0 at the top.

    **Arguments:** `samples`: k for the mean of k x k rays in each pixel; of these only one is
    traced at a time. The scene's antialias flag is ignored.
    """
    row, column = (x.ravel() for x in jnp.indices((height, width), scene.dtype))

    def add(k: int | Int[Array, ""], total: Vectors) -> Vectors:
        right, down = ((x + 0.5) / samples for x in (k % samples, k // samples))
        rays = plain_rays(scene.camera, column + right, row + down, (width, height))
        return total + plain_radiance(scene, *rays, highlight, bounces)

    black = jnp.zeros((width * height, 3), scene.dtype)
    total = add(0, black) if samples == 1 else jax.lax.fori_loop(0, samples**2, add, black)
    return total.reshape(height, width, 3) / samples**2
