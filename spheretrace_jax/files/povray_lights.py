"""POV-Ray's light sources: those at points, parallel ones, and ones that fade."""

import numpy as np

from ..scene.scene import Scene
from .povray_words import number, table_rows, vector

FARTHEST = 1e7  #: POV-Ray's MAX_DISTANCE

# How far outside of the scene, in its sizes, directional lights are put.
_PARALLEL = 1e2

#: D of a light that fades, as a part of its fall-off: a power of 2, so that colours stay exact.
FADING = 2.0**-16


def light_sources(scene: Scene) -> list[str]:
    """Returns the lights, a line each.

    POV-Ray's `parallel` light shines from its location towards `point_at` along one direction
    everywhere, but what lies beyond the plane through its location, across that direction, casts
    and receives no shadow. It is put far outside of the spheres. A fall-off is POV-Ray's factor
    2 / (1 + (r / D)^2), where D is so small that the 1 is lost among rounding errors.
    """
    s, lights, lines = scene.spheres, scene.lights, []
    reach = np.linalg.norm(np.asarray(s.center, np.float64), axis=1) + np.asarray(s.radius)
    far = min(_PARALLEL * max(reach.max(initial=0), float(scene.camera.mu), 1), FARTHEST / 10)
    rows = table_rows(lights.position, lights.color, lights.falloff)
    for (position, color, falloff), directional in zip(rows, lights.directional, strict=True):
        place, kind = position, ""
        if falloff and not directional:
            color = color.astype(np.float64) / (2 * FADING**2)
            kind = f" fade_distance {number(falloff * FADING)} fade_power 2"
        if directional:
            direction = position.astype(np.float64) / np.abs(position).max()
            place = far * direction / np.linalg.norm(direction)
            kind = " parallel point_at <0, 0, 0>"
        lines.append(f"light_source {{ {vector(place)} rgb {vector(color)}{kind} }}")
    return lines
