import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spheretrace_jax as st


def test_one_number_or_colour_holds_for_all_spheres():
    s = st.Spheres([[0.0, 0, 0], [9, 0, 0]], 3.0, (0.1, 0.2, 0.3), ka=[0.1, 0.2], pic=0)
    assert s.radius.shape == s.kd.shape == (2,) and s.pic == (0, 0)
    np.testing.assert_array_equal(s.color, [[0.1, 0.2, 0.3]] * 2)


def test_the_leaves_of_objects_are_in_the_order_of_the_scene_file():
    material = ("color", "ka", "kd", "ks", "exponent", "kgr")
    for objects, names in (
        (st.Spheres([[0.0, 0, 0]], [1.0]), ("center", "radius", *material, "kt")),
        (st.Planes(), ("point", "normal", *material, "checker_color", "checker_size")),
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
        (lambda: st.Spheres([[0.0, 0, 0]], [1.0, 2.0]), "radius must have shape"),
        (lambda: st.Spheres([[0.0, 0, 0]], [1.0], ka=[0.1, 0.2]), "ka must have shape"),
        (lambda: st.Spheres([[0.0, 0]], [1.0]), "shape"),
        (lambda: st.Spheres([[0.0, 0, 0]], [1.0], pic=[0, 1]), "pic must name a texture"),
        (lambda: st.Lights([[0.0, 0, 0]], [[1.0, 1]]), "shape"),
        (lambda: st.Planes([[0.0, 0, 0]], [[0.0, 0, 1]] * 2), "normal of the planes"),
        (lambda: st.Planes([[0.0, 0, 0]], [[0.0, 0, 1]], ka=[0.1, 0.2]), "ka of the planes"),
        (
            lambda: st.Scene(st.Spheres([[0.0, 0, 0]], [1.0], pic=2), st.Lights([[0.0, 0, 0]])),
            "sphere 1 has texture 2, but there are 0 textures",
        ),
    ],
)
def test_parts_that_do_not_fit_are_refused(make, message):
    with pytest.raises(Exception, match=message):
        make()
