"""Makes the photographs in `ball/`: one ball under four point lights, by Mitsuba 3.

    pip install mitsuba
    python data/make_ball_photos.py

Mitsuba's rough plastic is not this package's model of reflection. The pictures have photon noise
and a little ambient light. The first two are PNG of 16 bits with linear numbers, the others JPEG.
`ball/lights.csv` holds the truth: directions from the ball's centre, x right, y up, z toward the
viewer, and distances in radii. The focal length is 420 pixels, the principal point the middle.
"""

from pathlib import Path

import mitsuba as mi
import numpy as np

from spheretrace_jax import write_image
from spheretrace_jax.calibration.light_files import write_lights

FOLDER = Path(__file__).parent / "ball"
WIDTH, HEIGHT, FOCAL = 160, 120, 420.0
CENTER = np.array([0.3, 0.1, 8.6])  # x right, y down, z forward; the radius is 1
ALBEDO = (0.62, 0.44, 0.3)
LIGHTS = {  # direction from the ball's centre to the light, distance
    "near": ((0.5, -0.6, -0.8), 4.0),
    "side": ((-0.9, -0.25, -0.5), 12.0),
    "above": ((0.1, -0.8, -0.7), 60.0),
    "far": ((-0.4, 0.3, -0.9), 500.0),
}
AMBIENT, PHOTONS, READ_NOISE = 0.02, 20000, 1e-3


def main() -> None:
    """Writes four photographs and their truth."""
    mi.set_variant("scalar_rgb")
    noise = np.random.default_rng(0)
    records = []
    for k, (name, (toward, distance)) in enumerate(LIGHTS.items()):
        direction = np.array(toward) / np.linalg.norm(toward)
        picture = photograph(direction, distance)
        picture = picture * (0.8 / np.quantile(picture, 0.995))
        picture = noise.poisson(picture * PHOTONS) / PHOTONS
        picture = picture + noise.normal(scale=READ_NOISE, size=picture.shape)
        if k < 2:
            write_image(FOLDER / f"{name}.png", picture, colorspace="linear", bits=16)
        else:
            write_image(FOLDER / f"{name}.jpg", picture)
        records.append({"name": name, "direction": direction * [1, -1, -1], "distance": distance})
    write_lights(FOLDER / "lights.csv", records)


def photograph(direction: np.ndarray, distance: float) -> np.ndarray:
    """Renders the ball under a point light and ambient light, linear."""
    light = CENTER + distance * direction
    rgb = lambda value: {"type": "rgb", "value": np.broadcast_to(value, 3).tolist()}
    scene = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(WIDTH / 2 / FOCAL))),
            "fov_axis": "x",
            "to_world": mi.ScalarTransform4f().look_at(
                origin=[0, 0, 0], target=[0, 0, 1], up=[0, -1, 0]
            ),
            "film": {
                "type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "rfilter": {"type": "box"}
            },
        },
        "ball": {
            "type": "sphere",
            "center": CENTER.tolist(),
            "radius": 1.0,
            "bsdf": {
                "type": "roughplastic",
                "diffuse_reflectance": rgb(ALBEDO),
                "int_ior": 1.5,
                "alpha": 0.15,
            },
        },
    }  # fmt: skip
    lamp = {"type": "point", "position": light.tolist(), "intensity": rgb(np.pi * distance**2)}
    direct = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}
    lit = mi.render(mi.load_dict(scene | {"light": lamp, "integrator": direct}), spp=64, seed=1)
    sky = {"type": "constant", "radiance": rgb(AMBIENT)}
    around = {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1, "hide_emitters": True}
    unlit = mi.render(mi.load_dict(scene | {"sky": sky, "integrator": around}), spp=256, seed=2)
    return np.array(lit)[..., :3] + np.array(unlit)[..., :3]


if __name__ == "__main__":
    main()
