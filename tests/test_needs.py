import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import SCENES, nine_spheres

import spheretrace_jax as st
from spheretrace_jax.needs import left_out

FEATURES = [f.name for f in dataclasses.fields(st.Needs)]


def needed(scene, **options) -> set[str]:
    found = st.needs(scene, **options)
    return {name for name in FEATURES if getattr(found, name)}


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("diffuse", {"shadows"}),
        ("shadows", {"shadows", "highlights"}),
        ("two_coloured_lights", {"shadows", "highlights"}),
        ("mirrors", {"shadows", "highlights", "reflection"}),
        ("bubbles", {"shadows", "highlights", "reflection", "transmission", "inside"}),
        ("glass", {"shadows", "highlights", "reflection", "transmission", "inside", "branching",
                   "background"}),
        ("planes", {"shadows", "highlights", "reflection", "planes", "checkers"}),
        ("textures", {"shadows", "highlights", "reflection", "textures", "background"}),
        ("inside", {"shadows", "highlights", "reflection", "inside"}),
    ],
)  # fmt: skip
def test_needs_are_those_of_the_scene(name, expected):
    assert needed(SCENES[name]) == expected


def test_one_sphere_needs_no_shadow_and_no_lights_need_nothing():
    one = st.Spheres([[0.0, 0, 0]], [40.0], ks=0.5)
    assert needed(st.Scene(one, st.Lights([[9.0, 9, 9]]))) == {"highlights"}
    assert needed(st.Scene(one, st.Lights(np.zeros((0, 3))))) == set()


def test_what_will_be_free_is_needed():
    scene = SCENES["diffuse"]
    assert "highlights" in needed(scene, free=["ks"])
    assert {"reflection", "dark_paths"} <= needed(scene, free=["kgr"])
    assert {"transmission", "inside"} <= needed(scene, free=["kt"])


@pytest.mark.parametrize("free", ["colour", ["kgr", "light"]])
def test_unknown_names_are_refused(free):
    with pytest.raises(st.InputError, match="free must name parameters of the scene"):
        st.needs(SCENES["diffuse"], free=free)
    assert st.needs(SCENES["diffuse"], free="kgr").reflection


def test_needs_are_static_hashable_and_equal_for_scenes_alike():
    first, second = (st.needs(nine_spheres(light)) for light in ((100.0, 900, 300), (0.0, 0, 900)))
    assert first == second and hash(first) == hash(second)


@pytest.mark.parametrize("transform", [jax.jit, jax.grad, jax.vmap])
def test_under_a_trace_they_must_be_passed(transform):
    scene = SCENES["diffuse"]
    if transform is jax.vmap:
        scene = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), scene)
    with pytest.raises(ValueError, match="pass needs=needs"):
        transform(lambda s: jnp.sum(st.render(s, width=4, height=4)))(scene)


@pytest.mark.parametrize("name", SCENES)
def test_leaving_out_changes_no_picture(name):
    # 'dark_paths' only matters for derivatives; all others are computed though not needed
    scene = SCENES[name]
    size = dict(width=24, height=24, bounces=3, samples=1)
    lean, full = (st.render(scene, needs=n, **size) for n in (st.needs(scene), st.Needs()))
    np.testing.assert_allclose(lean, full, atol=1e-13)


def test_every_feature_is_explained_and_the_explanation_agrees_with_the_needs():
    scene = SCENES["planes"]
    explained = {name: needed for name, needed, _ in left_out(scene)}
    assert set(explained) == set(FEATURES) - {"dark_paths"} | {"antialias"}
    assert not explained.pop("antialias")
    found = st.needs(scene)
    assert all(getattr(found, name) == needed for name, needed in explained.items())
    assert all(why for *_, why in left_out(scene))


def test_a_camera_on_the_wall_of_a_sphere_counts_as_inside():
    scene = eqx.tree_at(lambda s: s.spheres.radius, SCENES["inside"], jnp.array([200.0, 10]))
    assert st.needs(scene).inside
