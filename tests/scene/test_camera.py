import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spheretrace_jax as st
from spheretrace_jax.scene.camera import DEFAULTS, pixel_rays, view_frame


def rows(v) -> np.ndarray:
    return np.stack([np.asarray(x) for x in (v.x, v.y, v.z)], axis=-1)


@pytest.mark.parametrize("theta", [-0.01, 0.0, 2.0])
@pytest.mark.parametrize("phi", [0.0, 0.01, 1.3, np.pi])
@pytest.mark.parametrize("mu", [0.0, 500.0])
def test_axes_are_orthonormal_and_look_at_the_origin(theta, phi, mu):
    frame = view_frame(st.Camera(theta, phi, mu))
    axes = np.stack([rows(frame.right), rows(frame.up), rows(frame.forward)])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(np.cross(axes[0], axes[1]), -axes[2], atol=1e-15)
    np.testing.assert_allclose(rows(frame.eye) + mu * axes[2], 0, atol=1e-12)


def test_the_eye_is_where_the_lecture_puts_it():
    theta, phi, mu = -0.3, 0.8, 500.0
    eye = mu * np.array([np.sin(phi) * np.cos(theta), np.sin(phi) * np.sin(theta), np.cos(phi)])
    np.testing.assert_allclose(rows(view_frame(st.Camera(theta, phi, mu)).eye), eye, rtol=1e-15)


def test_rays_pass_the_pixel_centres_of_the_window_row_0_at_the_top():
    camera, width, height = st.Camera(0.7, 1.1, 500.0, 800.0), 4, 3
    columns, lines = jnp.arange(4.0) + 0.5, jnp.arange(3.0) + 0.5
    ray = pixel_rays(camera, columns[None, :], lines[:, None], (width, height))
    frame, pitch = view_frame(camera), 512 / height
    for j in range(height):
        for i in range(width):
            x, y = (i + 0.5 - width / 2) * pitch, -(j + 0.5 - height / 2) * pitch
            towards = x * rows(frame.right) + y * rows(frame.up) + 800 * rows(frame.forward)
            expected = towards / np.linalg.norm(towards)
            np.testing.assert_allclose(rows(ray.direction)[j, i], expected, atol=1e-15)


def test_the_windows_height_sets_the_field_of_view():
    ray = pixel_rays(
        st.Camera(distance=100.0, window=200.0), jnp.array([0.5]), jnp.zeros(1), (1, 1)
    )
    np.testing.assert_allclose(
        rows(ray.direction)[0], [-np.sqrt(0.5), 0, -np.sqrt(0.5)], atol=1e-15
    )


def rays_of(camera: st.Camera):
    columns, lines = jnp.arange(4.0)[None] + 0.5, jnp.arange(3.0)[:, None] + 0.5
    return pixel_rays(camera, columns, lines, (4, 3))


@pytest.mark.parametrize("name", DEFAULTS)
def test_what_is_unset_is_as_by_default_and_costs_nothing(name):
    unset, given = st.Camera(0.3, 0.4), st.Camera(0.3, 0.4, **{name: DEFAULTS[name]})
    assert getattr(unset, name) is None
    for a, b in zip(*(jax.tree.leaves(rays_of(c)) for c in (unset, given)), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-15)
    operations = [len(jax.make_jaxpr(rays_of)(camera).eqns) for camera in (unset, given)]
    assert operations[0] < operations[1]


def test_the_eye_turns_around_what_it_looks_at():
    middle = np.array([10.0, -20, 30])
    frame, other = (view_frame(st.Camera(0.3, 0.8, 50.0, look_at=at)) for at in (middle, None))
    np.testing.assert_allclose(rows(frame.eye) - rows(other.eye), middle, atol=1e-13)
    np.testing.assert_allclose(rows(frame.eye) + 50 * rows(frame.forward), middle, atol=1e-13)


def test_a_camera_that_rolls_lowers_its_right_side():
    frame, level = (view_frame(st.Camera(0.3, 0.8, roll=r)) for r in (0.4, None))
    axes = np.stack([rows(frame.right), rows(frame.up), rows(frame.forward)])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(rows(frame.right) @ rows(level.up), -np.sin(0.4), atol=1e-15)
    # Rodrigues' formula about the axis
    axis, right = rows(level.forward), rows(level.right)
    turned = right * np.cos(0.4) + np.cross(axis, right) * np.sin(0.4)
    np.testing.assert_allclose(rows(frame.right), turned, atol=1e-15)


def test_the_axis_meets_the_picture_at_the_principal_point():
    camera = st.Camera(0.3, 0.8, principal_point=[0.1, -0.2], pixel_aspect=1.5)
    column, line = jnp.array([32 + 4.8]), jnp.array([24 - 9.6])
    ray = pixel_rays(camera, column, line, (64, 48))
    forward = rows(view_frame(camera).forward)
    np.testing.assert_allclose(rows(ray.direction)[0], forward, atol=1e-15)
    # a pixel to the right is 1.5 times as far as one down
    aside, below = (
        pixel_rays(camera, column + x, line + y, (64, 48)).direction for x, y in ((1, 0), (0, 1))
    )
    tangents = [np.linalg.norm(np.cross(rows(v)[0], forward)) for v in (aside, below)]
    tangents = np.tan(np.arcsin(tangents))
    np.testing.assert_allclose(tangents[0] / tangents[1], 1.5, rtol=1e-12)


def test_parallel_rays_start_on_the_plane_of_the_eye():
    camera = st.Camera(0.3, 0.8, window=30.0, orthographic=True, principal_point=[0.5, 0.0])
    ray, frame = rays_of(camera), view_frame(camera)
    direction = np.broadcast_to(rows(frame.forward), (3, 4, 3))
    np.testing.assert_array_equal(np.round(rows(ray.direction) - direction, 15), 0)
    assert ray.direction.x.shape == ray.origin.x.shape == (3, 4)
    offset = rows(ray.origin) - rows(frame.eye)
    np.testing.assert_allclose(offset @ rows(frame.forward), 0, atol=1e-12)
    x, y = offset @ rows(frame.right), offset @ rows(frame.up)
    np.testing.assert_allclose(x, np.broadcast_to([-30.0, -20, -10, 0], x.shape), atol=1e-12)
    np.testing.assert_allclose(y, np.broadcast_to([[10.0], [0], [-10]], y.shape), atol=1e-12)


def test_shapes_are_checked():
    scene = st.Scene(st.Spheres([[0.0, 0, 0]], [1.0]), st.Lights([[0.0, 0, 9]]))
    wrong = eqx.tree_at(lambda c: c.look_at, st.Camera(), jnp.zeros(2), is_leaf=lambda x: x is None)
    wrong = eqx.tree_at(lambda s: s.camera, scene, wrong)
    with pytest.raises(st.InputError, match=r"camera.look_at must be an array of shape \(3,\)"):
        st.render(wrong, width=4, height=4)
