"""The programs that a user would otherwise pick, drawing our scenes: POV-Ray and Mitsuba 3."""

import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import spheretrace_jax as st
from spheretrace_jax.camera import view_frame

LIGHT = "light.position"


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
    """Mitsuba and Dr.Jit for CPUs, None where they or LLVM are missing."""
    try:
        import drjit
        import mitsuba

        mitsuba.set_variant("llvm_ad_rgb")
        drjit.eval(drjit.llvm.Float(1) + 1)
    except Exception as error:  # what is missing is said in many ways
        print(f"Mitsuba is left out: {error}".splitlines()[0])
        return None
    return mitsuba, drjit


def mitsuba_scene(mi: Any, scene: st.Scene, size: int, balls: str = "sphere") -> Any:
    """The same with diffuse spheres: kd*color is their reflectance.

    As bright as ours in the world's middle: the light makes up for 1/r^2 and Lambert's 1/pi.

    **Arguments:** `balls`: `"sphere"`: each is a shape of its own; `"ellipsoids"`: all are one
    shape, of one colour.
    """
    frame, light = view_frame(scene.camera), np.asarray(scene.lights.position[0], float)
    eye, up, forward = (np.array([v.x, v.y, v.z]) for v in (frame.eye, frame.up, frame.forward))
    rgb = lambda color: {"type": "rgb", "value": list(map(float, color))}
    intensity = rgb([np.pi * light @ light] * 3)
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    fov = float(np.degrees(2 * np.arctan(scene.camera.window / 2 / scene.camera.distance)))
    view = mi.ScalarTransform4f().look_at(origin=eye, target=eye + forward, up=up)
    world = {
        "type": "scene",
        "sensor": {"type": "perspective", "fov": fov, "to_world": view, "film": film},
        "light": {"type": "point", "position": light.tolist(), "intensity": intensity},
        # samples of surfaces never meet the light; `prb` takes twice the time, and the light stays
        "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
    }
    s = scene.spheres
    center, radius, color = (np.asarray(x) for x in (s.center, s.radius, s.kd[:, None] * s.color))
    if balls == "ellipsoids":
        world["balls"] = {
            "type": "ellipsoids",
            "centers": mi.TensorXf(center),
            "scales": mi.TensorXf(np.repeat(radius[:, None], 3, axis=1)),
            "quaternions": mi.TensorXf(np.tile([0.0, 0, 0, 1], (len(radius), 1))),
            "extent": 1.0,
        }
        return mi.load_dict(world)
    for i in range(len(radius)):
        world[f"ball{i}"] = {
            "type": "sphere",
            "center": center[i].tolist(),
            "radius": float(radius[i]),
            "bsdf": {"type": "diffuse", "reflectance": rgb(color[i])},
        }
    return mi.load_dict(world)


def mitsuba_picture(mi: Any, dr: Any, world: Any) -> Callable[[], None]:
    """Draws a picture with one sample per pixel."""

    def draw() -> None:
        dr.eval(mi.render(world, spp=1, seed=0))
        dr.sync_thread()

    return draw


def mitsuba_gradient(
    mi: Any, dr: Any, world: Any, integrator: str, geometry: bool
) -> Callable[[], None]:
    """The gradient of the mean of (picture - 0.3)^2 by reflectances and the light's position.

    **Arguments:** `integrator`: `"direct"`, `"prb"`, or `"direct_projective"`, which sees edges.
    `geometry`: by the spheres' places, too.
    """
    by = mi.load_dict({"type": integrator})
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
