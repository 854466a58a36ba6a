import jax.numpy as jnp
import numpy as np
import pytest

import spheretrace_jax as st
from spheretrace_jax.scene.camera import pixel_rays, view_frame


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
