"""Cameras of photographs: OpenCV's matrices in and out, against NumPy's K (R X + t), and crops."""

import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import SCENES, VIEWS, with_camera

import spheretrace_jax as st
from spheretrace_jax.scene.camera import pixel_rays, view_frame

SIZE = WIDTH, HEIGHT = 640, 480
K = np.array([[700.0, 0, 350], [0, 650, 201], [0, 0, 1]])


def rotation(seed: int) -> np.ndarray:
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


#: Rotations of all kinds: any, and those that look straight up, down, and along the axes.
POSES = {
    **{f"random {seed}": rotation(seed) for seed in range(6)},
    "identity": np.eye(3),
    "down": np.diag([1.0, -1, -1]),
    "down, rolled": np.array([[0.6, 0.8, 0], [0.8, -0.6, 0], [0, 0, -1]]),
    "up, rolled": np.array([[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]]),
    "along x": np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]),
    "nearly up": np.array([[1.0, 0, -1e-9], [0, 1, 0], [1e-9, 0, 1]]),
}
TRANSLATION = np.array([0.3, -1.2, 6.0])


def rows(v, shape=()) -> np.ndarray:
    return np.stack([np.broadcast_to(x, shape) for x in (v.x, v.y, v.z)], axis=-1)


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("t", [TRANSLATION, -TRANSLATION, 0 * TRANSLATION])
def test_round_trip(pose, t):
    camera = st.Camera.from_opencv(K, POSES[pose], t, SIZE)
    for found, given in zip(camera.opencv(SIZE), (K, POSES[pose], t), strict=True):
        np.testing.assert_allclose(found, given, rtol=1e-13, atol=1e-13)
    again = st.Camera.from_opencv(*camera.opencv(SIZE), SIZE)
    for found, given in zip(again.opencv(SIZE), camera.opencv(SIZE), strict=True):
        np.testing.assert_allclose(found, given, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("pose", POSES)
def test_points_are_seen_where_opencv_projects_them(pose):
    R, t = POSES[pose], TRANSLATION
    points = np.random.default_rng(0).uniform(-2, 2, (50, 3))
    in_camera = points @ R.T + t
    seen = in_camera @ K.T
    columns, lines = (seen[:, :2] / seen[:, 2:]).T
    camera = st.Camera.from_intrinsics(
        K[0, 0], K[1, 1], K[0, 2], K[1, 2], *SIZE, rotation=R, translation=t[:, None]
    )
    # OpenCV counts from the middle of the first pixel, rays from its corner
    ray = pixel_rays(camera, jnp.asarray(columns + 0.5), jnp.asarray(lines + 0.5), SIZE)
    direction, eye = rows(ray.direction, (50,)), rows(ray.origin)
    np.testing.assert_allclose(eye, -R.T @ t, atol=1e-13)
    off = np.cross(points - eye, direction)
    np.testing.assert_allclose(off, 0, atol=1e-12)
    assert (np.sum((points - eye) * direction, axis=1) > 0).all()


def test_a_ball_is_drawn_where_opencv_projects_it():
    R, t = POSES["random 1"], TRANSLATION
    center = R.T @ ([0.4, -0.5, 5.0] - t)
    small = np.array([[70.0, 0, 34.55], [0, 65, 19.65], [0, 0, 1]])
    seen = small @ (R @ center + t)
    camera = st.Camera.from_opencv(small, R, t, (64, 48))
    spheres = st.Spheres([center], [0.1], ka=1.0, kd=0.0)
    scene = st.Scene(spheres, st.Lights([[0.0, 0, 9]]), camera, antialias=1)
    picture = np.asarray(st.render(scene, width=64, height=48))[..., 0]
    middle = [np.sum(picture * grid) / picture.sum() for grid in np.indices(picture.shape)]
    # the middle of the ellipse that a ball is seen as is not quite where its centre is seen
    np.testing.assert_allclose(middle, seen[[1, 0]] / seen[2], atol=0.03)


def test_the_identity_is_opencvs_own_camera():
    camera = st.Camera.from_intrinsics(*K[[0, 1, 0, 1], [0, 1, 2, 2]], *SIZE)
    frame = view_frame(camera)
    np.testing.assert_allclose(rows(frame.eye), 0, atol=1e-15)
    np.testing.assert_allclose(rows(frame.right), [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(rows(frame.up), [0, -1, 0], atol=1e-15)
    np.testing.assert_allclose(rows(frame.forward), [0, 0, 1], atol=1e-15)


@pytest.mark.parametrize("view", [view for view in VIEWS if "ortho" not in view])
def test_the_lectures_cameras_go_round(view):
    camera = with_camera(SCENES["shadows"], **VIEWS[view]).camera
    again = st.Camera.from_opencv(*camera.opencv(SIZE), SIZE)
    columns, lines = jnp.array([[0.5, 100, 600]]), jnp.array([[2.0], [400]])
    ours, theirs = (pixel_rays(c, columns, lines, SIZE) for c in (camera, again))
    for name in ("origin", "direction"):
        found, expected = (rows(getattr(x, name), (2, 3)) for x in (theirs, ours))
        np.testing.assert_allclose(found, expected, atol=1e-12, rtol=1e-13)


def test_numbers_keep_their_precision_and_can_be_traced():
    single = [np.asarray(x, np.float32) for x in (K, POSES["random 0"], TRANSLATION)]
    camera = st.Camera.from_opencv(*single, SIZE)
    assert {x.dtype for x in jax.tree.leaves(camera)} == {jnp.dtype("float32")}
    for found, given in zip(camera.opencv(SIZE), single, strict=True):
        np.testing.assert_allclose(found, given, rtol=1e-5, atol=2e-6)

    def there_and_back(R, t):
        return st.Camera.from_opencv(K, R, t, SIZE).opencv(SIZE)[1:]

    stacked = jnp.asarray(np.stack(list(POSES.values())))
    t = jnp.broadcast_to(jnp.asarray(TRANSLATION), (len(stacked), 3))
    found = jax.jit(jax.vmap(there_and_back))(stacked, t)
    np.testing.assert_allclose(found[0], stacked, atol=1e-13)
    slopes = jax.jit(jax.vmap(jax.jacobian(there_and_back, (0, 1))))(stacked, t)
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(slopes))
    # the eye moves as it must, also at the poles
    by_t = slopes[1][1]
    np.testing.assert_allclose(by_t, np.broadcast_to(np.eye(3), by_t.shape), atol=1e-12)


def test_known_numbers_stay_known_under_a_trace():
    def needed(x):
        camera = st.Camera.from_opencv(K, np.eye(3), TRANSLATION, SIZE).crop(0, 0, 9, 9, SIZE)
        found.append(st.needs(with_camera_of(camera)))
        return x

    def with_camera_of(camera):
        return st.Scene(st.Spheres([[0.0, 0, 0]], [1.0]), st.Lights([[0.0, 0, 9]]), camera)

    found: list[st.Needs] = []
    jax.jit(needed)(1.0)
    assert not found[0].inside


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(matrix=[[700.0, 1, 350], [0, 650, 200], [0, 0, 1]]), "no skew, got K.0, 1. = 1"),
        (dict(matrix=[[700.0, 0, 350], [0, 650, 200], [0, 0, 2]]), "K must be .*fx, 0, cx"),
        (dict(matrix=np.eye(4)), r"K must be .* shape \(3, 3\), got \(4, 4\)"),
        (dict(matrix=np.diag([-1.0, 1, 1])), "fx, a focal length in pixels, must be above 0"),
        (dict(rotation=np.diag([1.0, 1, -1])), "must not mirror the world"),
        (dict(rotation=2 * np.eye(3)), "rotation must be orthonormal"),
        (dict(rotation=np.zeros(3)), r"of shapes \(3, 3\) and \(3,\), got \(3,\)"),
        (dict(translation=np.zeros(2)), r"got \(3, 3\) and \(2,\)"),
        (dict(size=(640, 0)), "height must be a whole number of pixels above 0, got 0"),
        (dict(size=(-3, 480)), "width must be a whole number of pixels above 0, got -3"),
    ],
)
def test_errors_say_what_is_wrong(change, message):
    good = dict(matrix=K, rotation=np.eye(3), translation=TRANSLATION, size=SIZE)
    with pytest.raises(st.InputError, match=message):
        st.Camera.from_opencv(**good | change)


