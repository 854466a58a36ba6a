"""Renders nine_spheres.png, the demo's target, with POV-Ray 3.7: called by `make references`.

POV-Ray draws the picture at twice the size, one ray per pixel. Its 2 x 2 averages are the means of
four rays per pixel. The light is halved, so that POV-Ray's integers do not clip before the average.
The picture is stored as 16-bit sRGB, clipped at white as a camera's pictures are.
"""

import subprocess
import tempfile
from pathlib import Path

import equinox as eqx

from spheretrace_jax import load_scene, read_image, write_image, write_povray

HERE = Path(__file__).parent
SIZE = 160


def main() -> None:
    with tempfile.TemporaryDirectory() as temporary:
        pov, png = Path(temporary, "scene.pov"), Path(temporary, "scene.png")
        scene = load_scene(HERE / "nine_spheres.txt")
        write_povray(pov, eqx.tree_at(lambda s: s.lights.color, scene, scene.lights.color / 2))
        size = [f"+W{2 * SIZE}", f"+H{2 * SIZE}"]
        output = ["-A", "-D", "+FN16", "File_Gamma=1.0"]
        subprocess.run(
            ["povray", f"+I{pov}", f"+O{png}", *size, *output], check=True, capture_output=True
        )
        fine = read_image(png, "linear")
    picture = 2 * fine.reshape(SIZE, 2, SIZE, 2, 3).mean(axis=(1, 3))
    write_image(HERE / "nine_spheres.png", picture, bits=16)


if __name__ == "__main__":
    main()
