"""Mitsuba scenes: XML for Mitsuba 3, as far as its models are ours.

The same are: the camera, spheres, Lambert's term, directional lights and lights with a fall-off,
shadows, mirrors and bubbles of one generation. Mitsuba has neither ambient light nor Phong's or
Blinn's highlights nor lights that stay as bright at any distance. What is not exact is said in
warnings and in comments `not exact: ...` at the top of the XML. This command draws the picture:

    mitsuba -m scalar_rgb -D spp=64 scene.xml
"""

import os
import warnings
from collections.abc import Iterator
from math import pi
from pathlib import Path

import numpy as np

from ..base.errors import SceneError, SceneWarning
from ..base.types import Highlight
from ..scene.camera import view_frame
from ..scene.scene import Scene, known_scene
from ..scene.settings import check_highlight
from .atomic import write_text

_PLANE_SIZE = 50.0  # half the side of a plane's square, in sizes of the scene


def write_mitsuba(
    path: str | os.PathLike[str],
    scene: Scene,
    *,
    highlight: Highlight = "phong",
    bounces: int = 5,
    scene_path: str | os.PathLike[str] | None = None,
) -> None:
    """Writes a scene for Mitsuba 3 atomically; see `mitsuba_text`.

    **Arguments:** `highlight`, `bounces`: as for `render`. `scene_path`: the file of the scene,
    which warnings then name.

    **Raises:** as `mitsuba_text`; `OSError` if the file cannot be written.

    **Warns:** `SceneWarning` for all that Mitsuba's picture will not have, or have otherwise.
    """
    text, inexact = mitsuba_text(scene, highlight=highlight, bounces=bounces)
    write_text(path, text)
    name = os.fspath(path) if scene_path is None else Path(scene_path).name
    for message in inexact:
        warnings.warn(f"{name}: {message}", SceneWarning, stacklevel=2)


def mitsuba_text(
    scene: Scene, *, highlight: Highlight = "phong", bounces: int = 5
) -> tuple[str, list[str]]:
    """Returns a scene in Mitsuba 3's XML, and what is not exact in it.

    **Arguments:** as `write_mitsuba`.

    **Raises:** `SceneError` for pixels that are not square, and for reflectances that add up to
    more than 1, both of which Mitsuba refuses. `InputError` as `povray_text`.
    """
    check_highlight(highlight)
    scene = known_scene(scene)
    if scene.camera.pixel_aspect is not None and float(scene.camera.pixel_aspect) != 1:
        raise SceneError("Mitsuba has square pixels only, and the camera has a pixel_aspect")
    inexact = [*_inexact(scene)]
    integrator = '<integrator type="direct"> <integer name="emitter_samples" value="1"/>'
    integrator += ' <integer name="bsdf_samples" value="0"/> </integrator>'
    if _recursive(scene):
        depth = f'<integer name="max_depth" value="{bounces + 2}"/>'
        integrator = f'<integrator type="path"> {depth} </integrator>'
    lines = [
        '<scene version="3.0.0">',
        *(f"<!-- not exact: {message} -->" for message in inexact),
        '<default name="width" value="512"/>',
        '<default name="height" value="512"/>',
        '<default name="spp" value="64"/>',
        integrator,
        *_camera(scene),
        *_lights(scene),
        *_spheres(scene),
        *_planes(scene),
        "</scene>",
    ]
    return "\n".join(lines) + "\n", inexact


def _recursive(scene: Scene) -> bool:
    """Tells whether rays go on behind their first hit."""
    coefficients = (scene.spheres.kgr, scene.spheres.kt, scene.planes.kgr)
    return any(bool(np.any(np.asarray(x) > 0)) for x in coefficients)


def _inexact(scene: Scene) -> Iterator[str]:
    """Yields what Mitsuba has not, with the numbers of its objects, from 1."""
    s, p, lights = scene.spheres, scene.planes, scene.lights
    for kind, table in (("sphere", s), ("plane", p)):
        for values, what in (
            (table.ka, "ambient light: left out"),
            (table.ks, "highlights: left out, Mitsuba 3 has neither Phong's nor Blinn's"),
            (np.asarray(table.ior) - 1, "coats (ior): left out, diffuse light is Lambert's"),
        ):
            if (chosen := np.flatnonzero(np.asarray(values) > 0)).size:
                yield f"{_numbers(kind, chosen)}: {what}"
    if (worn := np.flatnonzero(s.pic)).size:
        yield f"{_numbers('sphere', worn)}: textures: left out, the sphere has its colour"
    even = [not far and not r for far, r in zip(lights.directional, lights.falloff, strict=True)]
    if any(even):
        yield (
            f"{_numbers('light', np.flatnonzero(even))}: the inverse-square law in place of no "
            "fall-off, as bright in the middle of the spheres"
        )
    if scene.sky is not None or np.any(np.asarray(scene.background) != 0):
        yield "background: left out, Mitsuba's would light the scene"
    if len(p) or scene.back_plane is not None:
        yield f"planes: squares with sides of {2 * _plane_size(scene):g}"
    if _recursive(scene):
        yield "mirrors and bubbles: Mitsuba's path tracer adds light from object to object"
    if scene.camera.orthographic or scene.camera.principal_point is not None:
        yield "camera: that of a square picture"


