import dataclasses
import os
import re
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import CAMERA, SCENES, nine_spheres

import spheretrace_jax as st
from spheretrace_jax.rendering.render import draw
from spheretrace_jax.scene.needs import left_out
from spheretrace_jax.scene.settings import render_settings

FEATURES = [f.name for f in dataclasses.fields(st.Needs)]


def needed(scene, **settings) -> set[str]:
    found = st.needs(scene, **settings)
    return {name for name in FEATURES if getattr(found, name)}


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("diffuse", {"shadows"}),
        ("shadows", {"shadows", "highlights"}),
        ("two_coloured_lights", {"shadows", "highlights", "tinted"}),
        ("mirrors", {"shadows", "highlights", "reflection"}),
        ("bubbles", {"shadows", "highlights", "reflection", "transmission", "inside"}),
        ("glass", {"shadows", "highlights", "reflection", "transmission", "inside", "branching",
                   "background"}),
        ("planes", {"shadows", "highlights", "reflection", "planes", "checkers"}),
        ("textures", {"shadows", "highlights", "reflection", "textures", "background", "tinted"}),
        ("coated", {"shadows", "highlights", "coated", "planes"}),
        ("inside", {"shadows", "highlights", "reflection", "inside"}),
    ],
)  # fmt: skip
def test_needs_are_those_of_the_scene(name, expected):
    grey = {"inside"}  # its spheres and its light are white
    assert needed(SCENES[name]) == expected | (set() if name in grey else {"colors"})


def test_one_sphere_needs_no_shadow_and_no_lights_need_nothing():
    one = st.Spheres([[0.0, 0, 0]], [40.0], ks=0.5)
    assert needed(st.Scene(one, st.Lights([[9.0, 9, 9]]))) == {"highlights"}
    assert needed(st.Scene(one, st.Lights(np.zeros((0, 3))))) == set()


def test_a_lonely_mirror_mirrors_only_the_sky():
    mirror = st.Spheres([[0.0, 0, 0]], [40.0], kgr=0.5)
    alone = st.Scene(mirror, st.Lights(np.zeros((0, 3))))
    under_a_sky = eqx.tree_at(lambda s: s.background, alone, jnp.array([0.1, 0.2, 0.3]))
    assert st.needs(alone).depth == 0 and st.needs(under_a_sky).depth == 1
    size = dict(width=24, height=24, samples=1)
    for scene in (alone, under_a_sky):
        few, many = (st.render(scene, needs=n, **size) for n in (None, st.Needs()))
        np.testing.assert_array_equal(few, many)
    assert st.needs(SCENES["mirrors"]).depth is None


def test_lights_that_nothing_can_block_need_no_shadow_pass():
    scene = nine_spheres((100.0, 500, 800))  # the file's own light: no pixel is in its shadow
    assert not st.needs(scene).shadows and st.needs(scene, free=["light_position"]).shadows
    both = st.Lights([[100.0, 500, 800], [100, 900, 300]])
    both = eqx.tree_at(lambda s: s.lights, scene, both)
    assert st.needs(both).shadows and st.needs(both).clear == (0,)


def test_what_will_be_free_is_needed():
    scene = SCENES["diffuse"]
    assert "highlights" in needed(scene, free=["ks"])
    assert {"reflection", "dark_paths"} <= needed(scene, free=["kgr"])
    assert {"transmission", "inside"} <= needed(scene, free=["kt"])
    assert "coated" in needed(scene, free=["ior"])


@pytest.mark.parametrize("free", ["colour", ["kgr", "light"]])
def test_unknown_names_are_refused(free):
    with pytest.raises(st.InputError, match="free must name parameters of the scene"):
        st.needs(SCENES["diffuse"], free=free)
    assert st.needs(SCENES["diffuse"], free="kgr").reflection


@pytest.mark.parametrize("owner", ["spheres", "planes"])
def test_an_index_of_refraction_below_1_is_refused(owner):
    at = lambda s: getattr(s, owner).ior
    scene = eqx.tree_at(at, SCENES["coated"], replace_fn=lambda n: n.at[0].set(0.9))
    for call in (st.needs, lambda s: st.render(s, width=4, height=4)):
        with pytest.raises(st.InputError, match=rf"{owner}\.ior must be at least 1, got 0\.9"):
            call(scene)


