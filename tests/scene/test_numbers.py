"""Checks of the numbers of scenes that were made or changed in Python."""

import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import SCENES
from helpers.unchecked import messages

import spheretrace_jax as st

SCENE = SCENES["diffuse"].astype("float32")
SIZE = {"width": 8, "height": 8, "bounces": 0}
PLACES = {
    "spheres.radius[1]": lambda s: s.spheres.radius,
    "spheres.center[1, 0]": lambda s: s.spheres.center,
    "spheres.kt[1]": lambda s: s.spheres.kt,
    "lights.color[0, 0]": lambda s: s.lights.color,
    "camera.theta": lambda s: s.camera.theta,
    "background[1]": lambda s: s.background,
}


def changed(where, number):
    """Returns the scene with one other number in an array, its second row's or the only one."""
    array = np.array(where(SCENE))
    at = min(1, len(array) - 1) if array.ndim else ()
    if array.ndim == 2:
        at = (at, 0)
    array[at] = number
    return eqx.tree_at(where, SCENE, jnp.asarray(array))


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", PLACES)
def test_numbers_must_be_finite(place, number):
    message = f"{place.split('[')[0]}"
    with pytest.raises(st.InputError, match=rf"{message}.* must be finite, got {number}"):
        st.render(changed(PLACES[place], number), **SIZE)


@pytest.mark.parametrize("number", [0, -40])
def test_radii_must_be_above_0(number):
    scene = changed(PLACES["spheres.radius[1]"], number)
    message = rf"spheres\.radius\[1\] must be greater than 0, got {number}"
    for use in (
        lambda: st.render(scene, **SIZE),
        lambda: st.render_layers(scene, width=8, height=8),
        lambda: st.fit(scene, np.ones((8, 8, 3), np.float32)),
        lambda: st.needs(scene),
        lambda: st.save_scene("never.txt", scene),
        lambda: st.check_gradients(scene, **SIZE),
        lambda: str(scene),
    ):
        with pytest.raises(st.InputError, match=message):
            use()


def test_the_view_plane_must_be_in_front_of_the_eye():
    scene = changed(lambda s: s.camera.distance, 0.0)
    with pytest.raises(st.InputError, match=r"camera\.distance must be greater than 0, got 0"):
        st.render(scene, **SIZE)


def test_what_is_known_is_checked_where_other_numbers_are_traced():
    def loss(color, scene):
        return st.needs(st.replace(scene, {"color": color})) and color.sum()

    bad = changed(PLACES["spheres.kt[1]"], np.nan)
    jax.jit(loss, static_argnums=())(SCENE.spheres.color, SCENE)
    with pytest.raises(st.InputError, match=r"spheres\.kt\[1\] must be finite"):
        jax.grad(lambda color: loss(color, bad))(SCENE.spheres.color)


def test_bright_colours_are_said_once():
    scene = st.replace(SCENE, {"color": 1.5})
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("default")
        for _ in range(3):
            st.needs(scene)
    assert [str(w.message) for w in said] == ["spheres.color is out of 0..1: 1.5"]
    assert issubclass(said[0].category, st.SceneWarning)


def of_counts() -> dict[str, str]:
    """Returns calls with counts that are no whole numbers, and their messages."""
    small = {"width": "8", "height": "8", "bounces": "0"}
    calls = {}
    for name in ("width", "height", "bounces", "samples"):
        for value in ("'16'", "16.0", "True", "[16]"):
            words = ", ".join(f"{k}={v}" for k, v in {**small, name: value}.items())
            calls[f"st.render(scene, {words})"] = f"{name} must be a whole number, got {value}"
    for name in ("max_steps", "shrink"):
        words = f"{name} must be a whole number, got '2'"
        calls[f"st.fit(scene, picture, {name}='2')"] = words
    return calls


def test_counts_are_whole_numbers():
    expected = {call: f"InputError: {message}" for call, message in of_counts().items()}
    numpys = "st.render(scene, width=np.int64(8), height=jnp.array(8), bounces=0).shape"
    assert messages([*expected, numpys]) == expected | {numpys: "(8, 8, 3)"}
