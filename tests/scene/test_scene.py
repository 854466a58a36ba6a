import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spheretrace_jax as st
from spheretrace_jax.scene.scene import check_scene

_BITMAP = st.Texture(np.full((2, 5, 3), 0.5))
SCENE = st.Scene(
    st.Spheres([[0.0, 0, 0], [90, 0, 0], [0, 90, 0]], 50.0, pic=[0, 1, 2]),
    st.Lights([[0.0, 0, 900], [0, 500, 0], [300, 0, 0], [0, 0, -900]]),
    planes=st.Planes([[0.0, 0, -80], [0, 0, -90]], [[0.0, 0, 1], [0, 0.1, 1]]),
    textures=[_BITMAP, _BITMAP],
    sky=_BITMAP,
    back_plane=st.BackPlane((0.3, 0.5, 0.6)),
)


def test_one_number_or_colour_holds_for_all_spheres():
    s = st.Spheres([[0.0, 0, 0], [9, 0, 0]], 3.0, (0.1, 0.2, 0.3), ka=[0.1, 0.2], pic=0)
    assert s.radius.shape == s.kd.shape == (2,) and s.pic == (0, 0)
    np.testing.assert_array_equal(s.color, [[0.1, 0.2, 0.3]] * 2)


def test_the_leaves_of_objects_are_in_the_order_of_the_scene_file():
    material = ("color", "ka", "kd", "ks", "exponent", "kgr")
    for objects, names in (
        (st.Spheres([[0.0, 0, 0]], [1.0]), ("center", "radius", *material, "kt", "ior")),
        (st.Planes(), ("point", "normal", *material, "ior", "checker_color", "checker_size")),
    ):
        paths = [path for path, _ in jax.tree_util.tree_flatten_with_path(objects)[0]]
        assert [jax.tree_util.keystr(path).lstrip(".") for path in paths] == list(names)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_everything_has_the_dtype_of_the_spheres(dtype):
    spheres = st.Spheres(np.zeros((1, 3), dtype), np.ones(1, dtype))
    scene = st.Scene(spheres, st.Lights([[1.0, 2, 3]]), back_plane=st.BackPlane((1.0, 1, 1)))
    assert {leaf.dtype for leaf in jax.tree.leaves(scene)} == {scene.dtype} == {np.dtype(dtype)}
    assert st.render(scene, width=4, height=4).dtype == dtype


def test_astype_changes_every_array():
    scene = st.Scene(st.Spheres([[0.0, 0, 0]], [1.0]), st.Lights([[1.0, 2, 3]]))
    assert {leaf.dtype for leaf in jax.tree.leaves(scene.astype(jnp.float32))} == {
        np.dtype(np.float32)
    }


def test_empty_worlds_are_scenes():
    scene = st.Scene(st.Spheres(np.zeros((0, 3)), []), st.Lights(np.zeros((0, 3))))
    assert len(scene.spheres) == len(scene.lights) == 0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: st.Spheres([[0.0, 0, 0]], [1.0, 2.0]),
            r"spheres.radius must be an array of shape \(1,\), got \(2,\)",
        ),
        (lambda: st.Spheres([[0.0, 0, 0]], [1.0], ka=[0.1, 0.2]), "spheres.ka must be an array of"),
        (
            lambda: st.Spheres([[0.0, 0]], [1.0]),
            r"spheres.center must be .* \(1, 3\), got \(1, 2\)",
        ),
        (lambda: st.Spheres([[0.0, 0, 0]], [1.0], pic=[0, 1]), "pic must name a texture"),
        (lambda: st.Spheres([[0.0, 0, 0]], [1.0], pic=[0.5]), "whole numbers, got 0.5"),
        (lambda: st.Spheres([[0.0, 0, 0]], [1.0], pic=[None]), "whole numbers, got None"),
        (lambda: st.Lights([[0.0, 0, 0]], [[1.0, 1]]), r"lights.color must be .* \(1, 3\)"),
        (lambda: st.Planes([[0.0, 0, 0]], [[0.0, 0, 1]] * 2), "planes.normal must be an array of"),
        (lambda: st.Planes([[0.0, 0, 0]], [[0.0, 0, 1]], ka=[0.1, 0.2]), "planes.ka must be an"),
        (lambda: dataclasses.replace(SCENE, antialias=2), "antialias must be 0 or 1, got 2"),
        (
            lambda: st.Scene(st.Spheres([[0.0, 0, 0]], [1.0], pic=2), st.Lights([[0.0, 0, 0]])),
            "sphere 1 has texture 2, but there are 0 textures",
        ),
    ],
)
def test_parts_that_do_not_fit_are_refused(make, message):
    with pytest.raises(st.InputError, match=message):
        make()


def _texture(k: int):
    return lambda s: s.textures[k].image


def _shape(field: str, shape: str, got: str) -> str:
    return f"{field} must be an array of shape {shape}, got {got}"


