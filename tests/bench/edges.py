"""Errors of antialiased pictures and of their derivatives, and what edges cost.

`python tests/bench/edges.py` takes some twenty minutes, `--quick` a few. The truth are point
samples: many rays per pixel and, for derivatives, their central differences by small steps.
"""

import statistics
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import spheretrace_jax as st

sys.path.insert(0, str(Path(__file__).parent.parent))
from helpers.derivatives import PARAMETERS, blurred, derivative, difference, off
from helpers.scenes import nine_spheres, three_spheres


def medians(works: dict[str, Callable], runs: int) -> dict[str, float]:
    """Seconds per call, of interleaved runs; the first calls compile and do not count."""
    seconds = {name: [] for name in works}
    for number in range(runs + 1):
        for name, work in works.items():
            start = time.perf_counter()
            jax.block_until_ready(work())
            if number:
                seconds[name].append(time.perf_counter() - start)
    return {name: statistics.median(values) for name, values in seconds.items()}


def picture_errors(title: str, scene: st.Scene, size: int, samples: tuple[int, ...]) -> None:
    settings = dict(width=size, height=size, bounces=0)
    truth = np.asarray(st.render(scene, samples=96, **settings))
    finer = off(st.render(scene, samples=64, **settings), truth)
    print(f"\npicture: {title}, {size} x {size}, float64 (truth 96 x 96 rays: 64 x 64 {finer:.1e})")
    print(f"{'samples':8} {'coverage':>20} {'points':>20}")
    scenes = {"coverage": scene.with_antialias(1), "points": scene}
    draw = {(n, k): lambda s=s, k=k: st.render(s, samples=k, **settings)
            for n, s in scenes.items() for k in samples}  # fmt: skip
    seconds = medians(draw, 5)
    errors = {work: off(draw[work](), truth) for work in draw}
    for k in samples:
        cell = lambda name, k=k: f"{errors[name, k]:9.2e} {1e3 * seconds[name, k]:7.1f} ms"
        print(f"{k:<8} {cell('coverage'):>20} {cell('points'):>20}", flush=True)


def picture_order(title: str, scene: st.Scene, sizes: tuple[int, ...]) -> None:
    print(f"\norder in the pixel's size: {title}, one sample (truth 128 x 128 rays)")
    errors = []
    for size in sizes:
        settings = dict(width=size, height=size, bounces=0)
        truth = np.asarray(st.render(scene, samples=128, **settings))
        errors.append([off(st.render(scene.with_antialias(a), **settings), truth) for a in (1, 0)])
        print(f"{size:<8} {errors[-1][0]:20.2e} {errors[-1][1]:20.2e}", flush=True)
    slopes = -np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    print(f"{'slope':8} {slopes[0]:20.2f} {slopes[1]:20.2f}", flush=True)


def derivative_errors(size: int, samples: tuple[int, ...]) -> None:
    scene, settings = three_spheres(), dict(width=size, height=size, bounces=0)
    smooth = scene.with_antialias(1)
    forward = {f"coverage {k}": derivative(smooth, samples=k, **settings) for k in samples}
    forward = forward | {"points": derivative(scene, **settings)}
    print(f"""
derivatives: three spheres, {size} x {size}, float64; errors in %, of the sum against a smooth
weight and of the picture. The truth are differences of rays: for sums 24 x 24 rays, with a step of
1/5 pixel; for pictures 96 x 96 rays and 1/80 pixel, since some edges move much farther than others.
+-: of the truth, by doubling the step and, for pictures, by 80 x 80 rays. The weight is the truth,
blurred; kept: the |sum| over the sum of absolute values.""")
    print(f"{'':9}" + "".join(f"{head:>17}" for head in ("+-", *forward)) + "   kept")
    for name, (_, _, step) in PARAMETERS.items():
        step = step * 256 / size
        change = lambda h, k, name=name: difference(scene, name, h, samples=k, **settings)
        wider, wide = change(8 * step, 24), change(4 * step, 24)
        coarse, truth = change(step / 2, 80), change(step / 4, 96)
        weight = blurred(wider, size / 24)
        total = np.vdot(weight, wide)
        found = [(wider, coarse), *((g, g) for g in (by(name) for by in forward.values()))]
        cells = [
            f"{100 * (np.vdot(weight, a) / total - 1):+8.3f} {100 * off(b, truth):8.2f}"
            for a, b in found
        ]
        kept = total / np.abs(weight * wide).sum()
        print(f"{name:9}" + "".join(cells) + f"   {kept:.2f}", flush=True)


def cost(size: int, runs: int) -> None:
    scene = nine_spheres(dtype=np.float32)
    works = {}
    for name, s in {"coverage": scene.with_antialias(1), "points": scene}.items():
        settings = dict(width=size, height=size, bounces=0, needs=st.needs(s))
        draw = lambda s, k=settings: st.render(s, **k)
        loss = jax.jit(jax.grad(lambda s, draw=draw: jnp.mean((draw(s) - 0.3) ** 2)))
        works["picture", name] = lambda s=s, draw=draw: draw(s)
        works["gradient", name] = lambda s=s, loss=loss: loss(s)
    seconds = medians(works, runs)
    print(f"\ncost: nine spheres, {size} x {size}, float32, {jax.devices()[0]}")
    print(f"{'':9} {'coverage':>12} {'points':>12} {'ratio':>6}")
    for work in ("picture", "gradient"):
        smooth, hard = seconds[work, "coverage"], seconds[work, "points"]
        print(
            f"{work:9} {1e3 * smooth:9.1f} ms {1e3 * hard:9.1f} ms {smooth / hard:6.2f}", flush=True
        )


def main() -> None:
    warnings.simplefilter("ignore", st.SceneWarning)
    quick = "--quick" in sys.argv[1:]
    jax.config.update("jax_enable_x64", True)
    samples = (1, 2) if quick else (1, 2, 4)
    picture_errors("three spheres", three_spheres(), 96, samples)
    picture_order("three spheres", three_spheres(), (24, 48, 96))
    if not quick:
        picture_errors("nine spheres", nine_spheres(), 256, samples)
        picture_order("nine spheres", nine_spheres(), (64, 128, 256))
    derivative_errors(96 if quick else 256, samples)
    cost(1024, 3 if quick else 7)


if __name__ == "__main__":
    main()
