"""The session of a window: messages, frames, handles of lights, and what is compiled."""

import jax
import numpy as np
import pytest
from helpers.scenes import SCENES

import spheretrace_jax as st
from spheretrace_jax.display.view.frames import heat_map
from spheretrace_jax.display.view.session import SLIDERS, Session

SIZE = (24, 16)
SCENE = SCENES["diffuse"].astype("float32")


@pytest.fixture
def session():
    return Session(SCENE, SIZE, np.full((16, 24, 3), 0.25, np.float32))


def test_a_frame_is_the_picture_of_a_display(session):
    frame = session.frame()()
    expected = np.round(st.to_srgb(st.render(SCENE, width=24, height=16)) * 255)
    assert frame.scale == 0 and (frame.pixels[..., 3] == 255).all()
    np.testing.assert_allclose(frame.pixels[..., :3], expected, atol=1)


def test_a_frame_is_of_the_state_when_it_was_asked_for(session):
    draw = session.frame()
    before = draw().pixels
    session.take({"type": "set", "name": "kd", "value": 0.0, "row": 0})
    np.testing.assert_array_equal(draw().pixels, before)
    assert (session.frame()().pixels != before).any()


def test_numbers_are_set(session):
    messages = [
        {"type": "set", "name": "color", "value": 0.125, "row": 1, "column": 2},
        {"type": "set", "name": "theta", "value": 0.5},
        {"type": "camera", "mu": 700.0, "phi": 1.0},
        {"type": "options", "antialias": 1, "bounces": 2},
        {"type": "sphere", "row": 2},
    ]
    for message in messages:
        session.take(message)
    scene = session.scene
    assert scene.spheres.color[1, 2] == 0.125 and scene.spheres.color[0, 2] != 0.125
    assert (scene.camera.theta, scene.camera.mu, scene.camera.phi) == (0.5, 700, 1)
    assert (scene.antialias, session.bounces, session.sphere) == (1, 2, 2)


@pytest.mark.parametrize(
    ("message", "words"),
    [
        ({"type": "dance"}, "unknown message 'dance'"),
        ({}, "unknown message None"),
        ({"type": "set", "name": "radius", "value": 0}, "radius must be greater than 0, got 0"),
        ({"type": "set", "name": "kd", "value": 1.5}, "kd must be in 0..1, got 1.5"),
        ({"type": "set", "name": "ior", "value": 0.5}, "ior must be at least 1, got 0.5"),
        ({"type": "set", "name": "theta", "value": "nan"}, "theta must be finite, got nan"),
        ({"type": "set", "name": "hue", "value": 1}, "unknown parameter hue"),
        ({"type": "set", "name": "kd", "value": 1, "row": 9}, "set: index 9 is out of bounds"),
        ({"type": "set", "name": "kd", "value": "x"}, "set: could not convert"),
        ({"type": "set", "nom": "kd"}, "set: .*name"),
        ({"type": "camera", "hue": 1}, "unknown parameter hue"),
        ({"type": "camera", "distance": -1.0}, "camera.distance must be greater than 0"),
        ({"type": "show", "kind": "film"}, "cannot show film"),
        ({"type": "show", "kind": "derivative", "parameter": "hue"}, "unknown parameter hue"),
        ({"type": "show", "kind": "derivative", "parameter": "kd", "row": 7}, "no number 7, 0"),
        ({"type": "options", "bounces": 99}, r"bounces must be in 0\.\.16, got 99"),
        ({"type": "options", "antialias": 2}, "antialias must be 0 or 1"),
        ({"type": "show", "kind": "derivative", "parameter": "kd", "row": 1.5}, "whole number"),
        ({"type": "set", "name": "kd", "value": 0.5, "row": -1}, "whole number from 0, got -1"),
        ({"type": "sphere", "row": 3}, "there is no sphere 4"),
        ({"type": "light", "row": 5, "x": 1, "y": 1}, "light: list index out of range"),
    ],
)
def test_what_cannot_be_is_refused_and_changes_nothing(session, message, words):
    before = session.state()
    with pytest.raises(st.InputError, match=words):
        session.take(message)
    assert session.state() == before and session.scene is SCENE


def test_undo_goes_back_to_the_start_of_a_drag(session):
    session.take({"type": "begin"})
    for theta in (0.1, 0.2, 0.3):
        session.take({"type": "camera", "theta": theta})
    session.take({"type": "begin"})
    session.take({"type": "set", "name": "kd", "value": 0.0})
    session.take({"type": "undo"})
    assert session.scene.camera.theta == np.float32(0.3) and session.scene.spheres.kd[0] != 0
    session.take({"type": "undo"})
    assert session.scene is SCENE
    session.take({"type": "undo"})
    assert session.scene is SCENE