def test_an_orthographic_camera_has_no_matrices():
    with pytest.raises(st.InputError, match="an orthographic camera has no K"):
        st.Camera(orthographic=True).opencv(SIZE)


@pytest.mark.parametrize("view", [None, *VIEWS])
def test_rays_of_a_crop_are_those_of_the_picture(view):
    camera = with_camera(SCENES["shadows"], **VIEWS.get(view, {})).camera
    left, top, width, height = 100, 37, 301, 113
    part = camera.crop(left, top, width, height, SIZE)
    columns, lines = jnp.arange(301.0)[None] + 0.5, jnp.arange(113.0)[:, None] + 0.5
    ours = pixel_rays(camera, columns + left, lines + top, SIZE)
    theirs = pixel_rays(part, columns, lines, (width, height))
    for a, b in zip(*(jax.tree.leaves(x) for x in (ours, theirs)), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=8e-16 * max(1, float(abs(a).max())))
    twice = part.crop(5, 6, 20, 10, (width, height))
    once = camera.crop(left + 5, top + 6, 20, 10, SIZE)
    for a, b in zip(*(jax.tree.leaves(x) for x in (once, twice)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-14)


@pytest.mark.parametrize("view", [None, "orthographic, all"])
def test_pictures_of_a_crop_are_those_of_the_picture(view):
    scene = with_camera(SCENES["shadows"], **VIEWS.get(view, {}))
    camera = scene.camera.crop(12, 5, 16, 20, (48, 32))
    whole = st.render(scene, width=48, height=32, bounces=0)
    part = st.render(with_camera(scene, **vars(camera)), width=16, height=20, bounces=0)
    np.testing.assert_allclose(part, whole[5:25, 12:28], rtol=0, atol=1e-13)
    assert np.asarray(part).any()


def test_the_page_on_cameras_runs_as_it_stands():
    page = (Path(__file__).parents[2] / "docs" / "cameras.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    names: dict = {}
    exec(compile(block, "cameras.md", "exec"), names)
    for name in ("K", "R", "t"):
        np.testing.assert_allclose(names[f"{name}_again"], names[name], atol=1e-12)
    # the ball is where K (R X + t) says, and the crop is a part of the picture
    assert names["picture"].shape == (480, 640, 3) and names["part"].shape == (160, 200, 3)
    inside = np.asarray(names["picture"])[151:309, 351:549]
    np.testing.assert_allclose(names["part"][1:-1, 1:-1], inside, atol=1e-12)
    seen = names["K"] @ (names["ball"].center[0] + names["t"])
    column, row = np.round(np.asarray(seen[:2] / seen[2])).astype(int)
    assert np.asarray(names["picture"])[row, column].sum() > 0.2