def _numbers(kind: str, chosen: np.ndarray) -> str:
    """Returns the numbers of objects in words, from 1."""
    numbers = [str(i + 1) for i in chosen[:5]]
    more = f" and {len(chosen) - 5} more" if len(chosen) > 5 else ""
    return f"{kind}{'s' if len(chosen) > 1 else ''} {', '.join(numbers)}{more}"


def _row(values: np.ndarray) -> str:
    return ", ".join(f"{x:.9g}" for x in np.ravel(values))


def _rgb(name: str, color: np.ndarray) -> str:
    return f'<rgb name="{name}" value="{_row(color)}"/>'


def _float(name: str, value: float) -> str:
    return f'<float name="{name}" value="{value:.9g}"/>'


def _point(name: str, value: np.ndarray) -> str:
    x, y, z = value
    return f'<point name="{name}" x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>'


def _middle(scene: Scene) -> np.ndarray:
    """Returns the mean of the spheres' centres, 0 without spheres."""
    center = np.asarray(scene.spheres.center, np.float64)
    return center.mean(axis=0) if len(center) else np.zeros(3)


def _extent(scene: Scene) -> float:
    """Returns the distance from the middle within which eye, spheres and planes' points lie."""
    s, middle = scene.spheres, _middle(scene)
    eye, *_ = _axes(scene)
    far = np.linalg.norm(np.asarray(s.center, np.float64) - middle, axis=1) + np.asarray(s.radius)
    points = np.linalg.norm(np.asarray(scene.planes.point, np.float64) - middle, axis=1)
    return float(max([np.linalg.norm(eye - middle), *far, *points]))


def _plane_size(scene: Scene) -> float:
    return _PLANE_SIZE * _extent(scene)


def _axes(scene: Scene) -> tuple[np.ndarray, ...]:
    """Returns the eye, right, up and forward."""
    frame = view_frame(scene.camera)
    axes = (frame.eye, frame.right, frame.up, frame.forward)
    return tuple(np.array([v.x, v.y, v.z], np.float64).reshape(3) for v in axes)


def _camera(scene: Scene) -> list[str]:
    """Returns the sensor and its film of one box per pixel."""
    camera = scene.camera
    eye, right, up, forward = _axes(scene)
    window, distance = float(camera.window), float(camera.distance)
    offset, lines = np.zeros(2), []
    if camera.principal_point is not None:
        offset = np.asarray(camera.principal_point, np.float64)
    if camera.orthographic:
        eye = eye + window * (offset[1] * up - offset[0] * right)
        scale = f'<scale x="{window / 2:.9g}" y="{window / 2:.9g}"/> '
    else:
        scale = ""
        lines = ['<string name="fov_axis" value="y"/>']
        lines.append(_float("fov", float(np.degrees(2 * np.arctan(window / 2 / distance)))))
        for axis, part in zip("xy", offset, strict=True):
            lines.append(_float(f"principal_point_offset_{axis}", -part))
    place = f'origin="{_row(eye)}" target="{_row(eye + forward)}" up="{_row(up)}"'
    extent = _extent(scene)
    return [
        f'<sensor type="{"orthographic" if camera.orthographic else "perspective"}">',
        *lines,
        _float("near_clip", 1e-5 * extent),
        _float("far_clip", 4 * _PLANE_SIZE * extent),
        f'<transform name="to_world"> {scale}<lookat {place}/> </transform>',
        '<sampler type="independent"> <integer name="sample_count" value="$spp"/> </sampler>',
        '<film type="hdrfilm"> <integer name="width" value="$width"/>'
        ' <integer name="height" value="$height"/> <rfilter type="box"/> </film>',
        "</sensor>",
    ]


def _lights(scene: Scene) -> list[str]:
    """Returns the lights; pi takes back the 1/pi of Lambert's reflectance."""
    lights, lines, middle = scene.lights, [], _middle(scene)
    columns = (lights.position, lights.color, lights.falloff)
    rows = zip(*(np.asarray(x, np.float64) for x in columns), lights.directional, strict=True)
    for position, color, falloff, directional in rows:
        if directional:
            x, y, z = -position / np.linalg.norm(position)
            way = f'<vector name="direction" x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>'
            power = _rgb("irradiance", pi * color)
            lines.append(f'<emitter type="directional"> {way} {power} </emitter>')
            continue
        reach = falloff or np.linalg.norm(position - middle)
        power = _rgb("intensity", pi * reach**2 * color)
        place = _point("position", position)
        lines.append(f'<emitter type="point"> {place} {power} </emitter>')
    if np.any(np.asarray(scene.spheres.kt) > 0):
        # without surroundings Mitsuba's `path` drops all light of rays that end behind a mask
        lines.append(f'<emitter type="constant"> {_rgb("radiance", np.zeros(3))} </emitter>')
    return lines


