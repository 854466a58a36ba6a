"""What a user of the lecture's own file waits for, one table: `make bench`.

The file as it is: edges covered, mirrors, five bounces; 256x256, float32. Each line is measured in
a process of its own, without a cache, so that first calls are first calls.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from fit import nine_spheres, timed
from rich.console import Console
from rich.table import Table
from speed import shadowed_spheres

import spheretrace_jax as st
from spheretrace_jax.xla.jit import compiler_options

ROOT = Path(__file__).parents[2]
FILE, SIZE, RUNS = ROOT / "data" / "nine_spheres.txt", 256, 5
CLI = [sys.executable, "-c", "from spheretrace_jax.cli.main import main; main()"]


def scene_of_file(shadows: bool) -> st.Scene:
    """Returns the lecture's scene; its own light casts no shadows."""
    return (shadowed_spheres() if shadows else nine_spheres("float32")).with_antialias(1)


def seconds(work: Callable[[], Any], runs: int = RUNS) -> list[float]:
    """Returns the times of the first call and of the median of later ones."""
    return list(timed(lambda: jax.block_until_ready(work()), runs)[1:])


def picture(shadows: bool, bounces: int = 5) -> list[float]:
    scene = scene_of_file(shadows)
    return seconds(lambda: st.render(scene, width=SIZE, height=SIZE, bounces=bounces))


def gradient(bounces: int) -> list[float]:
    scene = scene_of_file(True)
    needs = st.needs(scene)
    draw = lambda scene: st.render(scene, width=SIZE, height=SIZE, bounces=bounces, needs=needs)
    loss = lambda scene: jnp.mean((draw(scene) - 0.3) ** 2)
    slope = jax.jit(jax.grad(loss), compiler_options=compiler_options())
    found = seconds(lambda: slope(scene))
    return [*found, found[1] / seconds(lambda: draw(scene))[1]]


def fit(shadows: bool) -> list[float]:
    """Returns the times of a default fit, and of all that it says of itself."""
    truth = scene_of_file(shadows)
    target = np.asarray(st.render(truth, width=SIZE, height=SIZE))
    at = lambda s: [s.spheres.ka, s.spheres.kd, s.spheres.ks, s.lights.position]
    start = eqx.tree_at(at, truth, [*(0.9 * x for x in at(truth)[:3]), at(truth)[3] + 20])
    times = []
    for _ in range(3):
        begin = time.perf_counter()
        found = st.fit(start, target)
        times.append(time.perf_counter() - begin)
    begin = time.perf_counter()
    assert found.converged and found.trust.ok, found.trust.verdict
    found.identifiability, found.uncertainty.standard_deviations  # noqa: B018
    return [times[0], min(times[1:]), time.perf_counter() - begin]


def geometry_fit(bounces: int) -> list[float]:
    truth = scene_of_file(False)
    target = np.asarray(st.render(truth, width=SIZE, height=SIZE, bounces=bounces))
    rng = np.random.default_rng(0)
    radius = truth.spheres.radius
    center = truth.spheres.center + 0.2 * radius[:, None] * rng.uniform(-1, 1, (9, 3))
    at = lambda s: (s.spheres.center, s.spheres.radius)
    start = eqx.tree_at(at, truth, (jnp.asarray(center, jnp.float32), 1.1 * radius))
    free = ("center", "radius")
    times = []
    for _ in range(2):
        begin = time.perf_counter()
        found = st.fit(start, target, free=free, bounces=bounces)
        times.append(time.perf_counter() - begin)
    assert found.converged, found.result_message
    return times


def closure(antialias: int) -> list[float]:
    """Returns the times of a picture and a gradient of colours, the scene closed over and not."""
    scene = scene_of_file(True).with_antialias(antialias)
    at = lambda s: s.spheres.color

    def draw(scene: st.Scene, color: Any) -> Any:
        moved = eqx.tree_at(at, scene, color)
        return st.render(moved, width=SIZE, height=SIZE, bounces=0)

    loss = lambda color, scene: jnp.mean(draw(scene, color) ** 2)
    color = scene.spheres.color
    later = lambda work: seconds(work, 15)[1]
    closed, given = jax.jit(lambda c: draw(scene, c)), jax.jit(draw)
    ratio = later(lambda: closed(color)) / later(lambda: given(scene, color))
    closed, given = jax.jit(jax.grad(lambda c: loss(c, scene))), jax.jit(jax.grad(loss))
    return [ratio, later(lambda: closed(color)) / later(lambda: given(color, scene))]


def readme() -> list[float]:
    """Returns the time of the README's first block in a new process."""
    block = (ROOT / "README.md").read_text().split("```python\n")[1].split("```")[0]
    return process([sys.executable, "-c", block])


def command(*words: str) -> list[float]:
    return process([*CLI, *words, "--no-cache"])


def process(words: list[str]) -> list[float]:
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "data").symlink_to(ROOT / "data")
        start = time.perf_counter()
        subprocess.run(words, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        return [time.perf_counter() - start]


#: What is measured, by name; the units of the numbers; and what issue 21 wanted.
LINES: dict[str, tuple[Callable[[], list[float]], str, str]] = {
    "picture": (lambda: picture(False), "first; later s", "3"),
    "picture with shadows": (lambda: picture(True), "first; later s", "4"),
    "gradient by everything, shadows": (
        lambda: gradient(5),
        "first; later s; pictures",
        "10; -; 4",
    ),
    "the same without bounces": (lambda: gradient(0), "first; later s; pictures", "-"),
    "default fit": (lambda: fit(False), "first; later; diagnosis s", "6; 0.2; 2"),
    "default fit with shadows": (lambda: fit(True), "first; later; diagnosis s", "8; 0.3; 2"),
    "geometry fit, no bounces": (lambda: geometry_fit(0), "first; later s", "15; 0.4"),
    "geometry fit, five bounces": (lambda: geometry_fit(5), "first; later s", "25; 2"),
    "closure / argument, one ray": (lambda: closure(0), "picture; gradient", "1.2; 1.2"),
    "closure / argument, edges": (lambda: closure(1), "picture; gradient", "1.2; 1.2"),
    "README's first block": (readme, "s", "15"),
    "demo": (lambda: command("demo"), "s", "20"),
    "check": (lambda: command("check", str(FILE)), "s", "25"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=LINES, help="print the numbers of one line")
    only = parser.parse_args().only
    if only:
        print(json.dumps(LINES[only][0]()))
        return
    table = Table(title=f"the lecture's file, {SIZE}x{SIZE}, float32, jax {jax.__version__}")
    for column in ("work", "measured", "unit", "wanted"):
        table.add_column(column)
    for name, (_, unit, wanted) in LINES.items():
        words = [sys.executable, "-W", "ignore", __file__, "--only", name]
        done = subprocess.run(words, capture_output=True, text=True)
        if done.returncode:
            numbers = done.stderr.strip().splitlines()[-1]
        else:
            numbers = "; ".join(f"{x:.3g}" for x in json.loads(done.stdout.splitlines()[-1]))
        table.add_row(name, numbers, unit, wanted)
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