def test_a_click_chooses_the_sphere_that_is_seen(session):
    objects = np.asarray(st.render_layers(SCENE, width=24, height=16).object)
    for sphere in (0, 2):
        row, column = np.argwhere(objects == sphere)[0]
        session.take({"type": "pick", "x": column + 0.5, "y": row + 0.5})
        assert session.sphere == sphere
    row, column = np.argwhere(objects < 0)[0]
    session.take({"type": "pick", "x": int(column), "y": int(row)})
    session.take({"type": "pick", "x": -5, "y": 3})
    assert session.sphere == 2


def test_a_light_goes_where_its_handle_is_dragged():
    places = [[30.0, 40, -50], 2 * np.array([0, 0, 700.0]), [0, 0, 1]]
    lights = st.Lights(places, [[1.0] * 3] * 3, directional=[False, False, True])
    scene = st.Scene(SCENE.spheres, lights, st.Camera(mu=700.0))
    session = Session(scene, SIZE)
    at, behind, directional = session.handles()
    assert at is not None and behind is directional is None
    session.take({"type": "light", "row": 0, "x": at[0] + 3, "y": at[1] - 2})
    moved = session.handles()[0]
    np.testing.assert_allclose(moved, (at[0] + 3, at[1] - 2, at[2]), rtol=1e-4)
    np.testing.assert_array_equal(session.scene.lights.position[1:], lights.position[1:])
    for hidden in (1, 2):
        with pytest.raises(st.InputError, match=f"light {hidden + 1} cannot be dragged"):
            session.take({"type": "light", "row": hidden, "x": 1, "y": 1})


def test_a_heat_map_is_black_at_0_and_brightest_at_its_scale():
    numbers = np.zeros((1, 3, 3))
    numbers[0, 1, 2], numbers[0, 2] = -4.0, [1.0, 0.5, np.nan]
    frame = heat_map(numbers)
    assert frame.scale == 4 and (frame.pixels[0, 0, :3] == 0).all()
    np.testing.assert_array_equal(frame.pixels[0, 1, :3], [64, 153, 255])
    assert frame.pixels[0, 2, 0] == 128 > frame.pixels[0, 2, 2] > 0


def test_the_residual_is_the_picture_less_the_target(session):
    session.take({"type": "show", "kind": "residual"})
    picture = np.asarray(st.render(SCENE, width=24, height=16))
    frame = session.frame()()
    assert frame.scale == pytest.approx(np.abs(picture - 0.25).max(), rel=1e-5)
    with pytest.raises(st.InputError, match="there is no target: start with --target PICTURE"):
        Session(SCENE, SIZE).take({"type": "show", "kind": "residual"})


def test_the_derivative_is_that_of_differences(session):
    shown = {"type": "show", "kind": "derivative", "parameter": "color", "row": 1, "column": 0}
    session.take(shown)
    frame = session.frame()()
    small = 1e-2
    pictures = [
        np.asarray(st.render(st.replace(SCENE, {"color": c}), width=24, height=16))
        for c in (SCENE.spheres.color, SCENE.spheres.color.at[1, 0].add(small))
    ]
    slope = (pictures[1] - pictures[0]) / small
    assert frame.scale == pytest.approx(slope.max(), rel=1e-3)
    seen = slope.max(axis=2) > 0.02 * slope.max()
    np.testing.assert_array_equal(frame.pixels[..., 0] > 30, seen)


@pytest.mark.slow
def test_no_slider_compiles_twice(session):
    """After features that sliders switch on are compiled, all numbers move without compiling."""
    session.bounces = 1

    def move(by: float) -> None:
        for names in SLIDERS.values():
            for name in names:
                if name == "light_direction":
                    continue
                number = np.asarray(st.values(session.scene, name)[name]).flat[0]
                top = 1.0 if name in ("color", "ka", "kd", "ks", "kgr", "kt") else np.inf
                value = min(float(number) + by, top) if name != "ior" else 1.3 + by
                session.take({"type": "set", "name": name, "value": value})
        session.frame()()

    move(0.1)
    compiled = []
    listen = lambda event, seconds, **_: (
        event.endswith("backend_compile_duration") and (compiled.append(event))
    )
    jax.monitoring.register_event_duration_secs_listener(listen)
    for by in (0.01, -0.02, 0.03):
        move(by)
    jax.monitoring.unregister_event_duration_listener(listen)
    assert not compiled