def _reflector(
    what: str, reflectance: str, brightest: float, mirror: float, opacity: float = 1.0
) -> str:
    """Returns the material of diffuse light and a mirror, seen through by a part.

    Mitsuba blends: a part `mirror` of the rays meets the mirror, the others the diffuse surface,
    whose reflectance is divided by what is left.

    **Raises:** `SceneError` where what is reflected would be more than what meets the surface.
    """
    if brightest + mirror > opacity * (1 + 1e-6):
        raise SceneError(
            f"{what} reflects and transmits more than the light that it meets, which Mitsuba "
            "refuses: kd times its brightest colour, kgr and sqrt(kt) must add up to at most 1"
        )
    bsdf = f'<bsdf type="diffuse"> {reflectance} </bsdf>'
    if mirror:
        white = _rgb("specular_reflectance", np.ones(3))
        perfect = f'<string name="material" value="none"/> {white}'
        bsdf = f'<bsdf type="blendbsdf"> {_float("weight", mirror / opacity)} {bsdf}' + (
            f' <bsdf type="conductor"> {perfect} </bsdf> </bsdf>'
        )
    if opacity < 1:
        bsdf = f'<bsdf type="mask"> {_float("opacity", opacity)} {bsdf} </bsdf>'
    return bsdf


def _spheres(scene: Scene) -> Iterator[str]:
    """Yields the spheres. A ray meets both walls of a bubble, each of which lets sqrt(kt) pass."""
    s = scene.spheres
    columns = (s.center, s.radius, s.color, s.kd, s.kgr, s.kt)
    rows = zip(*(np.asarray(x, np.float64) for x in columns), strict=True)
    for i, (center, radius, color, kd, kgr, kt) in enumerate(rows):
        opacity = 1 - kt**0.5
        rest = max(opacity - kgr, 1e-9)
        diffuse = _rgb("reflectance", np.minimum(kd * color / rest, 1))
        bsdf = _reflector(f"sphere {i + 1}", diffuse, float(kd * color.max()), kgr, opacity)
        place = f"{_point('center', center)} {_float('radius', radius)}"
        yield f'<shape type="sphere"> {place} {bsdf} </shape>'


def _planes(scene: Scene) -> Iterator[str]:
    """Yields the planes as large squares, and the back plane."""
    p, half = scene.planes, _plane_size(scene)
    columns = (p.point, p.normal, p.color, p.kd, p.kgr, p.checker_color, p.checker_size)
    rows = [tuple(np.asarray(x, np.float64) for x in row) for row in zip(*columns, strict=True)]
    if (back := scene.back_plane) is not None:
        eye, _, _, forward = _axes(scene)
        zero = np.zeros(())
        place = eye + forward * float(scene.camera.distance)
        row = (place, -forward, back.color, back.kd, zero, np.zeros(3), zero)
        rows.append(tuple(np.asarray(x, np.float64) for x in row))
    for i, (point, normal, color, kd, kgr, other, size) in enumerate(rows):
        normal = normal / np.linalg.norm(normal)
        x, y, z = np.abs(normal)
        axis = np.array([0.0, 1, 0] if x > y and x > z else [1.0, 0, 0])
        along = axis - normal * (axis @ normal)
        along /= np.linalg.norm(along)
        # a whole number of pairs of squares on each side of the point
        side = half if not size else max(np.round(half / size / 2), 1) * 2 * size
        rest = max(1 - kgr, 1e-9)
        diffuse, brightest = _rgb("reflectance", np.minimum(kd * color / rest, 1)), kd * color.max()
        if size:
            colors = [
                _rgb(f"color{k}", np.minimum(kd * c / rest, 1)) for k, c in ((0, color), (1, other))
            ]
            scale = f'<transform name="to_uv"> <scale value="{side / size:.9g}"/> </transform>'
            content = f"{' '.join(colors)} {scale}"
            diffuse = f'<texture name="reflectance" type="checkerboard"> {content} </texture>'
            brightest = max(brightest, kd * other.max())
        bsdf = _reflector(f"plane {i + 1}", diffuse, float(brightest), float(kgr))
        matrix = np.stack([along * side, np.cross(normal, along) * side, normal, point], axis=1)
        rows_of = " ".join(_row(r).replace(",", "") for r in (*matrix, np.array([0, 0, 0, 1])))
        place = f'<transform name="to_world"> <matrix value="{rows_of}"/> </transform>'
        yield f'<shape type="rectangle"> {place} <bsdf type="twosided"> {bsdf} </bsdf> </shape>'