def test_needs_are_static_hashable_and_equal_for_scenes_alike():
    first, second = (
        st.needs(nine_spheres(light)) for light in ((100.0, 900, 300), (90.0, 910, 310))
    )
    assert first == second and hash(first) == hash(second)


def needs_inside(transform, function, *arguments) -> st.Needs:
    """Returns the needs of the scene that `function` makes, found while it is traced."""
    found = []

    def traced(*arguments):
        found.append(st.needs(function(*arguments)))
        return 0.0 * sum(jnp.sum(x) for x in jax.tree.leaves(arguments))

    transform(traced)(*arguments)
    return found[0]


@pytest.mark.parametrize("transform", [jax.jit, jax.grad, jax.hessian, jax.vmap])
def test_traced_parameters_count_as_free(transform):
    scene, batch = SCENES["diffuse"], transform is jax.vmap
    for name in ("color", "kgr", "ior"):
        at = lambda s, name=name: getattr(s.spheres, name)
        value = at(scene)[None] if batch else at(scene)
        found = needs_inside(transform, lambda v, at=at: eqx.tree_at(at, scene, v), value)
        assert found == st.needs(scene, free=(name,))
    whole = jax.tree.map(lambda leaf: leaf[None], scene) if batch else scene
    everything = needs_inside(transform, lambda s: s, whole)
    assert everything == dataclasses.replace(
        st.Needs(), textures=False, planes=False, checkers=False, crossings=False
    )


def test_a_scene_made_under_a_trace_is_known():
    made = lambda x: st.Scene(st.Spheres([[0.0, 0, 0]], [100.0]), st.Lights([[0.0, 0, 900]]))
    assert needs_inside(jax.jit, made, 1.0) == st.needs(made(1.0))
    moved = lambda x: eqx.tree_at(lambda s: s.spheres.ks, made(x).with_antialias(1), x[None])
    assert needs_inside(jax.jit, moved, jnp.array(1.0)) == st.needs(made(1.0), free=("ks",))


def test_render_under_jit_and_grad_needs_no_word():
    scene = SCENES["shadows"]
    picture = st.render(scene, width=16, height=12, bounces=1)
    drawn = jax.jit(st.render, static_argnames=("width", "height", "bounces"))
    np.testing.assert_allclose(drawn(scene, width=16, height=12, bounces=1), picture, atol=1e-14)
    at = lambda s: s.spheres.kd
    loss = lambda kd: jnp.sum(st.render(eqx.tree_at(at, scene, kd), width=16, height=12) ** 2)
    known = lambda kd: jnp.sum(
        st.render(eqx.tree_at(at, scene, kd), width=16, height=12, needs=st.needs(scene)) ** 2
    )
    slopes = (jax.jit(jax.grad(f))(at(scene)) for f in (loss, known))
    np.testing.assert_allclose(*slopes, rtol=1e-12)


def test_needs_of_several_scenes():
    names = "diffuse", "mirrors", "planes", "textures"
    each = [st.needs(SCENES[name]) for name in names]
    both = st.needs([SCENES[name] for name in names])
    for field in dataclasses.fields(st.Needs):
        if field.name not in ("clear", "depth"):
            assert getattr(both, field.name) == any(getattr(n, field.name) for n in each)
    one_sphere = st.Scene(st.Spheres([[0.0, 0, 0]], [9.0], kgr=0.3), st.Lights([[0.0, 0, 99]]))
    assert st.needs([one_sphere, one_sphere]) == st.needs(one_sphere)
    assert st.needs([one_sphere, SCENES["mirrors"]]).depth is None
    with pytest.raises(ValueError, match="at least one scene"):
        st.needs([])


