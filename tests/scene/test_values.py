"""Values of a scene by the names of its parameters, and a scene with other ones."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import SCENES
from helpers.unchecked import messages

import spheretrace_jax as st
from spheretrace_jax.scene.parameters import FITTED

SCENE = SCENES["planes"].astype("float64")
MIXED = st.Scene(
    SCENE.spheres,
    st.Lights([[1.0, 2, 3], [0, 0, 1]], [[1.0, 1, 1]] * 2, directional=[False, True]),
)


@pytest.mark.parametrize("scene", [SCENE, MIXED, SCENE.astype("float32")])
def test_replacing_by_the_own_values_changes_no_number(scene):
    found = st.values(scene, FITTED)
    assert list(found) == list(FITTED)
    again = st.replace(scene, found)
    expected = st.replace(scene, {name: found[name] for name in ("roll", "look_at")})
    kept = ("spheres", "lights", "planes")
    assert all(eqx.tree_equal(getattr(again, k), getattr(scene, k)) for k in kept)
    assert again.dtype == scene.dtype and expected.camera.roll == again.camera.roll == 0


@pytest.mark.parametrize("names", ["color", ("color",), ["color"]])
def test_one_name_is_a_word_or_a_list(names):
    assert eqx.tree_equal(st.values(SCENE, names), {"color": SCENE.spheres.color})


def test_numbers_and_rows_hold_for_all_objects():
    n = len(SCENE.spheres)
    changed = st.replace(
        SCENE, {"kd": 0.25, "color": np.array([0.1, 0.2, 0.3]), "ka": np.full(n, 1)}
    )
    assert (changed.spheres.kd == 0.25).all() and changed.spheres.kd.dtype == SCENE.dtype
    assert changed.spheres.color.shape == (n, 3) and (changed.spheres.color[:, 2] == 0.3).all()
    assert changed.spheres.ka.dtype == SCENE.dtype
    assert eqx.tree_equal(changed.lights, SCENE.lights)


def test_places_of_lights_are_those_of_their_kind():
    moved = st.replace(MIXED, {"light_position": jnp.full((2, 3), 7.0)})
    np.testing.assert_array_equal(moved.lights.position, [[7, 7, 7], [0, 0, 1]])
    turned = st.replace(MIXED, {"light_direction": jnp.full((2, 3), 7.0)})
    np.testing.assert_array_equal(turned.lights.position, [[1, 2, 3], [7, 7, 7]])


def test_derivatives_are_those_of_the_arrays():
    """The sum of squares of a scene's arrays, whose gradient is known, under jit, grad and vmap."""

    @jax.jit
    @jax.grad
    def slope(values):
        scene = st.replace(SCENE, values)
        return (scene.spheres.color**2).sum() + (scene.lights.position**2).sum()

    found = slope(values := st.values(SCENE, ("color", "light_position")))
    for name, array in values.items():
        np.testing.assert_allclose(found[name], 2 * array)
    radii = jnp.arange(1.0, 4)
    many = jax.vmap(lambda r: st.replace(SCENE, {"radius": r}).spheres.radius)(radii)
    np.testing.assert_array_equal(many, np.repeat(radii[:, None], len(SCENE.spheres), 1))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"colour": 1.0}, "unknown parameter colour: expected color, ka, "),
        ({"exposure": 1.0}, "unknown parameter exposure: expected color, "),
        ({"ka": np.zeros((1, 9))}, r"ka must be an array of shape \(\d+,\), got shape \(1, 9\)"),
        ({"kd": True}, "kd must be real numbers, got bool"),
        ({"radius": 0}, r"spheres.radius\[0\] must be greater than 0, got 0"),
        ({"ks": jnp.nan}, r"spheres.ks\[0\] must be finite, got nan"),
    ],
)
def test_other_values_are_refused(values, message):
    with pytest.raises(st.InputError, match=message):
        st.replace(SCENE, values)


def test_other_names_are_refused():
    with pytest.raises(st.InputError, match="unknown parameter colour, k: expected color, "):
        st.values(SCENE, ("colour", "ka", "k"))


def test_lists_are_arrays_and_words_are_refused():
    expected = {
        "{'color': [1.0, 2]}": "InputError: color must be an array of shape (9, 3), got [1.0, 2]",
        "{'kd': 'x'}": "InputError: kd must be real numbers, got <U1",
        "{'kd': [[1.0], [2, 3]]}": (
            "InputError: kd must be an array of shape (9,), got [[1.0], [2, 3]]"
        ),
        "{'kd': [0.5] * 9}": "(9,)",
    }
    calls = {f"st.replace(scene, {v}).spheres.kd.shape": m for v, m in expected.items()}
    assert messages(list(calls)) == calls
