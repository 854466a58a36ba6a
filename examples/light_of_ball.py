"""Finds the lights of photographs of a ball, and fits a scene to one of them.

python examples/light_of_ball.py [--fit]
"""

import argparse
from pathlib import Path

import numpy as np

import spheretrace_jax as st
from spheretrace_jax.calibration.light_files import read_lights

FOLDER = Path(__file__).parent.parent / "data" / "ball"
FOCAL = 420.0  # pixels: 37.8 mm on a sensor that is 36 mm wide, 400 pixels cropped to 160


def main() -> None:
    parser = argparse.ArgumentParser(description="Find the lights of photographs of a ball.")
    parser.add_argument("--fit", action="store_true", help="fit a scene to the first photograph")
    fit = parser.parse_args().fit
    truth = read_lights(FOLDER / "lights.csv")
    files = [next(FOLDER.glob(f"{light['name']}.*g")) for light in truth]
    pictures = [st.read_image(f, "linear" if f.suffix == ".png" else "srgb") for f in files]
    found = st.lights(pictures, focal=FOCAL, names=[f.stem for f in files])
    for light, true in zip(found, truth, strict=True):
        off = np.degrees(np.arccos(np.clip(light.direction @ true["direction"], -1, 1)))
        print(f"{light}\n    {off:.2f} degrees off the truth, which is {true['distance']:g} away")
    if fit:
        free = ("color", "ka", "kd", "ks", "exponent", "ior", "light_position")
        scene, mask = found.scene(0), np.isfinite(found.picture(0)).all(axis=2)
        result = st.fit(scene, pictures[0], free=free, highlight="blinn", mask=mask, noise="photo")
        print(result)


if __name__ == "__main__":
    main()
