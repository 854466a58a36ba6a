"""Time of pictures and gradients, beside POV-Ray in the same run: `make bench`.

Medians of interleaved runs; compile time apart. Where POV-Ray is missing its column is empty.
"""

import re
import shutil
import statistics
import subprocess
import tempfile
import time
import warnings
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp

import spheretrace_jax as st

SCENE = Path(__file__).parent.parent.parent / "data" / "nine_spheres.txt"
SIZE, RUNS = 1024, 7


def povray_seconds(scene: st.Scene, bounces: int) -> float | None:
    """POV-Ray's own trace time, on all cores."""
    if shutil.which("povray") is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "scene.pov")
        st.write_povray(file, scene, bounces=bounces)
        command = ["povray", f"+I{file}", f"+W{SIZE}", f"+H{SIZE}", "-A", "-D", "-F"]
        said = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    return float(re.search(r"Trace Time:.*\((\S+) seconds\)", said)[1])


def timed(function) -> float:
    start = time.perf_counter()
    jax.block_until_ready(function())
    return time.perf_counter() - start


def main() -> None:
    warnings.simplefilter("ignore", st.SceneWarning)
    scene = st.load_scene(SCENE, "float32")
    lights = st.Lights(jnp.array([[100, 900, 300]], jnp.float32))  # casts shadows; its own does not
    scene = eqx.tree_at(lambda s: s.lights, scene, lights)
    needs = st.needs(scene)
    print(f"nine spheres, light at (100, 900, 300), {SIZE} x {SIZE}, float32, {jax.devices()[0]}")
    print(f"{'work':28} {'first call':>10} {'median':>9} {'POV-Ray':>9} {'ratio':>6}")
    for bounces in (0, 1, 3):
        settings = dict(width=SIZE, height=SIZE, samples=1, bounces=bounces, needs=needs)
        loss = jax.jit(jax.grad(lambda s, k=settings: jnp.mean((st.render(s, **k) - 0.3) ** 2)))
        works = {
            f"picture, {bounces} bounces": lambda k=settings: st.render(scene, **k),
            f"gradient, {bounces} bounces": lambda f=loss: f(scene),
        }
        first = {name: timed(work) for name, work in works.items()}
        runs = {name: [] for name in works}
        peers = []
        for _ in range(RUNS):
            for name, work in works.items():
                runs[name].append(timed(work))
            peers.append(povray_seconds(scene, bounces))
        peer = None if None in peers else statistics.median(peers)
        for name, seconds in runs.items():
            median = statistics.median(seconds)
            beside = f"{peer:7.3f} s {median / peer:6.2f}" if peer and "picture" in name else ""
            print(f"{name:28} {first[name]:8.2f} s {1e3 * median:6.1f} ms {beside}")


if __name__ == "__main__":
    main()
