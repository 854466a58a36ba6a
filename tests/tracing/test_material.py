"""The sum over lights: a loop over lights that are alike equals one term after the other."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.contexts import context_of
from helpers.scenes import SCENES

import spheretrace_jax as st
from spheretrace_jax.base.vec import components
from spheretrace_jax.scene.needs import Needs
from spheretrace_jax.tracing.material import sum_lights

POSITIONS, COLORS = np.random.default_rng(0).uniform(0, 1, (2, 6, 3))


@pytest.mark.parametrize("clear", [(), (0, 3), tuple(range(6))])
@pytest.mark.parametrize("tinted", [True, False])
@pytest.mark.parametrize("directional", [False, (True, False, True, True, False, False)])
def test_loop_over_lights_is_their_sum(clear, tinted, directional):
    colors = COLORS if tinted else COLORS[:, :1] * np.ones((1, 3))
    lights = st.Lights(POSITIONS, colors, directional)
    scene = eqx.tree_at(lambda s: s.lights, SCENES["shadows"], lights)
    needs = Needs(shadows=len(clear) < 6, clear=clear, tinted=tinted)

    context = context_of(scene, needs)

    def terms(light, shadows):
        # a shadow test of a light that nothing can block would change both sums
        x, y = light.place.x, light.place.y
        return jnp.full(2, x + 10.0 * shadows), jnp.full(2, y - 10.0 * shadows)

    loop, unrolled = (sum_lights(context, (2,), terms, most=most) for most in (1, 6))
    shadowed = np.array([i not in clear for i in range(6)])
    length = np.linalg.norm(POSITIONS, axis=1, keepdims=True)
    places = POSITIONS / np.where(np.array(lights.directional)[:, None], length, 1)
    diffuse = (places[:, 0] + 10 * shadowed) @ lights.color
    shine = (places[:, 1] - 10 * shadowed) @ lights.color
    for sums in (loop, unrolled):
        for found, expected in zip(sums, (diffuse, shine), strict=True):
            found = [np.broadcast_to(x, 2)[0] for x in components(found)]
            np.testing.assert_allclose(found, expected, rtol=1e-14)
