"""Fits against the dense Jacobian, and recovery of random scenes: `make bench-fit`.

Times are medians of fits after compilation. The first call is a separate column.
"""

import argparse
import statistics
import tempfile
import time
import warnings
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

import spheretrace_jax as st
from spheretrace_jax.fit.fit import DEFAULT_FREE
from spheretrace_jax.fit.model.products import PRODUCTS, determined_products
from spheretrace_jax.study.benchmarks.wrong_start import wrong_start

SCENE = Path(__file__).parent.parent.parent / "data" / "nine_spheres.txt"
# products with a smaller standard deviation count as determined
KNOWN = 1e-3
DENSE, SAME = "256x256, Optimistix's LM, dense Jacobian", "256x256 float64"


def nine_spheres(dtype: str) -> st.Scene:
    return st.load_scene(SCENE, dtype).with_antialias(0)


def timed(function, runs: int) -> tuple[object, float, float]:
    """Returns a function's value, the seconds of its first call, and the median of later calls."""
    seconds = []
    for _ in range(runs + 1):
        start = time.perf_counter()
        value = function()
        seconds.append(time.perf_counter() - start)
    return value, seconds[0], statistics.median(seconds[1:])


def errors(found: st.Scene, truth: st.Scene) -> tuple[float, float]:
    """Returns the largest relative error of the determined products and of the light's position."""
    a, b = determined_products(found), determined_products(truth)
    products = max(np.abs(a[k] - b[k]).max() / np.abs(b[k]).max() for k in PRODUCTS)
    distance = np.linalg.norm(b["light_position"])
    return products, np.abs(a["light_position"] - b["light_position"]).max() / distance


def displaced(scene: st.Scene) -> st.Scene:
    """Moves centres by half a radius along x and y, radii by 30 %, no sphere into another."""
    i, j = np.divmod(np.arange(9), 3)
    radius = scene.spheres.radius
    move = np.stack([(-1.0) ** j, (-1.0) ** i, 0 * i], axis=1) / np.sqrt(8)
    new = scene.spheres.center + move * radius[:, None], radius * (1 - 0.3 * (-1.0) ** (i + j))
    return eqx.tree_at(lambda s: (s.spheres.center, s.spheres.radius), scene, new)


def time_and_error() -> None:
    """Fits the nine spheres: structured, from their lights, dense, and with free geometry."""
    print(
        "nine spheres from the wrong start against our own picture: colours, ka, kd, ks and light"
    )
    print(f"{'fit':42} {'first':>7} {'median':>9} {'steps':>5} {'products':>9} {'light':>8}")
    dense = optx.LevenbergMarquardt(1e-10, 1e-10)
    solid = (*DEFAULT_FREE, "center", "radius")
    medians = {}
    for name, size, dtype, settings, runs in (
        ("512x512 float64", 512, "float64", {}, 7),
        ("512x512 float64, start='lights'", 512, "float64", dict(start="lights"), 7),
        ("512x512 float32", 512, "float32", {}, 7),
        ("512x512 float32, start='lights'", 512, "float32", dict(start="lights"), 7),
        ("256x256 float64", 256, "float64", {}, 7),
        ("256x256, dense Jacobian, same solver", 256, "float64", dict(jacobian="dense"), 1),
        (DENSE, 256, "float64", dict(jacobian="dense", solver=dense), 1),
        ("256x256, centres and radii too, edges", 256, "float64", dict(free=solid), 3),
    ):
        truth = nine_spheres(dtype)
        start = wrong_start(truth)
        if "free" in settings:
            truth, start = truth.with_antialias(1), displaced(start.with_antialias(1))
        target = np.asarray(st.render(truth, width=size, height=size, bounces=0))
        run = lambda s=start, t=target, k=settings: st.fit(s, t, bounces=0, **k)
        found, first, median = timed(run, runs)
        medians[name] = median
        products, light = errors(found.scene, truth)
        times = f"{name:42} {first:5.1f} s {median:7.3f} s"
        print(f"{times} {found.steps:5} {products:9.1e} {light:8.1e}", flush=True)
    print(f"Optimistix with the dense Jacobian / ours: {medians[DENSE] / medians[SAME]:.0f}")


