"""Renders the reference pictures of references.json with POV-Ray 3.7: `make references`.

Each NAME.txt becomes NAME.png in the same folder: 16 bits, linear, one ray per pixel or, with
"samples": k, the average of k x k rays. Names on the command line select pictures.
"""

import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import jax

from spheretrace_jax import load_scene, read_image, write_image
from spheretrace_jax.files.povray import write_povray

HERE = Path(__file__).parent


def render(reference: dict, folder: Path = HERE) -> None:
    """Renders the picture of one entry of the table into `folder`; exits if POV-Ray fails."""
    name = reference["name"]
    with tempfile.TemporaryDirectory() as temporary:
        pov, png = Path(temporary, f"{name}.pov"), Path(temporary, f"{name}.png")
        scene = load_scene(HERE / f"{name}.txt")
        settings = {key: reference[key] for key in ("highlight", "bounces")}
        write_povray(pov, scene, **settings, scene_path=f"{name}.txt")
        samples = reference.get("samples", 1)
        size = [f"+W{samples * reference['width']}", f"+H{samples * reference['height']}"]
        # one ray per pixel, no window, linear numbers of 16 bits
        output = ["-A", "-D", "+FN16", "File_Gamma=1.0"]
        done = subprocess.run(
            ["povray", f"+I{pov}", f"+O{png}", *size, *output], capture_output=True, text=True
        )
        if done.returncode:
            sys.exit(f"{name}: povray failed\n{done.stderr}")
        if samples > 1:
            fine = read_image(png, colorspace="linear")
            shape = reference["height"], samples, reference["width"], samples, 3
            write_image(png, fine.reshape(shape).mean((1, 3)), colorspace="linear", bits=16)
        shutil.copyfile(png, folder / png.name)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    for reference in json.loads((HERE / "references.json").read_text()):
        if len(sys.argv) == 1 or reference["name"] in sys.argv[1:]:
            render(reference)
            print(reference["name"])
