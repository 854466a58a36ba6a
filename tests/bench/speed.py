"""Run times against peers in the same run, one table: `make bench`.

Times are medians of interleaved runs on all cores. The first call, with compilation, is a separate
column. The table leaves out a missing POV-Ray or Mitsuba (the extra `bench`, and LLVM's library).
"""

import argparse
import statistics
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from fit import nine_spheres
from peers import mitsuba, mitsuba_gradient, mitsuba_picture, povray_seconds
from rich.console import Console
from rich.table import Table

import spheretrace_jax as st
from spheretrace_jax.fit.problem.make_problem import make_problem
from spheretrace_jax.fit.problem.problem import normal_at
from spheretrace_jax.study.benchmarks.mitsuba import mitsuba_scene
from spheretrace_jax.xla.jit import compiler_options

SIZE, MANY_SIZE, RUNS, SECONDS = 1024, 512, 9, 6.0

Work = Callable[[], Any]
Row = tuple[str, Work, dict[str, Work], float | None]
"""The name of the work, our function, the peers' functions, the wanted ratio to the first."""

SHADING = {
    "color": lambda s: s.spheres.color,
    "ka": lambda s: s.spheres.ka,
    "kd": lambda s: s.spheres.kd,
    "ks": lambda s: s.spheres.ks,
    "exponent": lambda s: s.spheres.exponent,
    "light": lambda s: s.lights.position,
}
GEOMETRY = {"center": lambda s: s.spheres.center, "radius": lambda s: s.spheres.radius}


def shadowed_spheres() -> st.Scene:
    """Returns the lecture's scene with another light, which casts shadows."""
    lights = st.Lights(jnp.array([[100, 900, 300]], jnp.float32))
    return eqx.tree_at(lambda s: s.lights, nine_spheres("float32"), lights)


def random_spheres(count: int) -> st.Scene:
    """Makes a cloud of spheres that looks equally dense for any number of spheres."""
    rng = np.random.default_rng(0)
    size = 32 * (9 / count) ** (1 / 3)
    spheres = st.Spheres(
        rng.uniform(-150, 150, (count, 3)).astype("float32"),
        (size * rng.uniform(0.5, 1, count)).astype("float32"),
        rng.uniform(0.2, 0.9, (count, 3)).astype("float32"),
        ka=0.2,
        kd=rng.uniform(0.2, 0.8, count).astype("float32"),
    )
    light = np.array([[100, 500, 800]], "float32")
    angles = (np.float32(x) for x in (-0.01, 0.01, 500, 800))
    return st.Scene(spheres, st.Lights(light), st.Camera(*angles))


def gradient(scene: st.Scene, parameters: dict[str, Callable], size: int, **settings: Any) -> Work:
    """Returns a function: the gradient of mean (picture - 0.3)^2 by the listed parameters."""
    at = lambda s: [select(s) for select in parameters.values()]
    needs = st.needs(scene)

    @partial(jax.jit, compiler_options=compiler_options())
    def slope(scene: st.Scene, values: list) -> list:
        def loss(values: list) -> Any:
            moved = eqx.tree_at(at, scene, values)
            seen = st.render(moved, width=size, height=size, needs=needs, **settings)
            return jnp.mean((seen - 0.3) ** 2)

        return jax.grad(loss)(values)

    return lambda: slope(scene, at(scene))


def picture(scene: st.Scene, size: int, **settings: Any) -> Work:
    return partial(st.render, scene, width=size, height=size, needs=st.needs(scene), **settings)


def normal_equations(scene: st.Scene, size: int) -> Work:
    """Returns a function: the normal equations of a fit of colours, ka, kd, ks and the light."""
    start = eqx.tree_at(lambda s: s.lights.position, scene, scene.lights.position + 1)
    target = np.asarray(st.render(scene, width=size, height=size, bounces=0))
    free = ("color", "ka", "kd", "ks", "light_position")
    problem = make_problem(start, target, free, bounces=0)
    values = problem.start()
    return lambda: normal_at(problem, values)


