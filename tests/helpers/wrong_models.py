"""Pictures of a ball that the scene's model explains, and of some that it does not."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import spheretrace_jax as st

SIZE = dict(width=32, height=32, bounces=0)


def ball(light, **changes) -> st.Scene:
    """Makes a ball that fills two thirds of the picture's width."""
    columns = dict(color=[[0.7, 0.5, 0.4]], ka=0.1, kd=0.7, ks=0.3, exponent=20.0)
    spheres = st.Spheres([[0.0, 0, 0]], [100.0], **(columns | changes))
    return st.Scene(spheres, st.Lights([light]), st.Camera(0.0, 0.0, 600.0, 1200.0))


TRUTH = ball([500.0, 400, 700])


def moved(truth: st.Scene) -> st.Scene:
    """Returns a start with another light and colour."""
    places = lambda s: (s.lights.position, s.spheres.color)
    return eqx.tree_at(places, truth, (jnp.asarray([[100.0, 100, 900]]), jnp.full((1, 3), 0.5)))


START = moved(TRUTH)


def drawn(scene: st.Scene, **settings) -> np.ndarray:
    return np.asarray(st.render(scene, **(SIZE | settings)))


def other_highlight(light) -> np.ndarray:
    """Draws the ball with halfway highlights, of another exponent."""
    return drawn(ball(light, exponent=50.0), highlight="blinn")


def ambient_gradient(light) -> np.ndarray:
    """Draws the ball with more ambient light from above."""
    picture = drawn(ball(light))
    return picture + 0.1 * np.linspace(1, 0, len(picture))[:, None, None] * (picture > 0)


def texture(light) -> np.ndarray:
    """Draws the ball with patches of 5 x 5 pixels that are 10 % brighter or darker."""
    picture = drawn(ball(light))
    patches = np.random.default_rng(0).standard_normal((7, 7))
    return picture * (1 + 0.1 * np.kron(patches, np.ones((5, 5)))[:32, :32, None])


WRONG = {"highlight": other_highlight, "ambient": ambient_gradient, "texture": texture}
