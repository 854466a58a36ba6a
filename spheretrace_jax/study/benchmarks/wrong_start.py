"""The wrong start of fits to the nine spheres, for the demo, an example and tests."""

import equinox as eqx
import jax.numpy as jnp

from ...scene.scene import Scene


def wrong_start(truth: Scene) -> Scene:
    """Returns `truth` with all colours 0.5, ka 0.3, kd 0.5, ks 0.2 and its lights displaced."""
    s = truth.spheres
    shift = jnp.asarray([[80, -150, -200]], truth.dtype)
    return eqx.tree_at(
        lambda x: (x.spheres.color, x.spheres.ka, x.spheres.kd, x.spheres.ks, x.lights.position),
        truth,
        (
            jnp.full_like(s.color, 0.5),
            jnp.full_like(s.ka, 0.3),
            jnp.full_like(s.kd, 0.5),
            jnp.full_like(s.ks, 0.2),
            truth.lights.position + shift,
        ),
    )
