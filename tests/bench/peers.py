"""Peers, other renderers that draw our scenes: POV-Ray and Mitsuba 3."""

import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import spheretrace_jax as st
from spheretrace_jax.study.benchmarks.mitsuba import LIGHT, mitsuba as found_mitsuba


def povray_seconds(scene: st.Scene, size: int, bounces: int) -> float:
    """Returns the trace time that POV-Ray reports, on all cores, nan without POV-Ray."""
    if shutil.which("povray") is None:
        return float("nan")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "scene.pov")
        st.write_povray(file, scene, bounces=bounces)
        command = ["povray", f"+I{file}", f"+W{size}", f"+H{size}", "-A", "-D", "-F"]
        printed = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    return float(re.search(r"Trace Time:.*\((\S+) seconds\)", printed)[1])


def mitsuba() -> tuple[Any, Any] | None:
    """Imports Mitsuba and Dr.Jit; returns None if they are missing."""
    try:
        return found_mitsuba()
    except ImportError as error:
        print(f"Mitsuba is left out: {error}")
        return None


def mitsuba_picture(mi: Any, dr: Any, scene: Any) -> Callable[[], None]:
    """Returns a function that draws a picture with one sample per pixel."""

    def draw() -> None:
        dr.eval(mi.render(scene, spp=1, seed=0))
        dr.sync_thread()

    return draw


def mitsuba_gradient(
    mi: Any, dr: Any, scene: Any, integrator: str, geometry: bool
) -> Callable[[], None]:
    """Returns a function: the gradient of mean (picture - 0.3)^2 by reflectances and the light.

    **Arguments:** `integrator`: `"direct"`, `"prb"`, or `"direct_projective"`, which sees edges.
    `geometry`: by the spheres' transformations, too.
    """
    by = mi.load_dict({"type": integrator})
    parameters = mi.traverse(scene)
    wanted = ("reflectance.value", *(("to_world",) if geometry else ()))
    names = [name for name in parameters.keys() if name.endswith(wanted)]
    # `prb` and `direct_projective` do not reach a point light's position
    names += [LIGHT] if integrator == "direct" else []

    def gradient() -> None:
        for name in names:
            dr.enable_grad(parameters[name])
        parameters.update()
        seen = mi.render(scene, parameters, integrator=by, spp=1, seed=0)
        dr.backward(dr.mean(dr.square(seen - 0.3)))
        dr.eval([dr.grad(parameters[name]) for name in names])
        dr.sync_thread()

    return gradient
