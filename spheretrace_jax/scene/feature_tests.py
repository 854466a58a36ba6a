"""Feature tests: conservative tests of a scene's objects, which `needs` is made of.

The tests run on the host, in float64, once for each picture. A test may find a feature where there
is none, which costs time, but never misses a feature.
"""

import numpy as np
from jaxtyping import Bool, Float

from .scene import Scene

# Limits of the pairwise tests, in spheres: time grows with the square of their number. In scenes
# with more spheres, objects are taken to cross, and all lights are taken to be blocked.
_MOST_CROSSING, _MOST_SHADOWING = 2000, 64


def eye_inside(scene: Scene) -> bool:
    """Tells whether the eye is inside a sphere, on it, or so near that rounding may decide.

    Rays of an orthographic camera start all over the plane through the eye.
    """
    camera = scene.camera
    theta, phi, mu = (np.float64(x) for x in (camera.theta, camera.phi, camera.mu))
    back = np.array([np.sin(phi) * np.cos(theta), np.sin(phi) * np.sin(theta), np.cos(phi)])
    middle = np.zeros(3) if camera.look_at is None else np.asarray(camera.look_at, np.float64)
    center, radius = _spheres(scene)
    from_eye = center - (middle + mu * back)
    far = np.linalg.norm(center, axis=1) + np.linalg.norm(middle) + mu + radius
    distance = np.linalg.norm(from_eye, axis=1)
    if camera.orthographic:
        far, distance = far + distance, np.abs(from_eye @ back)
    slack = 8 * np.finfo(scene.dtype).eps * far
    return bool((distance <= radius + slack).any())


def objects_cross(scene: Scene) -> bool:
    """Tells whether any two objects cross; very many objects are taken to cross."""
    center, radius = _spheres(scene)
    planes = len(scene.planes) + (scene.back_plane is not None)
    if planes > 1 or len(radius) > _MOST_CROSSING or scene.back_plane is not None:
        return True
    for point, normal in zip(scene.planes.point, scene.planes.normal, strict=True):
        normal = np.asarray(normal, np.float64) / np.linalg.norm(normal)
        if (np.abs((center - np.asarray(point)) @ normal) <= radius).any():
            return True
    distance = np.linalg.norm(center[:, None] - center[None], axis=-1)
    outer, inner = radius[:, None] + radius[None], np.abs(radius[:, None] - radius[None])
    cross = (distance <= outer) & (distance >= inner)
    return bool(cross[~np.eye(len(radius), dtype=bool)].any())


def unshadowed_lights(scene: Scene) -> tuple[int, ...]:
    """Finds the lights that no object can block from any other object, seen from outside.

    A sphere fills a cone of the directions from a light, or a cylinder along the way to a
    directional one. The sphere can only block the light from spheres whose cones meet this cone,
    and whose far ends lie beyond the sphere's near end.

    **Returns:** the lights' numbers, from 0.
    """
    center, radius = _spheres(scene)
    if scene.objects > len(radius) or len(radius) > _MOST_SHADOWING:
        return ()
    clear = []
    # a pixel's rounding must not decide either
    slack = 1e3 * np.finfo(scene.dtype).eps * (np.linalg.norm(center, axis=1) + radius)
    bound = radius + slack
    places = np.asarray(scene.lights.position, np.float64)
    for k, (light, directional) in enumerate(zip(places, scene.lights.directional, strict=True)):
        may_block = _cylinders_meet if directional else _cones_meet
        if not may_block(center, bound, light).any():
            clear.append(k)
    return tuple(clear)


def _cones_meet(
    center: Float[np.ndarray, "n 3"], bound: Float[np.ndarray, " n"], light: Float[np.ndarray, " 3"]
) -> Bool[np.ndarray, "n n"]:
    """Tests which spheres may block a light at a point from which; all if it is in a sphere."""
    to_center = center - light
    distance = np.linalg.norm(to_center, axis=1)
    if (distance <= bound).any():
        return np.full((len(bound), len(bound)), True)
    axis = to_center / distance[:, None]
    sine = np.linalg.norm(np.cross(axis[:, None], axis[None]), axis=-1)
    angle = np.arctan2(sine, axis @ axis.T)
    half_angle = np.arcsin(bound / distance)
    cones_meet = angle <= (half_angle[:, None] + half_angle[None]) * (1 + 1e-6)
    nearer = (distance - bound)[:, None] < (distance + bound)[None]
    np.fill_diagonal(cones_meet, False)
    return cones_meet & nearer


def _cylinders_meet(
    center: Float[np.ndarray, "n 3"], bound: Float[np.ndarray, " n"], light: Float[np.ndarray, " 3"]
) -> Bool[np.ndarray, "n n"]:
    """Tests which spheres may block a directional light from which."""
    largest = np.abs(light).max()
    if not largest > 0:
        return np.full((len(bound), len(bound)), True)
    axis = light / largest
    axis = axis / np.linalg.norm(axis)
    apart = center[:, None] - center[None]
    along = apart @ axis
    across = np.linalg.norm(apart - along[..., None] * axis, axis=-1)
    reach = bound[:, None] + bound[None]
    meet = (across <= reach * (1 + 1e-6)) & (along > -reach)
    np.fill_diagonal(meet, False)
    return meet


def any_colored(*colors: object) -> bool:
    """Tells whether red, green and blue of any colour differ."""
    arrays = (np.asarray(color) for color in colors)
    return any(bool((color != color[..., :1]).any()) for color in arrays)


def _spheres(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Returns the spheres' centres and radii in float64."""
    spheres = scene.spheres
    return np.asarray(spheres.center, np.float64), np.asarray(spheres.radius, np.float64)
