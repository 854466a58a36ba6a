"""One scene fitted by `st.fit` and by Mitsuba 3 with Adam: errors over seconds.

Needs the extra `bench` and LLVM's shared library (Debian: libllvm19). The nine spheres are matt, as
both programs draw matt spheres. Colours start grey, and the light is displaced. Each program fits a
picture that it drew, so that an exact fit exists. First calls are separate; Mitsuba caches its
kernels on the disk.
"""

import argparse
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
from peers import mitsuba

import spheretrace_jax as st
from spheretrace_jax.study.benchmarks.mitsuba import (
    RECIPES,
    Recipe,
    adam_fit,
    fitted,
    matt,
    mitsuba_scene,
)
from spheretrace_jax.study.benchmarks.wrong_start import wrong_start

SCENE = Path(__file__).parent.parent.parent / "data" / "nine_spheres.txt"
SIZE = 256
Curve = list[tuple[float, float, float]]  # seconds, error of the light, error of the colours


def start_and_truth(dtype: str) -> tuple[st.Scene, st.Scene]:
    """Returns a start with the right kd, which is not fitted, and the truth."""
    truth = matt(st.load_scene(SCENE, dtype))
    wrong = lambda s: (s.spheres.color, s.lights.position)
    return eqx.tree_at(wrong, truth, wrong(wrong_start(truth))), truth


def errors(found: np.ndarray, truth: st.Scene) -> tuple[float, float]:
    """Returns the error of the light, in units of length, and the largest of a reflectance."""
    off = found - fitted(truth)
    return float(np.linalg.norm(off[0])), float(np.abs(off[1:]).max())


def picture(scene: st.Scene) -> np.ndarray:
    return np.asarray(st.render(scene, width=SIZE, height=SIZE, bounces=0))


def our_fit(dtype: str, seconds: float) -> Curve:  # ends without regard to `seconds`
    start, truth = start_and_truth(dtype)
    target, curve, began = picture(truth), [], time.perf_counter()
    note = lambda s: curve.append((time.perf_counter() - began, *errors(fitted(s), truth)))
    note(start)
    free = ("color", "light_position")
    note(st.fit(start, target, free=free, bounces=0, callback=lambda p: note(p.scene)).scene)
    return curve


def mitsuba_fit(recipe: Recipe, seconds: float) -> Curve:
    start, truth = start_and_truth("float64")  # Mitsuba rounds to float32
    steps = adam_fit(start, truth, SIZE, recipe, seconds)
    return [(second, *errors(values, truth)) for second, values in steps]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=15, help="of each fit by Mitsuba")
    parser.add_argument("--curve", type=Path, metavar="FILE.csv", help="where to write all points")
    arguments = parser.parse_args()
    if (loaded := mitsuba()) is None:
        return
    mi, _ = loaded
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore", st.SceneWarning)
    truth = start_and_truth("float64")[1]
    ours, theirs = picture(truth), np.asarray(mi.render(mitsuba_scene(mi, truth, SIZE), spp=16))
    apart = np.abs(ours - theirs).mean()
    print(f"pictures of the truth: means {ours.mean():.4f}, {theirs.mean():.4f}; {apart:.4f} apart")
    fits: dict[str, Callable] = {f"ours {d}": partial(our_fit, d) for d in ("float64", "float32")}
    fits |= {name: partial(mitsuba_fit, recipe) for name, recipe in RECIPES.items()}
    curves = {}
    for name, fit in fits.items():
        began = time.perf_counter()
        fit(seconds=0)
        first, curves[name] = time.perf_counter() - began, fit(seconds=arguments.seconds)
        print(f"{name}: first call {first:.1f} s, then {len(curves[name]) - 1} steps", flush=True)
    print(f"{'':7}" + "".join(f"  {name:>17}" for name in curves))
    print("seconds" + f"  {'light':>8} {'colour':>8}" * len(curves))
    for t in np.geomspace(0.05, max(arguments.seconds, 1), 10):
        shown = [max(point for point in curve if point[0] <= t)[1:] for curve in curves.values()]
        print(f"{t:7.2f}" + "".join(f"  {light:8.1e} {color:8.1e}" for light, color in shown))
    end = "{}: light {:.1e} after {:.2f} s".format
    print("; ".join(end(name, curve[-1][1], curve[-1][0]) for name, curve in curves.items()))
    if arguments.curve:
        rows = [f"{name},{t},{a},{b}" for name, curve in curves.items() for t, a, b in curve]
        arguments.curve.write_text("\n".join(["program,seconds,light,colour", *rows, ""]))


if __name__ == "__main__":
    main()
