"""What a picture determines of a scene's colours and lights."""

import numpy as np

from ..scene import Scene


def determined(scene: Scene) -> dict[str, np.ndarray]:
    """What a picture determines: the products of colour and coefficients, ks, the lights."""
    s = scene.spheres
    return {
        "ka*color": np.asarray(s.ka)[:, None] * np.asarray(s.color),
        "kd*color": np.asarray(s.kd)[:, None] * np.asarray(s.color),
        "ks": np.asarray(s.ks),
        "light_position": np.asarray(scene.lights.position),
    }
