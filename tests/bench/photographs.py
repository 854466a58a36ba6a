"""Lights of photographs of balls by another renderer, against simple methods: `make bench-lights`.

Mitsuba's rough plastic and principled materials (index 1.3 to 1.7, roughness .05 to .5), point
lights at 3 to 1,000 radii, focal lengths of 20 to 200 mm on 36 mm, a little ambient light, photon
noise; linear PNG of 16 bits and sRGB JPEG. None of these materials is a model of this package.

    python tests/bench/photographs.py [--photos 60] [--seed 0]
"""

import argparse
import tempfile
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from rich.console import Console
from rich.table import Table

import spheretrace_jax as st
from spheretrace_jax.calibration.ball_pixels import ball_hits, ball_pixels
from spheretrace_jax.calibration.camera import Intrinsics, flip_frame
from spheretrace_jax.calibration.conic import BallOutline, outline_of_ball
from spheretrace_jax.calibration.highlights import brightest_spot
from spheretrace_jax.calibration.lambert import lambert_light

WIDTH, HEIGHT, SENSOR = 400, 300, 36.0
PHOTONS, READ_NOISE = 20000, 1e-3


@dataclass
class Photo:
    """A photograph, and its truth; vectors in the camera's frame."""

    picture: np.ndarray
    outline: BallOutline
    direction: np.ndarray
    distance: float


def photographs(count: int, seed: int) -> list[Photo]:
    """Renders photographs of balls of radius 1."""
    mi.set_variant("scalar_rgb")
    numbers = np.random.default_rng(seed)
    return [_photograph(k, numbers) for k in range(count)]


def _photograph(k: int, numbers: np.random.Generator) -> Photo:
    focal = np.exp(numbers.uniform(np.log(20), np.log(200))) / SENSOR * WIDTH
    depth = max(focal / numbers.uniform(60, 110), 2.5)
    room = np.maximum(np.array([WIDTH, HEIGHT]) / 2 - 1.25 * focal / depth, 0)
    center = np.append(numbers.uniform(-1, 1, 2) * room / focal * depth, depth)
    direction = numbers.normal(size=3)
    while direction @ center > -np.cos(np.radians(75)) * np.linalg.norm(direction) * np.linalg.norm(
        center
    ):
        direction = numbers.normal(size=3)
    direction /= np.linalg.norm(direction)
    distance = float(np.exp(numbers.uniform(np.log(3), np.log(1000))))
    roughness, ior = numbers.uniform(0.05, 0.5), numbers.uniform(1.3, 1.7)
    rgb = lambda value: {"type": "rgb", "value": np.broadcast_to(value, 3).tolist()}
    color, lamp = rgb(numbers.uniform(0.15, 0.9, 3)), numbers.uniform(0.8, 1, 3)
    plastic: dict[str, Any] = {
        "type": "roughplastic",
        "diffuse_reflectance": color,
        "int_ior": ior,
        "alpha": roughness ** numbers.integers(1, 3),
        "nonlinear": bool(numbers.integers(2)),
    }
    principled = {"type": "principled", "base_color": color, "roughness": roughness, "eta": ior}
    ambient = numbers.uniform(0, 0.06) * numbers.integers(2)
    film = {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "rfilter": {"type": "box"}}
    view = mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, -1, 0])
    fov = float(np.degrees(2 * np.arctan(WIDTH / 2 / focal)))
    sensor = {"type": "perspective", "fov": fov, "fov_axis": "x", "to_world": view, "film": film}
    bsdf = principled if k % 2 else plastic
    ball = {"type": "sphere", "center": center.tolist(), "radius": 1.0, "bsdf": bsdf}
    scene = {"type": "scene", "sensor": sensor, "ball": ball}
    position = (center + distance * direction).tolist()
    light = {"type": "point", "position": position, "intensity": rgb(lamp * np.pi * distance**2)}
    direct = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}
    lit = scene | {"light": light, "integrator": direct}
    picture = np.array(mi.render(mi.load_dict(lit), spp=16, seed=k))[..., :3]
    if ambient:
        around = {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1, "hide_emitters": True}
        unlit = scene | {"sky": {"type": "constant", "radiance": rgb(ambient)}}
        unlit |= {"integrator": around}
        picture = picture + np.array(mi.render(mi.load_dict(unlit), spp=64, seed=k))[..., :3]
    outline = outline_of_ball(center, 1.0, Intrinsics(focal, WIDTH / 2, HEIGHT / 2))
    shown = picture[ball_pixels(outline, (HEIGHT, WIDTH)).mask]
    picture = picture * (0.9 / np.quantile(shown, 0.99))
    noise = numbers.normal(scale=READ_NOISE, size=picture.shape)
    return Photo(numbers.poisson(picture * PHOTONS) / PHOTONS + noise, outline, direction, distance)


