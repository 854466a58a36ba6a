"""Determined products: the combinations of colours and coefficients that a picture determines."""

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
    """Returns what a picture determines: ka color, kd color, ks, the lights' positions."""
    arrays = jax.tree.map(np.asarray, scene)
    functions = PRODUCTS | {"light_position": lambda scene: scene.lights.position}
    return {name: function(arrays) for name, function in functions.items()}
