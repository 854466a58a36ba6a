"""One scene fitted by `st.fit` and by Mitsuba 3 with Adam: errors over seconds.

Needs the extra `bench` and LLVM's shared library (Debian: libllvm19). The nine spheres are made
diffuse, which both draw; colours start grey, the light displaced. Each program fits a picture of
its own, which it can reach exactly. First calls are apart; Mitsuba keeps its kernels on the disk.
"""

import argparse
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from peers import LIGHT, mitsuba, mitsuba_scene

import spheretrace_jax as st
from spheretrace_jax.demo import wrong_start

SCENE = Path(__file__).parent.parent.parent / "data" / "nine_spheres.txt"
SIZE = 256
Curve = list[tuple[float, float, float]]  # seconds, error of the light, error of the colours


class Recipe(NamedTuple):
    """How Adam is used. The rates are the best that were found by trial for this scene."""

    color_rate: float
    light_rate: float
    beta_2: float
    halved: float  # iterations in which the rates halve
    steady: bool  # intensity pi |position|^2: a farther light is no darker, as in our model


RECIPES = {
    "Mitsuba + Adam": Recipe(0.02, 10, 0.999, np.inf, False),  # as in Mitsuba's tutorials
    "the same tuned": Recipe(0.02, 20, 0.9, 150, True),
}


def start_and_truth(dtype: str) -> tuple[st.Scene, st.Scene]:
    """kd is right from the start and is not fitted."""
    truth = st.load_scene(SCENE, dtype).with_antialias(0)
    shine = lambda s: (s.spheres.ka, s.spheres.ks, s.spheres.kgr)
    truth = eqx.tree_at(shine, truth, replace_fn=jnp.zeros_like)
    wrong = lambda s: (s.spheres.color, s.lights.position)
    return eqx.tree_at(wrong, truth, wrong(wrong_start(truth))), truth


def fitted(scene: st.Scene) -> np.ndarray:
    """The light's position, then the reflectances kd*color, row by row."""
    s = scene.spheres
    return np.concatenate([scene.lights.position, s.kd[:, None] * s.color])


def errors(found: np.ndarray, truth: st.Scene) -> tuple[float, float]:
    """How far the light is off, world units, and the largest error of a reflectance."""
    off = found - fitted(truth)
    return float(np.linalg.norm(off[0])), float(np.abs(off[1:]).max())


def picture(scene: st.Scene) -> np.ndarray:
    return np.asarray(st.render(scene, width=SIZE, height=SIZE, bounces=0))


def our_fit(dtype: str, seconds: float) -> Curve:  # ends by itself, whatever the seconds
    start, truth = start_and_truth(dtype)
    target, curve, began = picture(truth), [], time.perf_counter()
    note = lambda s: curve.append((time.perf_counter() - began, *errors(fitted(s), truth)))
    note(start)
    free = ("color", "light_position")
    note(st.fit(start, target, free=free, bounces=0, callback=lambda p: note(p.scene)).scene)
    return curve


def mitsuba_fit(mi: Any, dr: Any, recipe: Recipe, seconds: float) -> Curve:
    """One sample per pixel, always the target's: without noise Adam comes nearest."""
    start, truth = start_and_truth("float64")  # Mitsuba rounds to float32
    scene, values = mitsuba_scene(mi, truth, SIZE), fitted(start)
    target, parameters = mi.render(scene, spp=1, seed=0), mi.traverse(scene)
    names = [LIGHT, *(f"ball{i}.bsdf.reflectance.value" for i in range(len(values) - 1))]
    adam = mi.ad.Adam(lr=recipe.color_rate, beta_2=recipe.beta_2)
    for name, value in zip(names, values.tolist(), strict=True):
        adam[name] = type(parameters[name])(value)
    curve, began = [(0.0, *errors(values, truth))], time.perf_counter()
    while len(curve) <= 3 or curve[-1][0] < seconds:  # the first three are compiled one by one
        left = 0.5 ** ((len(curve) - 1) / recipe.halved)
        colors = dict.fromkeys(names[1:], left * recipe.color_rate)
        adam.set_learning_rate(colors | {LIGHT: left * recipe.light_rate})
        if recipe.steady:
            parameters["light.intensity.value"] = mi.Color3f(np.pi * dr.squared_norm(adam[LIGHT]))
        parameters.update(adam)
        dr.backward(dr.mean(dr.square(mi.render(scene, parameters, spp=1, seed=0) - target)))
        adam.step()
        for name in names[1:]:  # to 0..1; dr.clip ends the program under LLVM 14 and 15
            adam[name] = dr.select(adam[name] < 0, 0, dr.select(adam[name] > 1, 1, adam[name]))
        dr.eval(*(adam[name] for name in names))
        values = np.stack([np.asarray(adam[name]).ravel() for name in names])
        curve.append((time.perf_counter() - began, *errors(values, truth)))
    return curve


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=15, help="of each fit by Mitsuba")
    parser.add_argument("--curve", type=Path, metavar="FILE.csv", help="where to write all points")
    arguments = parser.parse_args()
    if (loaded := mitsuba()) is None:
        return
    mi, dr = loaded
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore", st.SceneWarning)
    truth = start_and_truth("float64")[1]
    ours, theirs = picture(truth), np.asarray(mi.render(mitsuba_scene(mi, truth, SIZE), spp=16))
    apart = np.abs(ours - theirs).mean()
    print(f"pictures of the truth: means {ours.mean():.4f}, {theirs.mean():.4f}; {apart:.4f} apart")
    fits: dict[str, Callable] = {f"ours {d}": partial(our_fit, d) for d in ("float64", "float32")}
    fits |= {name: partial(mitsuba_fit, mi, dr, recipe) for name, recipe in RECIPES.items()}
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