def rows(many: list[int]) -> Iterator[Row]:
    scene, peer = shadowed_spheres(), mitsuba()
    pov = lambda scene, size, bounces: {"POV-Ray": partial(povray_seconds, scene, size, bounces)}
    matt = eqx.tree_at(lambda s: (s.spheres.ks, s.spheres.kgr), scene, replace_fn=jnp.zeros_like)

    def mitsuba_does(name: str, do: Callable, *how: Any) -> dict[str, Work]:
        """Returns Mitsuba's work on matt spheres, nothing without Mitsuba."""
        return {} if peer is None else {name: do(*peer, mitsuba_scene(peer[0], matt, SIZE), *how)}

    draw = picture(scene, SIZE, bounces=0)
    peers = mitsuba_does("Mitsuba", mitsuba_picture) | pov(scene, SIZE, 0)
    yield "picture", draw, peers, 0.45
    by = lambda name, geometry: mitsuba_does(f"Mitsuba {name}", mitsuba_gradient, name, geometry)
    peers = by("direct", False) | by("prb", False)
    yield "gradient, shading", gradient(scene, SHADING, SIZE, bounces=0), peers, 0.4
    peers = by("direct_projective", True)
    edges = gradient(scene.with_antialias(1), SHADING | GEOMETRY, SIZE, bounces=0)
    yield "gradient, geometry too, edges", edges, peers, 0.2
    yield "normal equations", normal_equations(scene, SIZE), {"our picture": draw}, 2.0
    mirrors = picture(scene, SIZE, bounces=3)
    yield "picture, 3 bounces", mirrors, pov(scene, SIZE, 3), 0.2
    deep = gradient(scene, SHADING, SIZE, bounces=3)
    yield "gradient, 3 bounces", deep, {"our picture": mirrors}, 5.0
    one = st.Spheres(np.zeros((1, 3), "float32"), np.float32([150]), np.float32([[0.9, 0.1, 0]]))
    one = eqx.tree_at(lambda s: s.spheres, scene, one)
    full = partial(st.render, one, width=SIZE, height=SIZE, needs=st.Needs(), bounces=3)
    yield "one matt sphere", picture(one, SIZE), {"all features": full}, 1 / 3
    for count in many:
        cloud = random_spheres(count)
        peers = pov(cloud, MANY_SIZE, 0) if count <= 100_000 else {}
        if peer is not None:
            theirs = mitsuba_scene(peer[0], cloud, MANY_SIZE, "ellipsoids")
            peers = {"Mitsuba ellipsoids": mitsuba_picture(*peer, theirs)} | peers
        bound = 1.2 if count <= 10_000 else 3.0 if count <= 100_000 else None
        yield f"{count:,} spheres, {MANY_SIZE}x{MANY_SIZE}", picture(cloud, MANY_SIZE), peers, bound


def timed(work: Work) -> float:
    """Returns the seconds of one run, or the seconds that the work reports."""
    start = time.perf_counter()
    result = jax.block_until_ready(work())
    return result if isinstance(result, float) else time.perf_counter() - start


def settled(work: Work) -> float:
    """Returns the seconds of a run within a row of equal runs.

    After another program has run, the system may keep both threads on one core for a few runs: the
    picture then takes 14 ms, not 8.
    """
    runs, began = [], time.perf_counter()
    while len(runs) < 3 or time.perf_counter() - began < 0.2:
        runs.append(timed(work))
    return statistics.median(runs[len(runs) // 2 :])


def measured(work: Work, peers: dict[str, Work]) -> tuple[float, list[float]]:
    """Returns our first call and the medians, ours first."""
    first = timed(work)
    everything = [work, *peers.values()]
    for peer in peers.values():
        timed(peer), timed(peer)
    runs, began = [], time.perf_counter()
    while len(runs) < 3 or (len(runs) < RUNS and time.perf_counter() - began < SECONDS):
        runs.append([settled(one) for one in everything])
    return first, [statistics.median(column) for column in zip(*runs, strict=True)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--many", type=int, nargs="*", default=[10_000, 100_000, 1_000_000])
    parser.add_argument("--only", default="", help="rows whose names contain this")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", st.SceneWarning)
    table = Table("work", "first call", "ours", "peer", "peer's", "ratio", "wanted")
    for name, work, peers, bound in rows(arguments.many):
        if arguments.only not in name:
            continue
        first, (ours, *others) = measured(work, peers)
        lines = list(zip(peers, others, strict=True)) or [("", float("nan"))]
        for k, (peer, seconds) in enumerate(lines):
            known = seconds == seconds
            table.add_row(
                *((name, f"{first:.2f} s", f"{1e3 * ours:.1f} ms") if k == 0 else ("", "", "")),
                peer,
                f"{1e3 * seconds:.1f} ms" if known else "missing",
                f"{ours / seconds:.3f}" if known else "",
                f"<= {bound:.2f}" if k == 0 and bound else "",
            )
        print(f"{name}: {1e3 * ours:.1f} ms", flush=True)
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