#: Changes that no constructor sees: where, to what, and what is then said.
CHANGES = [
    (lambda s: s.spheres.kd, jnp.ones(2), _shape("spheres.kd", "(3,)", "(2,)")),
    (lambda s: s.spheres.kd, jnp.ones(()), _shape("spheres.kd", "(3,)", "()")),
    (lambda s: s.spheres.kd, 0.5, _shape("spheres.kd", "(3,)", "a float")),
    (lambda s: s.spheres.center, jnp.ones((5, 3)), _shape("spheres.center", "(3, 3)", "(5, 3)")),
    (lambda s: s.spheres.color, jnp.ones((3, 4)), _shape("spheres.color", "(3, 3)", "(3, 4)")),
    (lambda s: s.spheres.ks, jnp.ones((3, 1)), _shape("spheres.ks", "(3,)", "(3, 1)")),
    (lambda s: s.lights.color, jnp.ones((2, 3)), _shape("lights.color", "(4, 3)", "(2, 3)")),
    (lambda s: s.camera.theta, jnp.ones(7), _shape("camera.theta", "()", "(7,)")),
    (lambda s: s.camera.mu, "500", _shape("camera.mu", "()", "a str")),
    (lambda s: s.camera.mu, None, _shape("camera.mu", "()", "None")),
    (lambda s: s.camera.mu, True, _shape("camera.mu", "()", "a bool")),
    (lambda s: s.background, jnp.ones(4), _shape("background", "(3,)", "(4,)")),
    (lambda s: s.background, 0.5, _shape("background", "(3,)", "a float")),
    (lambda s: s.planes.checker_size, np.ones(1), _shape("planes.checker_size", "(2,)", "(1,)")),
    (lambda s: s.planes.normal, np.ones((2, 2)), _shape("planes.normal", "(2, 3)", "(2, 2)")),
    (lambda s: s.back_plane.ka, np.ones(1), _shape("back_plane.ka", "()", "(1,)")),
    (_texture(1), np.ones((2, 5)), _shape("textures[1].image", "(rows, columns, 3)", "(2, 5)")),
    (lambda s: s.sky.image, np.ones((2, 5, 4)), _shape("sky.image", "(2, 5, 3)", "(2, 5, 4)")),
    (_texture(0), np.ones((0, 5, 3)), "textures[0].image must hold a pixel or more"),
    (
        lambda s: s.textures[0],
        np.ones((2, 2, 3)),
        "textures[0] must be of class Texture, got an array",
    ),
    (lambda s: s.textures, (), "sphere 2 has texture 1, but there are 0 textures"),
    (lambda s: s.lights, None, "lights must be of class Lights, got None"),
    (lambda s: s.spheres.kd, np.ones(3, int), "spheres.kd must be float64, as the rest is, got"),
    (lambda s: s.spheres.kd, jnp.ones(3, bool), "spheres.kd must be float64"),
    (lambda s: s.spheres.radius, jnp.ones(3, jnp.float32), "spheres.radius must be float64"),
    (lambda s: s.camera.mu, np.float32(5), "camera.mu must be float64"),
]

PICTURE = np.full((4, 4, 3), 0.5)

#: All that takes a scene from a user.
USES = {
    "render": lambda s: st.render(s, width=4, height=4),
    "under jit": lambda s: eqx.filter_jit(st.render)(s, width=4, height=4),
    "render_layers": lambda s: st.render_layers(s, width=4, height=4),
    "fit": lambda s: st.fit(s, PICTURE),
    "fit of several": lambda s: st.fit([SCENE, s], [PICTURE, PICTURE]),
    "needs": st.needs,
    "needs of several": lambda s: st.needs([SCENE, s]),
    "save_scene": lambda s: st.save_scene("never.txt", s),
    "write_povray": lambda s: st.write_povray("never.pov", s),
    "check_gradients": st.check_gradients,
    "check_stability": st.check_stability,
    "check_condition": st.check_condition,
    "study": st.study,
    "print": str,
}


@pytest.mark.parametrize(("where", "value", "message"), CHANGES)
def test_changes_of_a_scene_are_checked_wherever_it_is_used(where, value, message):
    broken = eqx.tree_at(where, SCENE, value, is_leaf=lambda x: x is None)
    for name, use in USES.items():
        with pytest.raises(st.InputError) as caught:
            use(broken)
        assert message in str(caught.value) and "\n" not in str(caught.value), name


def test_one_dtype_of_another_kind_than_the_rest():
    half = jax.tree.map(lambda leaf: leaf.astype(jnp.float16), SCENE)
    for use in USES.values():
        with pytest.raises(st.InputError, match="must be float32 or float64, got float16"):
            use(half)
    single = eqx.tree_at(lambda s: s.spheres.kd, SCENE.astype(jnp.float32), jnp.ones(3))
    with pytest.raises(st.InputError, match=r"spheres.kd must be float32, .* got float64"):
        st.render(single, width=4, height=4)


@pytest.mark.parametrize("other", ["scene.txt", None, SCENE.spheres])
def test_what_is_no_scene_is_refused(other):
    with pytest.raises(st.InputError, match="expected a Scene, as load_scene returns, got "):
        check_scene(other)


def test_numbers_and_numpy_arrays_in_a_scene_are_arrays():
    plain = st.Scene(st.Spheres([[0.0, 0, 0]], 50.0, ks=0.1), st.Lights([[0.0, 0, 900]]))
    where = lambda s: (s.camera.mu, s.spheres.kd, s.camera.phi, s.camera.window)
    kd = np.asarray(plain.spheres.kd)
    changed = eqx.tree_at(where, plain, (700.0, kd, np.float64(0), 512))
    wanted = eqx.tree_at(lambda s: s.camera.mu, plain, jnp.asarray(700.0))
    size = dict(width=8, height=8, bounces=0)
    np.testing.assert_array_equal(st.render(changed, **size), st.render(wanted, **size))
    assert st.needs(changed) == st.needs(wanted)


def test_the_check_keeps_whole_scenes_and_traced_ones():
    assert check_scene(SCENE) is SCENE
    assert jax.eval_shape(check_scene, SCENE).camera.mu.shape == ()
    batch = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), SCENE)
    assert jax.vmap(lambda s: check_scene(s).camera.mu)(batch).shape == (2,)


@pytest.mark.parametrize("name", ["save_scene", "write_povray"])
def test_a_traced_scene_has_no_numbers_to_write(name):
    with pytest.raises(st.InputError, match="write it outside of jit"):
        jax.jit(USES[name])(SCENE)