def test_clear_lights_of_several_scenes():
    light = lambda *positions: st.Lights(np.asarray(positions, float))
    spheres = st.Spheres([[0.0, 0, 0], [300, 0, 0]], [50.0, 50])
    above, along = [0.0, 0, 900], [900.0, 0, 0]
    first, second = (
        st.Scene(spheres, light(*positions)) for positions in ((above, along), (along, above))
    )
    assert (st.needs(first).clear, st.needs(second).clear) == ((0,), (1,))
    both = st.needs([first, second])
    assert both.shadows and both.clear == ()
    neither = st.Scene(spheres, light(above, above))
    assert not st.needs(neither).shadows and st.needs([neither, first]).clear == (0,)


def lean_and_full(name: str, **changes) -> tuple[np.ndarray, np.ndarray]:
    # 'dark_paths' only matters for derivatives; all others are computed though not needed
    scene, full = SCENES[name], dataclasses.replace(st.Needs(), **changes)
    size = dict(width=24, height=24, bounces=3, samples=1)
    return tuple(np.asarray(st.render(scene, needs=n, **size)) for n in (None, full))


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.slow if k % 2 else ()) for k, n in enumerate(SCENES)],
)
def test_leaving_out_changes_no_picture(name):
    lean, full = lean_and_full(name)
    np.testing.assert_allclose(lean, full, rtol=4e-15, atol=1e-15)


@pytest.mark.slow
def test_leaving_out_changes_no_bit():
    # where the processor cannot multiply and add in one rounded step, which compilers do to other
    # pairs in other programs. Where paths branch, they are added up in another order.
    check = """
import jax
jax.config.update("jax_enable_x64", True)
from scene.test_needs import SCENES, lean_and_full
for name in SCENES:
    lean, full = lean_and_full(name, branching=name == "glass")
    assert (lean == full).all(), name
"""
    flags = os.environ | {"XLA_FLAGS": "--xla_cpu_max_isa=AVX"}
    subprocess.run(
        [sys.executable, "-c", check], check=True, env=flags, cwd=Path(__file__).parents[1]
    )


def operations(scene: st.Scene, **changes) -> int:
    """Counts the operations in the program of a picture, before it is compiled."""
    found = dataclasses.replace(st.needs(scene), **changes)
    program = render_settings(scene, 8, 8, bounces=2, needs=found)
    lowered = jax.jit(lambda scene: draw.__wrapped__(scene, program)).lower(scene)
    return len(re.findall(r"= \"?(?:stablehlo|chlo|func)\.", lowered.as_text()))


@pytest.mark.parametrize("name", [n for n in FEATURES if n not in ("branching", "dark_paths")])
def test_a_feature_that_is_not_needed_has_no_operations(name):
    # a grey scene that needs nothing at all but two mirrors, which some features are about
    spheres = st.Spheres([[-60.0, -30, 0], [50, 40, -40]], [60.0, 70], kgr=0.5)
    scene = st.Scene(spheres, st.Lights([[0.0, 0, 900]]), CAMERA)
    if name == "crossings":
        scene = scene.with_antialias(1)
    if name == "reflection":
        scene = eqx.tree_at(lambda s: s.spheres.kgr, scene, jnp.zeros(2))
    assert not getattr(st.needs(scene), name) or name in ("clear", "depth")
    if name == "clear":
        assert operations(scene, shadows=True, clear=(0,)) < operations(scene, shadows=True)
    elif name == "depth":
        assert operations(scene, depth=0) < operations(scene)
    else:
        base = {"colors": True} if name == "tinted" else {}
        assert operations(scene, **base) < operations(scene, **base, **{name: True})


def test_every_feature_is_explained_and_the_explanation_agrees_with_the_needs():
    scene = SCENES["planes"]
    explained = {name: needed for name, needed, _ in left_out(scene)}
    assert set(explained) == set(FEATURES) - {"dark_paths", "clear", "depth"} | {"antialias"}
    assert not explained.pop("antialias")
    found = st.needs(scene)
    assert all(getattr(found, name) == needed for name, needed in explained.items())
    assert all(why for *_, why in left_out(scene))


def test_a_camera_on_the_wall_of_a_sphere_counts_as_inside():
    scene = eqx.tree_at(lambda s: s.spheres.radius, SCENES["inside"], jnp.array([200.0, 10]))
    assert st.needs(scene).inside
