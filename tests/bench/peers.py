"""The programs that a user would otherwise pick, drawing our scenes: POV-Ray and Mitsuba 3."""

import itertools
import multiprocessing
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import spheretrace_jax as st
from spheretrace_jax.study.mitsuba import LIGHT, mitsuba as found_mitsuba, mitsuba_scene


def povray_seconds(scene: st.Scene, size: int, bounces: int) -> float:
    """POV-Ray's own trace time, on all cores; nan where it is missing."""
    if shutil.which("povray") is None:
        return float("nan")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "scene.pov")
        st.write_povray(file, scene, bounces=bounces)
        command = ["povray", f"+I{file}", f"+W{size}", f"+H{size}", "-A", "-D", "-F"]
        said = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    return float(re.search(r"Trace Time:.*\((\S+) seconds\)", said)[1])


def mitsuba() -> tuple[Any, Any] | None:
    """Mitsuba and Dr.Jit, None where they are missing."""
    try:
        return found_mitsuba()
    except ImportError as error:
        print(f"Mitsuba is left out: {error}")
        return None


class MitsubaApart:
    """Mitsuba in a process of its own.

    In one process its threads, which wait for work by spinning, slow the other program down: our
    picture took 15.8 ms beside it and 9.8 alone.
    """

    def __init__(self):
        """**Raises:** `ImportError` where Mitsuba is missing."""
        context = multiprocessing.get_context("spawn")
        self.process = ProcessPoolExecutor(max_workers=1, mp_context=context)
        self.process.submit(_there).result()
        self.numbers = itertools.count()

    def does(self, work: Callable, scene: st.Scene, size: int, *how: Any) -> Callable[[], float]:
        """Some work, which says its own seconds. **Arguments:** `how`: the work's further ones."""
        number = next(self.numbers)
        self.process.submit(_prepare, number, work, scene, size, *how).result()
        return lambda: self.process.submit(_seconds, number).result()


def _there() -> None:
    found_mitsuba()


_WORKS: dict[int, Callable[[], None]] = {}
"""What Mitsuba's process has prepared."""


def _prepare(number: int, work: Callable, scene: st.Scene, size: int, *how: Any) -> None:
    mi, dr = found_mitsuba()
    _WORKS[number] = work(mi, dr, scene, size, *how)


def _seconds(number: int) -> float:
    start = time.perf_counter()
    _WORKS[number]()
    return time.perf_counter() - start


def mitsuba_picture(
    mi: Any, dr: Any, scene: st.Scene, size: int, balls: str = "sphere"
) -> Callable[[], None]:
    """Draws a picture with one sample per pixel. **Arguments:** `balls`: as `mitsuba_scene`."""
    world = mitsuba_scene(mi, scene, size, balls)

    def draw() -> None:
        dr.eval(mi.render(world, spp=1, seed=0))
        dr.sync_thread()

    return draw


def mitsuba_gradient(
    mi: Any, dr: Any, scene: st.Scene, size: int, integrator: str, geometry: bool
) -> Callable[[], None]:
    """The gradient of the mean of (picture - 0.3)^2 by reflectances and the light's position.

    **Arguments:** `integrator`: `"direct"`, `"prb"`, or `"direct_projective"`, which sees edges.
    `geometry`: by the spheres' places, too.
    """
    world, by = mitsuba_scene(mi, scene, size), mi.load_dict({"type": integrator})
    parameters = mi.traverse(world)
    wanted = ("reflectance.value", *(("to_world",) if geometry else ()))
    names = [name for name in parameters.keys() if name.endswith(wanted)]
    # `prb` and `direct_projective` do not reach a point light's position
    names += [LIGHT] if integrator == "direct" else []

    def gradient() -> None:
        for name in names:
            dr.enable_grad(parameters[name])
        parameters.update()
        seen = mi.render(world, parameters, integrator=by, spp=1, seed=0)
        dr.backward(dr.mean(dr.square(seen - 0.3)))
        dr.eval([dr.grad(parameters[name]) for name in names])
        dr.sync_thread()

    return gradient
