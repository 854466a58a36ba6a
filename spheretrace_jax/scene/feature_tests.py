"""What can happen in a scene, as far as a look at its objects tells: the numbers behind `needs`.

On the host, in float64, once for each picture. Each answer may be yes too often, which costs time,
but never no where it matters.
"""

import numpy as np

from .scene import Scene

# Of more spheres than these, pairs are not looked at one by one.
_MANY, _MANY_IN_SHADOW = 2000, 64


def eye_inside(scene: Scene) -> bool:
    """Whether the eye is inside a sphere or on it, or so near that rounding may decide."""
    theta, phi, mu = (
        np.float64(x) for x in (scene.camera.theta, scene.camera.phi, scene.camera.mu)
    )
    eye = mu * np.array([np.sin(phi) * np.cos(theta), np.sin(phi) * np.sin(theta), np.cos(phi)])
    center, radius = _balls(scene)
    slack = 8 * np.finfo(scene.dtype).eps * (np.linalg.norm(center, axis=1) + mu + radius)
    return bool((np.linalg.norm(center - eye, axis=1) <= radius + slack).any())


def objects_cross(scene: Scene) -> bool:
    """Whether any two objects cut one another. Of very many objects it is taken for granted."""
    center, radius = _balls(scene)
    planes = len(scene.planes) + (scene.back_plane is not None)
    if planes > 1 or len(radius) > _MANY or scene.back_plane is not None:
        return True
    for point, normal in zip(scene.planes.point, scene.planes.normal, strict=True):
        normal = np.asarray(normal, np.float64) / np.linalg.norm(normal)
        if (np.abs((center - np.asarray(point)) @ normal) <= radius).any():
            return True
    apart = np.linalg.norm(center[:, None] - center[None], axis=-1)
    sum_, difference = radius[:, None] + radius[None], np.abs(radius[:, None] - radius[None])
    cut = (apart <= sum_) & (apart >= difference)
    return bool(cut[~np.eye(len(radius), dtype=bool)].any())


def unshadowed_lights(scene: Scene) -> tuple[int, ...]:
    """The lights whose way to every object no other object can block, seen from outside.

    Seen from a light a sphere fills a cone. It can only block the way to spheres whose cones meet
    its own, and that reach farther out than it begins.
    """
    center, radius = _balls(scene)
    if scene.objects > len(radius) or len(radius) > _MANY_IN_SHADOW:
        return ()
    clear = []
    for k, light in enumerate(np.asarray(scene.lights.position, np.float64)):
        away = center - light
        # a pixel's rounding must not decide either
        slack = 1e3 * np.finfo(scene.dtype).eps * (np.linalg.norm(center, axis=1) + radius)
        distance, wide = np.linalg.norm(away, axis=1), radius + slack
        if (distance <= wide).any():
            continue
        turned = away / distance[:, None]
        sine = np.linalg.norm(np.cross(turned[:, None], turned[None]), axis=-1)
        between = np.arctan2(sine, turned @ turned.T)
        half = np.arcsin(wide / distance)
        meet = between <= (half[:, None] + half[None]) * (1 + 1e-6)
        before = (distance - wide)[:, None] < (distance + wide)[None]
        np.fill_diagonal(meet, False)
        if not (meet & before).any():
            clear.append(k)
    return tuple(clear)


def any_colored(*colors: object) -> bool:
    """Whether any colour's red, green and blue are not equal."""
    arrays = (np.asarray(color) for color in colors)
    return any(bool((color != color[..., :1]).any()) for color in arrays)


def _balls(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Centres and radii in float64."""
    spheres = scene.spheres
    return np.asarray(spheres.center, np.float64), np.asarray(spheres.radius, np.float64)
