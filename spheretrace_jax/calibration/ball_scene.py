"""`ball_scene`: a photograph of a ball as a scene, with the camera, the ball and its light."""

import numpy as np

from ..scene.camera import Camera
from ..scene.lights import Lights
from ..scene.scene import Scene
from ..scene.spheres import Spheres
from .ball_light import BallLight
from .ball_photo import BallPhoto
from .ball_radiance import COAT_IOR
from .camera import Number, flip_frame

# The largest coefficient of a scene.
_MOST = 1.0


def ball_scene(
    light: BallLight, photo: BallPhoto, albedo: np.ndarray, radius: Number = 1.0
) -> Scene:
    """Builds the scene that a photograph shows.

    World coordinates are the camera's: x right, y down, z forward, in the unit of `radius`. The
    material is that of the scene's own model nearest to the one found: ambient, diffuse with or
    without a coat, highlight of the same width. `fit` improves it, from here.

    **Arguments:** `light`: as found in `photo`. `albedo`: what its colour was divided by.
    """
    height, width = photo.picture.shape[:2]
    outline = photo.outline
    ball, intrinsics = outline.ball(), outline.intrinsics
    center = ball.center * radius
    if intrinsics.orthographic:
        # parallel rays along z, from a plane in front of the ball
        unit = radius / outline.radius
        x, y = (np.array([width, height]) / 2 - intrinsics.principal_point) * unit
        camera = Camera.from_intrinsics(
            1, 1, (width - 1) / 2, (height - 1) / 2, width, height,
            translation=[-x, -y, 10 * radius],
        )  # fmt: skip
        view = camera.theta, camera.phi, camera.mu, camera.distance, height * unit
        more = {"roll": camera.roll, "look_at": camera.look_at}
        camera = Camera(*view, **more, orthographic=True)
    else:
        cx, cy = intrinsics.principal_point - 0.5  # OpenCV counts from the first pixel's centre
        focal = intrinsics.focal
        camera = Camera.from_intrinsics(focal, focal, cx, cy, width, height)
    to_light = flip_frame(light.direction)
    diffuse, shine = (np.maximum(x, 0) for x in (light.color * albedo, light.highlight))
    # highlights have the light's colour, which so is told from the ball's
    hue = shine / shine.max() if (shine > 0).all() else np.ones(3)
    bright = max(float((diffuse / hue).max()), float(shine.max()))
    color, surface = bright * hue, diffuse / (bright * hue)
    ambient = float(np.clip(light.ambient.mean() / max(diffuse.mean(), 1e-300), 0, _MOST))
    exponent, coat = 60.0, 0.0
    if light.found is not None:
        unknowns = np.asarray(light.found.fit.unknowns, float)
        exponent, coat = 10.0 ** unknowns[3], unknowns[4]
    spheres = Spheres(
        center[None],
        [radius],
        color=surface[None],
        ka=ambient,
        kd=1.0,
        ks=float(shine.max() / bright),
        exponent=exponent,
        ior=COAT_IOR if coat > 0.5 else 1.0,
    )
    if light.at_infinity:
        lights = Lights(to_light[None], color[None], directional=True)
    else:
        position = center + to_light * light.distance
        lights = Lights(position[None], color[None], falloff=light.distance)
    return Scene(spheres, lights, camera, antialias=1)