def outliers() -> None:
    print("256x256, 10 % of the pixels random, 8-bit sRGB:")
    truth = nine_spheres("float64")
    picture = np.array(st.render(truth, width=256, height=256, bounces=0))
    rng = np.random.default_rng(0)
    wrong = rng.random((256, 256)) < 0.1
    picture[wrong] = rng.random((int(wrong.sum()), 3))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "target.png")
        st.write_image(file, np.clip(picture, 0, 1), bits=8)
        target = st.read_image(file)
    for loss in ("square", "huber", "cauchy"):
        found = st.fit(wrong_start(truth), target, bounces=0, loss=loss)
        products, light = errors(found.scene, truth)
        print(f"  {loss:8} {found.steps:3} steps, products {products:.1e}, light {light:.1e}")


def random_scene(rng: np.random.Generator, n: int, lights: int) -> st.Scene:
    """Makes n spheres side by side, and lights in the half space of the camera."""
    grid = int(np.ceil(np.sqrt(n)))
    cell = rng.permutation(grid * grid)[:n]
    side = 420 / grid
    jitter = lambda: rng.uniform(-0.1, 0.1, n) * side
    x, y = (cell % grid + 0.5) * side - 210 + jitter(), (cell // grid + 0.5) * side - 210 + jitter()
    center = np.stack([x, y, rng.uniform(-100, 100, n)], axis=1)
    spheres = st.Spheres(
        center,
        rng.uniform(0.25, 0.48, n) * side,
        rng.uniform(0.15, 1, (n, 3)),
        ka=rng.uniform(0.1, 0.4, n),
        kd=rng.uniform(0.3, 0.6, n),
        ks=rng.uniform(0.1, 0.5, n),
        exponent=10 ** rng.uniform(0.7, 2, n),
    )
    return st.Scene(
        spheres, st.Lights(random_lights(rng, lights)), st.Camera(0.0, 0.0, 1200.0, 1200.0)
    )


def random_lights(rng: np.random.Generator, lights: int) -> np.ndarray:
    direction = rng.normal(size=(lights, 3))
    direction[:, 2] = np.abs(direction[:, 2])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return direction * 10 ** rng.uniform(np.log10(400), 4, (lights, 1))


def recovered(found: st.Fit, truth: st.Scene) -> bool:
    """Returns whether all determined parameters are recovered, up to the order of the lights."""
    a, b = found.scene, truth
    for product in PRODUCTS.values():
        spread = found.uncertainty.of(product)
        off = np.where(spread < KNOWN, np.abs(product(a) - product(b)), 0)
        if (off > np.maximum(1e-6, 2 * spread)).any():
            return False
    remaining = list(np.asarray(b.lights.position))
    for position in np.asarray(a.lights.position):
        apart = [np.linalg.norm(position - other) / np.linalg.norm(other) for other in remaining]
        if min(apart) > 1e-5:
            return False
        remaining.pop(int(np.argmin(apart)))
    return True


def recovery(count: int) -> None:
    """Fits `count` scenes each of 1, 2 and 3 lights, started from nothing."""
    print(f"{count} random scenes each, 2 to 20 spheres, 128x128, start='auto':")
    for lights in (1, 2, 3):
        rng = np.random.default_rng(lights)
        good, admitted, seconds = 0, 0, []
        for _ in range(count):
            # few numbers of spheres, as each number is compiled
            truth = random_scene(rng, int(rng.choice([2, 3, 5, 9, 14, 20])), lights)
            target = np.asarray(st.render(truth, width=128, height=128, bounces=0))
            s = truth.spheres
            grey = (jnp.full_like(s.color, 0.5), *(jnp.full_like(s.ka, x) for x in (0.3, 0.5, 0.2)))
            materials = lambda x: (x.spheres.color, x.spheres.ka, x.spheres.kd, x.spheres.ks)
            start = eqx.tree_at(materials, truth, grey)
            moved = jnp.asarray(random_lights(rng, lights), truth.dtype)
            start = eqx.tree_at(lambda x: x.lights.position, start, moved)
            began = time.perf_counter()
            found = st.fit(start, target, bounces=0, start="auto", max_steps=60)
            seconds.append(time.perf_counter() - began)
            if recovered(found, truth):
                good += 1
            elif not found.trust.ok:
                admitted += 1
        lost = count - good
        print(
            f"  {lights} light(s): {good} of {count} recovered, {admitted} of {lost} others said"
            f" so, median {statistics.median(seconds):.2f} s",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=67, help="random scenes per number of lights")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore", st.SceneWarning)
    time_and_error()
    outliers()
    if arguments.scenes:
        recovery(arguments.scenes)


if __name__ == "__main__":
    main()
