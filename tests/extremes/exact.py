"""The lecture's rays and shading in numbers of 50 digits, pixel by pixel.

No code is shared with the renderer. Scenes of exact numbers are `Scene`s whose arrays hold mpmath's
numbers.
"""

import jax
import mpmath
import numpy as np

import spheretrace_jax as st

EXACT = mpmath.MPContext()
EXACT.dps = 50
STEP = EXACT.mpf(10) ** -20

#: Vectors are arrays of three exact numbers.
Number = mpmath.mpf
Vector = np.ndarray

to_exact = np.vectorize(lambda number: EXACT.mpf(float(number)), otypes=[object])
to_float = np.vectorize(float, otypes=[float])


def exact(scene: st.Scene) -> st.Scene:
    """Converts the numbers of a scene to exact numbers."""
    return jax.tree.map(lambda leaf: to_exact(np.asarray(leaf)), scene)


def length(v: Vector) -> Number:
    return EXACT.sqrt(v @ v)


def unit(v: Vector) -> Vector:
    return v / length(v) if any(v) else v


def sphere_roots(o: Vector, d: Vector, c: Vector, radius: Number) -> list[Number]:
    """Returns the two t, or none, at which o + t d meets a sphere, for d of any length."""
    oc = c - o
    along, square = oc @ d / (d @ d), radius**2 - line_distance(o, d, c) ** 2
    if square < 0:
        return []
    half = EXACT.sqrt(square / (d @ d))
    return [along - half, along + half]


def line_distance(o: Vector, d: Vector, c: Vector) -> Number:
    """Returns the distance of a line from a point."""
    oc = c - o
    return length(oc - d * (oc @ d / (d @ d)))


def ray(camera: st.Camera, column: int, row: int, size: tuple[int, int]) -> tuple[Vector, Vector]:
    """Returns the eye and the unit direction through the centre of a pixel."""
    theta, phi, mu, distance, window = (x[()] for x in map(np.asarray, jax.tree.leaves(camera)))
    (st_, ct), (sp, cp) = [(EXACT.sin(x), EXACT.cos(x)) for x in (theta, phi)]
    eye = mu * np.array([sp * ct, sp * st_, cp])
    right, up = np.array([-st_, ct, 0]), np.array([-ct * cp, -st_ * cp, sp])
    width, height = size
    pitch = window / height
    x = (column + EXACT.mpf(1) / 2 - EXACT.mpf(width) / 2) * pitch
    y = -(row + EXACT.mpf(1) / 2 - EXACT.mpf(height) / 2) * pitch
    forward = -np.array([sp * ct, sp * st_, cp])
    return eye, unit(x * right + y * up + distance * forward)


def pixel(
    scene: st.Scene, column: int, row: int, size: tuple[int, int], bounces: int = 0
) -> Vector:
    """Returns the colour of a ray, with Phong's highlight, for a `scene` of exact numbers."""
    return _color(scene, *ray(scene.camera, column, row, size), bounces, None)


def picture(scene: st.Scene, size: tuple[int, int], bounces: int = 0) -> np.ndarray:
    """Returns all pixels as exact numbers, of shape `(height, width, 3)`."""
    width, height = size
    rows = [[pixel(scene, i, j, size, bounces) for i in range(width)] for j in range(height)]
    return np.array(rows)


def slope(scene: st.Scene, array: int, move: np.ndarray, value) -> Number:
    """Returns the derivative of a value as an array of a scene moves, by a central difference.

    The step is 1e-20 of the move, so that the error is of the order of 1e-30.
    """
    leaves, structure = jax.tree.flatten(scene)

    def value_at(step: Number) -> Number:
        moved = [*leaves[:array], leaves[array] + step * move, *leaves[array + 1 :]]
        return value(jax.tree.unflatten(structure, moved))

    return (value_at(STEP) - value_at(-STEP)) / (2 * STEP)


def _color(scene: st.Scene, o: Vector, d: Vector, bounces: int, source_hit: tuple | None) -> Vector:
    s, lights = scene.spheres, scene.lights
    hit = _closest_hit(s, o, d, source_hit)
    if hit is None:
        return scene.background
    t, i, inside = hit
    point = o + t * d
    normal = (point - s.center[i]) / s.radius[i] * (-1 if inside else 1)
    m = len(lights)
    color = s.ka[i] * s.color[i] * (lights.color.sum(0) / m if m else 0)
    for light, tint in zip(lights.position, lights.color, strict=True):
        to_light = unit(light - point)
        cosine = normal @ to_light
        if cosine > 0 and not any(_occludes(s, k, point, light, i, inside) for k in range(len(s))):
            mirrored = 2 * cosine * normal - to_light
            shine = max(-(mirrored @ d), 0) ** s.exponent[i]
            color = color + tint * (s.kd[i] * cosine * s.color[i] + s.ks[i] * shine)
    if bounces and s.kgr[i] != 0:
        onward = d - 2 * (d @ normal) * normal
        color = color + s.kgr[i] * _color(scene, point, onward, bounces - 1, (i, inside))
    return color


def _closest_hit(s: st.Spheres, o: Vector, d: Vector, source_hit: tuple | None) -> tuple | None:
    """Returns the closest sphere: t, its number, and whether the hit is inside."""
    best = None
    for i in range(len(s)):
        roots = sphere_roots(o, d, s.center[i], s.radius[i])
        if source_hit is not None and source_hit[0] == i:
            roots = roots[1:] if source_hit[1] else []
        ahead = [t for t in roots if t > 0]
        if ahead and (best is None or ahead[0] < best[0]):
            best = ahead[0], i, ahead[0] == roots[-1]
    return best


def _occludes(s: st.Spheres, k: int, point: Vector, light: Vector, i: int, inside: bool) -> bool:
    """Returns whether sphere k meets the open segment from a point of sphere i to a light."""
    roots = sphere_roots(point, light - point, s.center[k], s.radius[k])
    if k == i:  # one root is the point itself
        return inside and roots[-1] < 1
    return any(0 < t < 1 for t in roots)
