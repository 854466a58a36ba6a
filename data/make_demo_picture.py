"""Renders nine_spheres.png, the demo's target, with POV-Ray 3.7: called by `make references`.

POV-Ray draws it at twice the size, one ray per pixel; averaged 2 x 2 it is what four rays per
pixel see. Stored as 16-bit sRGB.
"""

import subprocess
import tempfile
from pathlib import Path

from spheretrace_jax import load_scene, read_image, write_image, write_povray

HERE = Path(__file__).parent
SIZE = 160


def main() -> None:
    with tempfile.TemporaryDirectory() as temporary:
        pov, png = Path(temporary, "scene.pov"), Path(temporary, "scene.png")
        write_povray(pov, load_scene(HERE / "nine_spheres.txt"))
        size = [f"+W{2 * SIZE}", f"+H{2 * SIZE}"]
        how = ["-A", "-D", "+FN16", "File_Gamma=1.0"]
        subprocess.run(
            ["povray", f"+I{pov}", f"+O{png}", *size, *how], check=True, capture_output=True
        )
        fine = read_image(png, "linear")
    picture = fine.reshape(SIZE, 2, SIZE, 2, 3).mean(axis=(1, 3))
    write_image(HERE / "nine_spheres.png", picture, bits=16)


if __name__ == "__main__":
    main()
