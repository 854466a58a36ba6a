"""What a picture determines of a scene's colours and lights."""

import jax
import numpy as np

from ...scene.scene import Scene

#: Of all spheres, as functions of the scene: what shows of color, ka, kd and ks.
PRODUCTS = {
    "ka*color": lambda scene: scene.spheres.ka[:, None] * scene.spheres.color,
    "kd*color": lambda scene: scene.spheres.kd[:, None] * scene.spheres.color,
    "ks": lambda scene: scene.spheres.ks,
}


def determined_products(scene: Scene) -> dict[str, np.ndarray]:
    """What a picture determines: the products of colour and coefficients, ks, the lights."""
    arrays = jax.tree.map(np.asarray, scene)
    shown = PRODUCTS | {"light_position": lambda scene: scene.lights.position}
    return {name: of(arrays) for name, of in shown.items()}
