"""Scenes that several tests share, each small and with one feature in its name."""

import dataclasses
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import spheretrace_jax as st


def _texture(seed: int) -> st.Texture:
    return st.Texture(np.random.default_rng(seed).uniform(0.2, 1, (6, 12, 3)))


def _spheres(**changes) -> st.Spheres:
    columns = dict(
        center=[[-60.0, -30, 0], [50, 40, -40], [10, -20, 90]],
        radius=[60.0, 70, 25],
        color=[[0.8, 0.3, 0.2], [0.2, 0.7, 0.4], [0.5, 0.5, 0.9]],
        ka=[0.2, 0.15, 0.3],
        kd=[0.6, 0.7, 0.5],
        ks=[0.4, 0.2, 0.5],
        exponent=[5.0, 20, 2],
    )
    return st.Spheres(**(columns | changes))


_EMPTY = st.Scene(st.Spheres(np.zeros((0, 3)), np.zeros(0)), st.Lights(np.zeros((0, 3))))
#: Needs of coloured objects in ambient light.
FLAT = dataclasses.replace(st.needs(_EMPTY), colors=True, depth=None)

WHITE = [[300.0, 350, 400]]
TWO_LIGHTS = st.Lights([[300.0, 350, 400], [-250, 100, 300]], [[0.5, 0.6, 0.3], [0.4, 0.2, 0.5]])
CAMERA = st.Camera(0.3, 0.4, 500.0, 900.0)
TABLE = st.Planes([[0.0, 0, -80]], [[0.05, 0.1, 2]], (0.5, 0.4, 0.3), ks=0.3, exponent=8.0)

SCENES = {
    "diffuse": st.Scene(_spheres(ks=0.0), st.Lights([[0.0, 0, 900]]), CAMERA),
    "shadows": st.Scene(_spheres(), st.Lights(WHITE), CAMERA),
    "two_coloured_lights": st.Scene(_spheres(), TWO_LIGHTS, CAMERA),
    "mirrors": st.Scene(_spheres(kgr=[0.5, 0.0, 0.3]), st.Lights(WHITE), CAMERA),
    "bubbles": st.Scene(_spheres(kt=[0.0, 0.0, 0.6], kgr=[0.4, 0, 0]), st.Lights(WHITE), CAMERA),
    "glass": st.Scene(
        _spheres(kt=[0.3, 0.0, 0.6], kgr=[0.4, 0.2, 0.2]),
        st.Lights(WHITE),
        CAMERA,
        background=(0.1, 0.2, 0.3),
    ),
    "planes": st.Scene(
        _spheres(kgr=0.2),
        st.Lights(WHITE),
        CAMERA,
        eqx.tree_at(
            lambda p: (p.checker_color, p.checker_size, p.kgr),
            TABLE,
            (jnp.array([[0.9, 0.8, 0.1]]), jnp.array([37.0]), jnp.array([0.3])),
        ),
        back_plane=st.BackPlane((0.3, 0.5, 0.6)),
    ),
    "textures": st.Scene(
        _spheres(pic=(1, 0, 2), kgr=[0.0, 0.4, 0]),
        TWO_LIGHTS,
        CAMERA,
        textures=[_texture(1), _texture(2)],
        background=(0.1, 0.2, 0.3),
        sky=_texture(3),
    ),
    "coated": st.Scene(
        _spheres(ior=[1.5, 1.0, 1.2]),
        st.Lights(WHITE),
        CAMERA,
        st.Planes([[0.0, 0, -80]], [[0.05, 0.1, 2]], (0.5, 0.4, 0.3), ior=1.7),
    ),
    "inside": st.Scene(
        st.Spheres([[0.0, 0, 0], [40, 60, 50]], [400.0, 50], ks=0.3, kgr=[0.3, 0.2]),
        st.Lights([[150.0, -100, 100]]),
        st.Camera(0.3, 0.7, 200.0, 300.0),
    ),
}


def three_apart(*lights, **changes) -> st.Scene:
    """Makes three matt and shiny spheres side by side, seen along -z."""
    columns = dict(
        center=[[-90.0, 60, 0], [80, 70, 60], [10, -90, -40]],
        radius=[80.0, 60, 90],
        color=[[0.8, 0.3, 0.2], [0.2, 0.7, 0.4], [0.5, 0.5, 0.9]],
        ka=[0.2, 0.15, 0.3],
        kd=[0.6, 0.5, 0.4],
        ks=[0.4, 0.2, 0.3],
        exponent=[5.0, 60, 20],
    )
    lights = st.Lights(np.reshape(lights, (-1, 3)).astype(float))
    return st.Scene(st.Spheres(**(columns | changes)), lights, st.Camera(0.0, 0.0, 1200.0, 1200.0))


def nine_spheres(light=(100.0, 900.0, 300.0), dtype=np.float64) -> st.Scene:
    """Loads the lecture's scene, not antialiased, by default with a light that casts shadows."""
    scene = st.load_scene(Path(__file__).parents[2] / "data" / "nine_spheres.txt", dtype)
    scene = eqx.tree_at(lambda s: s.lights.position, scene, jnp.asarray([light], dtype))
    return scene.with_antialias(0)


def three_spheres(antialias: int = 0) -> st.Scene:
    """Makes two spheres over a large one, with shadows."""
    spheres = st.Spheres(
        [[-30.0, 10, 0], [40, -20, 60], [0, 0, -1100]],
        [60.0, 45, 1000],
        [[0.9, 0.2, 0.1], [0.1, 0.8, 0.3], [0.5, 0.5, 0.9]],
        ka=0.2, kd=0.7, ks=0.3, exponent=20.0,
    )  # fmt: skip
    camera = st.Camera(-np.pi / 2, 0.0, 500.0, 800.0)
    return st.Scene(spheres, st.Lights([[200.0, 300, 500]]), camera, antialias=antialias)


def assert_same(a: st.Scene, b: st.Scene) -> None:
    """Asserts equality in every bit, also of -0 and subnormal numbers, and of static fields."""
    (a_arrays, a_static), (b_arrays, b_static) = (
        eqx.partition(a, eqx.is_array),
        eqx.partition(b, eqx.is_array),
    )
    assert jax.tree.structure(a_static) == jax.tree.structure(b_static)
    for x, y in zip(jax.tree.leaves(a_arrays), jax.tree.leaves(b_arrays), strict=True):
        assert (x.dtype, x.shape) == (y.dtype, y.shape)
        assert np.asarray(x).tobytes() == np.asarray(y).tobytes()


def with_camera(scene: st.Scene, **changes) -> st.Scene:
    """Returns the scene seen by a camera with other numbers."""
    return eqx.tree_at(lambda s: s.camera, scene, dataclasses.replace(scene.camera, **changes))


#: Cameras as photographs have them, as changes of another camera.
VIEWS = {
    "rolled": dict(roll=0.4),
    "looking aside": dict(look_at=jnp.array([30.0, -20, 10])),
    "off the middle": dict(principal_point=jnp.array([0.12, -0.2])),
    "wide pixels": dict(pixel_aspect=1.6),
    "all": dict(
        roll=-0.7,
        look_at=jnp.array([-10.0, 15, 20]),
        principal_point=jnp.array([-0.1, 0.06]),
        pixel_aspect=0.7,
    ),
    "orthographic": dict(orthographic=True, window=320.0),
    "orthographic, all": dict(
        orthographic=True,
        window=320.0,
        roll=-0.7,
        look_at=jnp.array([-10.0, 15, 20]),
        principal_point=jnp.array([-0.1, 0.06]),
        pixel_aspect=0.8,
    ),
}
