"""Mitsuba: fits of matt spheres by Mitsuba 3 with Adam, if installed."""

import time
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...base.errors import InputError
from ...scene.camera import view_frame
from ...scene.lights import Lights
from ...scene.scene import Scene

LIGHT = "light.position"

#: Seconds and values after each step: the light's position, then reflectances, row by row.
Curve = list[tuple[float, Float[np.ndarray, "rows 3"]]]


class Recipe(NamedTuple):
    """Parameters of Adam. The rates are the best of several trials with the nine spheres."""

    color_rate: float
    light_rate: float  #: per distance of the light at the start
    beta_2: float
    halved: float  #: iterations in which the rates halve
    steady: bool  #: intensity pi |position|^2: no fall-off, as in our model


RECIPES = {
    "Mitsuba + Adam": Recipe(0.02, 0.014, 0.999, np.inf, False),  # as in Mitsuba's tutorials
    "Mitsuba + Adam, tuned": Recipe(0.02, 0.028, 0.9, 150, True),
}


def mitsuba() -> tuple[Any, Any]:
    """Imports Mitsuba and Dr.Jit, for CPUs.

    **Raises:** `ImportError` where Mitsuba, Dr.Jit or LLVM is missing.
    """
    try:
        import drjit  # pyright: ignore[reportMissingImports]
        import mitsuba  # pyright: ignore[reportMissingImports]

        mitsuba.set_variant("llvm_ad_rgb")
        drjit.eval(drjit.llvm.Float(1) + 1)
    except Exception as error:  # of many types, depending on the missing library
        raise ImportError(str(error).splitlines()[0]) from error
    return mitsuba, drjit


def matt(scene: Scene) -> Scene:
    """Removes ambient light, highlights, reflections, coats, and all lights but the first."""
    shine = lambda s: (s.spheres.ka, s.spheres.ks, s.spheres.kgr, s.spheres.kt)
    scene = eqx.tree_at(shine, scene.with_antialias(0), replace_fn=jnp.zeros_like)
    scene = eqx.tree_at(lambda s: s.spheres.ior, scene, replace_fn=jnp.ones_like)
    lights = scene.lights
    first = Lights(
        lights.position[:1], lights.color[:1], lights.directional[:1], lights.falloff[:1]
    )
    return eqx.tree_at(lambda s: s.lights, scene, first)


def fitted(scene: Scene) -> Float[np.ndarray, "rows 3"]:
    """Returns the light's position, then the reflectances kd*color, row by row."""
    s = scene.spheres
    return np.concatenate([scene.lights.position, s.kd[:, None] * s.color])


def mitsuba_scene(mi: Any, scene: Scene, size: int, shape: str = "sphere") -> Any:
    """Builds the scene for Mitsuba with diffuse spheres of reflectance kd*color.

    Its picture is as bright as ours at the world's origin: the light's intensity compensates 1/r^2
    and Lambert's 1/pi.

    **Arguments:** `shape`: `"sphere"` for one shape each; `"ellipsoids"` for all spheres in one
    shape, of one colour.

    **Raises:** `InputError` for cameras that are orthographic, or whose pixels have an aspect.
    """
    frame, light = view_frame(scene.camera), np.asarray(scene.lights.position[0], float)
    eye, up, forward = (np.array([v.x, v.y, v.z]) for v in (frame.eye, frame.up, frame.forward))
    rgb = lambda color: {"type": "rgb", "value": list(map(float, color))}
    intensity = rgb([np.pi * light @ light] * 3)
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    camera = scene.camera
    if camera.orthographic or camera.pixel_aspect is not None:
        raise InputError("mitsuba_scene takes perspective cameras with square pixels only")
    fov = float(np.degrees(2 * np.arctan(scene.camera.window / 2 / scene.camera.distance)))
    view = mi.ScalarTransform4f().look_at(origin=eye, target=eye + forward, up=up)
    middle = (0.0, 0.0) if camera.principal_point is None else np.asarray(camera.principal_point)
    entries = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": fov,
            "principal_point_offset_x": -float(middle[0]),
            "principal_point_offset_y": -float(middle[1]),
            "to_world": view,
            "film": film,
        },
        "light": {"type": "point", "position": light.tolist(), "intensity": intensity},
        # surface samples never meet a point light; `prb` takes twice the time, and does not move it
        "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
    }
    s = scene.spheres
    center, radius, color = (np.asarray(x) for x in (s.center, s.radius, s.kd[:, None] * s.color))
    if shape == "ellipsoids":
        entries["balls"] = {
            "type": "ellipsoids",
            "centers": mi.TensorXf(center),
            "scales": mi.TensorXf(np.repeat(radius[:, None], 3, axis=1)),
            "quaternions": mi.TensorXf(np.tile([0.0, 0, 0, 1], (len(radius), 1))),
            "bounding_sphere": 1.0,
        }
        return mi.load_dict(entries)
    for i in range(len(radius)):
        entries[f"ball{i}"] = {
            "type": "sphere",
            "center": center[i].tolist(),
            "radius": float(radius[i]),
            "bsdf": {"type": "diffuse", "reflectance": rgb(color[i])},
        }
    return mi.load_dict(entries)


def adam_fit(start: Scene, truth: Scene, size: int, recipe: Recipe, seconds: float) -> Curve:
    """Fits a matt scene with one light to Mitsuba's own picture of the truth, by Adam.

    Pictures have one sample per pixel, always that of the target: without noise, the error is
    least.

    **Arguments:** `seconds`: the time limit. **Returns:** the curve of the fit.

    **Raises:** `ImportError` where Mitsuba is missing.
    """
    mi, dr = mitsuba()
    scene, values = mitsuba_scene(mi, truth, size), fitted(start)
    target, parameters = mi.render(scene, spp=1, seed=0), mi.traverse(scene)
    names = [LIGHT, *(f"ball{i}.bsdf.reflectance.value" for i in range(len(values) - 1))]
    adam = mi.ad.Adam(lr=recipe.color_rate, beta_2=recipe.beta_2)
    for name, value in zip(names, values.tolist(), strict=True):
        adam[name] = type(parameters[name])(value)
    light_rate = recipe.light_rate * float(np.linalg.norm(values[0]))
    curve, began = [(0.0, values)], time.perf_counter()
    while len(curve) <= 3 or curve[-1][0] < seconds:  # the first three are compiled one by one
        left = 0.5 ** ((len(curve) - 1) / recipe.halved)
        colors = dict.fromkeys(names[1:], left * recipe.color_rate)
        adam.set_learning_rate(colors | {LIGHT: left * light_rate})
        if recipe.steady:
            parameters["light.intensity.value"] = mi.Color3f(np.pi * dr.squared_norm(adam[LIGHT]))
        parameters.update(adam)
        dr.backward(dr.mean(dr.square(mi.render(scene, parameters, spp=1, seed=0) - target)))
        adam.step()
        for name in names[1:]:  # to 0..1; dr.clip ends the program under LLVM 14 and 15
            adam[name] = dr.select(adam[name] < 0, 0, dr.select(adam[name] > 1, 1, adam[name]))
        dr.eval(*(adam[name] for name in names))
        values = np.stack([np.asarray(adam[name]).ravel() for name in names])
        curve.append((time.perf_counter() - began, values))
    return curve