def as_read(photo: Photo, kind: str, folder: Path) -> np.ndarray:
    """Writes a photograph to a file, and reads it again."""
    file = folder / f"photo.{kind}"
    if kind == "png":
        st.write_image(file, photo.picture, colorspace="linear", bits=16)
        return np.asarray(st.read_image(file, "linear"), float)
    st.write_image(file, photo.picture)
    return np.asarray(st.read_image(file, "srgb"), float)


def mask_of(outline: BallOutline) -> np.ndarray:
    """Returns which pixels' centres show the ball."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    _, _, hit = ball_hits(np.column_stack([x.ravel(), y.ravel()]), outline)
    return hit.reshape(HEIGHT, WIDTH)


def degrees(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


class Rows:
    """The errors of one method, and its times."""

    def __init__(self) -> None:
        self.errors: list[float] = []
        self.inside: list[bool] = []
        self.distances: list[float] = []  # relative errors of 1/distance
        self.seconds: list[float] = []

    def add(self, photo: Photo, direction: np.ndarray, seconds: float) -> None:
        self.errors.append(degrees(direction, photo.direction))
        self.seconds.append(seconds)

    def cells(self) -> list[str]:
        """Returns the table's cells: errors, 95 %, distances of near lights, seconds."""
        e, d = np.array(self.errors), np.array(self.distances)
        inside = f"{np.mean(self.inside):.0%}" if self.inside else "-"
        near = f"{np.median(d):.1%}; {d.max():.0%}" if d.size else "-"
        shown = [f"{e.mean():.2f}", f"{np.median(e):.2f}", f"{e.max():.2f}", inside, near]
        return [*shown, f"{np.median(self.seconds):.2f}"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--photos", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    warnings.simplefilter("ignore", st.PictureWarning)
    photos = photographs(chosen.photos, chosen.seed)
    names = ("lights, mask", "lights, ball found", "Lambert, least squares", "highlight")
    table = Table("method", "mean", "median", "max", "inside 95 %", "1/distance < 20 R", "s each")
    for kind in ("png", "jpg"):
        rows = {name: Rows() for name in names}
        with tempfile.TemporaryDirectory() as folder:
            for photo in photos:
                measure(photo, as_read(photo, kind, Path(folder)), rows)
        for name, row in rows.items():
            table.add_row(f"{kind}: {name}", *row.cells())
    Console(width=110).print(table)


def measure(photo: Photo, picture: np.ndarray, rows: dict[str, Rows]) -> None:
    """Adds the errors of all methods."""
    mask, camera = mask_of(photo.outline), photo.outline.intrinsics
    for name, ball in (("lights, mask", mask), ("lights, ball found", "auto")):
        began, row = time.perf_counter(), rows[name]
        try:
            light = st.lights(picture, ball, focal=camera.focal)[0]
        except st.InputError as error:
            print(f"{name}: {error}")
            continue
        row.add(photo, flip_frame(light.direction), time.perf_counter() - began)
        row.inside.append(row.errors[-1] <= light.error)
        if photo.distance < 20:
            row.distances.append(abs(photo.distance / light.distance - 1))
    pixels = ball_pixels(photo.outline, (HEIGHT, WIDTH), margin=1.5)
    began = time.perf_counter()
    plain = lambert_light(picture, pixels.normals, pixels.mask, level=0.999)
    rows["Lambert, least squares"].add(photo, plain.direction, time.perf_counter() - began)
    began = time.perf_counter()
    spot = brightest_spot(picture, photo.outline)
    rows["highlight"].add(photo, spot.direction, time.perf_counter() - began)


if __name__ == "__main__":
    main()
