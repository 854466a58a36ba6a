"""POV-Ray scenes: text for POV-Ray 3.7, which then draws the same picture.

The lecture's shading is POV-Ray's classic one, so nearly every term has a keyword in POV-Ray. The
substitutes for the other terms are explained here and in the .pov text. Inexact features are listed
at the top of that text, in lines `// not exact: ...`. This command draws a linear picture:

    povray scene.pov +W512 +H512 -A -D +FN16 File_Gamma=1.0 +Oscene.png

POV-Ray's vectors have no handedness: only the camera's axes count, so world coordinates need no
conversion.
"""

import os
from pathlib import Path

import numpy as np

from ..base.errors import InputError
from ..base.types import Highlight
from ..base.vec import Vec
from ..scene.camera import Camera, view_frame
from ..scene.planes import Planes
from ..scene.scene import Scene, known_scene
from ..scene.settings import check_highlight
from ..scene.spheres import Spheres
from ..scene.texture import Texture
from ..tracing.tables import SceneTables, build_tables
from .atomic import write_text
from .povray_image import declared_image
from .povray_lights import FARTHEST, light_sources
from .povray_words import Number, number, table_rows, vector

# Least opacity 1 - kt that is written. POV-Ray multiplies ambient and diffuse light by the
# opacity, and `_spheres` divides by it, so it must not be 0. A power of 2: colours are in float32.
_LEAST_OPACITY = 2.0**-14
_NEAREST = 1e-3  # POV-Ray's SHADOW_TOLERANCE

_WRAPPED = """
// A bitmap around a sphere at the origin, times a colour. POV-Ray would blend the picture's first
// and last row at the poles, so points within half a row of a pole look up the middle of that row.
// 3: an average of three pigments divides by 3. Peak: a pigment's pattern must not exceed 1.
#declare Clamped = function(x, y, z, Steepest) {
  max(-Steepest * sqrt(x*x + y*y), min(Steepest * sqrt(x*x + y*y), z))
}
#macro Wrapped(Image, Steepest, Peak, Red, Green, Blue, Through)
  average pigment_map {
    [1 function { Image(x, Clamped(x, y, z, Steepest), y).red / Peak }
       color_map { [0 rgbt <0, 0, 0, Through>] [1 rgbt <3 * Peak * Red, 0, 0, Through>] }]
    [1 function { Image(x, Clamped(x, y, z, Steepest), y).green / Peak }
       color_map { [0 rgbt <0, 0, 0, Through>] [1 rgbt <0, 3 * Peak * Green, 0, Through>] }]
    [1 function { Image(x, Clamped(x, y, z, Steepest), y).blue / Peak }
       color_map { [0 rgbt <0, 0, 0, Through>] [1 rgbt <0, 0, 3 * Peak * Blue, Through>] }]
  }
#end
"""


def write_povray(
    path: str | os.PathLike[str],
    scene: Scene,
    *,
    highlight: Highlight = "phong",
    bounces: int = 5,
    scene_path: str | os.PathLike[str] | None = None,
) -> None:
    """Writes a scene for POV-Ray 3.7 atomically; see `povray_text`.

    **Arguments:** `scene_path`: the file of the scene, whose name (without its folder) stands in
    the first line.

    **Raises:** as `povray_text`; `OSError` if the file cannot be written.
    """
    text = povray_text(scene, highlight=highlight, bounces=bounces)
    if scene_path is not None:
        text = f"// made from {Path(scene_path).name}\n{text}"
    write_text(path, text)


def povray_text(scene: Scene, *, highlight: Highlight = "phong", bounces: int = 5) -> str:
    """Returns a scene in POV-Ray 3.7's language, for pictures of any size.

    Textures keep the names of the scene. From `load_scene` these are absolute paths, as POV-Ray
    looks up relative paths in its working directory.

    **Arguments:** `highlight`, `bounces`: as for `render`.

    **Raises:** `SceneError` for textures that are in no file, or in a format that POV-Ray does not
    read, and for numbers that are not finite. `InputError` for an unknown highlight, bounces out of
    range, and scenes whose arrays do not fit.
    """
    check_highlight(highlight)
    if not 0 <= bounces < 256:
        raise InputError(f"bounces must be in 0..255 for POV-Ray, got {bounces}")
    scene = known_scene(scene)
    eye = _points(view_frame(scene.camera).eye)
    lines = [
        *(f"// not exact: {feature}" for feature in _inexact(scene, eye, bounces)),
        *_settings(scene, bounces),
        *_camera(scene.camera),
        *_background(scene),
    ]
    lines += light_sources(scene)
    for k in sorted(set(scene.spheres.pic) - {0}):
        lines.append(declared_image(f"Image{k}", scene.textures[k - 1]))
    lines += _spheres(scene, eye, highlight)
    lines += _planes(scene.planes, highlight)
    lines += _back_plane(scene)
    return "\n".join(lines) + "\n"


def _points(v: Vec) -> np.ndarray:
    """Returns a `Vec` as one array of NumPy, with the last axis x, y, z."""
    return np.stack([np.asarray(v.x), np.asarray(v.y), np.asarray(v.z)], axis=-1)


def _inexact(scene: Scene, eye: np.ndarray, bounces: int) -> list[str]:
    """Lists the features that POV-Ray draws, or may draw, differently."""
    tables = build_tables(scene)
    radius, kt = np.asarray(scene.spheres.radius), np.asarray(scene.spheres.kt)
    from_eye = _from_eye(scene, eye) - radius
    mirrors = bool(np.any(np.asarray(tables.materials.kgr) > 0))
    inexact = {
        "POV-Ray has no coats: ior is left out, diffuse light is Lambert's": (
            bool(np.any(np.asarray(tables.materials.ior) != 1))
        ),
        "planes cast and receive no directional light's shadow far outside of the spheres": (
            tables.plane_count > 0 and any(scene.lights.directional)
        ),
        "POV-Ray has its own antialiasing, +A": scene.antialias,
        f"kt counts as at most {1 - _LEAST_OPACITY}": (kt > 1 - _LEAST_OPACITY).any(),
        "rays that go straight through a sphere do not count as bounces": (
            (kt > 0).any() and (mirrors or (kt > 0).sum() > bounces)
        ),
        "far walls of transparent spheres that meet other objects or hold the eye": (
            any(from_eye[i] < 0 or _meets(tables, i) for i in np.flatnonzero(kt > 0))
        ),
        f"POV-Ray sees nothing farther than {FARTHEST:g} units, the ends of planes neither": (
            tables.plane_count > 0 or (from_eye > FARTHEST).any()
        ),
        f"POV-Ray drops the shadows of what is nearer than {_NEAREST:g} units": (
            (radius < 10 * _NEAREST).any()
        ),
    }
    return [feature for feature, present in inexact.items() if present]


def _from_eye(scene: Scene, eye: np.ndarray) -> np.ndarray:
    """Returns the distances of centres from the eye; from the plane where parallel rays start."""
    offset = np.asarray(scene.spheres.center) - eye
    if scene.camera.orthographic:
        return np.abs(offset @ _points(view_frame(scene.camera).forward))
    return np.linalg.norm(offset, axis=1)


def _meets(tables: SceneTables, i: int | np.integer) -> bool:
    """Tells whether sphere i meets another object."""
    center, radius = _points(tables.spheres.center), np.asarray(tables.spheres.radius)
    others = np.arange(tables.sphere_count) != i
    to_planes = _points(tables.planes.point) - center[i]
    from_planes = np.sum(to_planes * _points(tables.planes.normal), 1)
    return bool(
        (np.abs(from_planes) < radius[i]).any()
        or (np.linalg.norm(center - center[i], axis=1) < radius + radius[i])[others].any()
    )


def _settings(scene: Scene, bounces: int) -> list[str]:
    """Returns the global settings."""
    lights = np.asarray(scene.lights.color)
    ambient = lights.mean(axis=0) if len(lights) else np.zeros(3, scene.dtype)
    return [
        "#version 3.7;",
        "global_settings {",
        "  assumed_gamma 1",
        "  charset utf8",
        f"  ambient_light rgb {vector(ambient)} // the mean of the lights",
        f"  max_trace_level {bounces + 1} // the ray from the eye counts",
        "  adc_bailout 0",
        "}",
    ]


def _camera(camera: Camera) -> list[str]:
    """Returns the camera, whose window has the height of the picture."""
    frame = view_frame(camera)
    axes = (frame.eye, frame.right, frame.up, frame.forward)
    eye, right, up, forward = (vector(_points(v)) for v in axes)
    window, distance = next(table_rows(camera.window[None], camera.distance[None]))
    across, shift = number(window), ""
    if camera.pixel_aspect is not None:
        across += f" * {number(np.asarray(camera.pixel_aspect).item())}"
    if camera.principal_point is not None:  # from the axis to the middle of the picture
        x, y = (number(v) for v in np.asarray(camera.principal_point))
        shift = f" - {right} * ({x} * {across}) + {up} * ({y} * {number(window)})"
    if camera.orthographic:
        kind, place, direction = "orthographic", eye + shift, forward
    else:
        kind, place, direction = "perspective", eye, f"{forward} * {number(distance)}{shift}"
    return [
        "camera {",
        f"  {kind}",
        f"  location {place}",
        f"  right {right} * {across} * image_width / image_height",
        f"  up {up} * {number(window)}",
        f"  direction {direction}",
        "}",
    ]


def _background(scene: Scene) -> list[str]:
    """Returns the background or the sky, after the macro that wraps bitmaps around spheres."""
    textures = [scene.textures[k - 1] for k in scene.spheres.pic if k]
    wrapped = [_WRAPPED] if textures or scene.sky is not None else []
    if scene.sky is None:
        return [f"background {{ rgb {vector(np.asarray(scene.background))} }}", *wrapped]
    pigment = _wrapped("Sky", scene.sky, np.ones(3), 0.0)
    return [*wrapped, declared_image("Sky", scene.sky), f"sky_sphere {{ pigment {{ {pigment} }} }}"]


def _wrapped(name: str, texture: Texture, color: np.ndarray, kt: Number) -> str:
    """Returns the pigment of a bitmap around a sphere; its y is the scene's z."""
    image = np.asarray(texture.image)
    steepest = 1 / np.tan(np.pi / 2 / image.shape[0])
    peak = max(1.0, float(image.max()))
    return f"Wrapped({name}, {', '.join(number(x) for x in (steepest, peak, *color, kt))})"


def _finish(
    ka: Number, kd: Number, ks: Number, exponent: Number, kgr: Number, highlight: Highlight
) -> str:
    """Returns the finish of a surface: its coefficients and its highlight."""
    words = [f"ambient {number(ka)} diffuse {number(kd)}"]
    if ks:
        if exponent == 0:
            # POV-Ray's phong is 0 where R.V < 0, also to the power 0; H.N is never negative there
            words.append(f"specular {number(ks)} roughness 1e10")
        elif highlight == "blinn":
            words.append(f"specular {number(ks)} roughness {number(1 / exponent)}")
        else:
            words.append(f"phong {number(ks)} phong_size {number(exponent)}")
    if kgr:
        words.append(f"reflection {{ {number(kgr)} }}")
    return f"finish {{ {' '.join(words)} }}"


def _spheres(scene: Scene, eye: np.ndarray, highlight: Highlight) -> list[str]:
    """Returns the spheres, a line each, or three lines if transparent."""
    s: Spheres = scene.spheres
    columns = (s.center, s.radius, s.color, s.ka, s.kd, s.ks, s.exponent, s.kgr, s.kt)
    lines, from_eye = [], _from_eye(scene, eye)
    for row, pic, distance in zip(table_rows(*columns), s.pic, from_eye, strict=True):
        center, radius, color, ka, kd, ks, exponent, kgr, kt = row
        kt = min(kt, kt.dtype.type(1 - _LEAST_OPACITY))
        # POV-Ray dims ambient and diffuse light by 1 - kt, but not highlights and reflections
        finish = _finish(ka / (1 - kt), kd / (1 - kt), ks, exponent, kgr, highlight)
        if pic:
            pigment = _wrapped(f"Image{pic}", scene.textures[pic - 1], color, kt)
            pigment += f" translate {vector(center)}"
        else:
            pigment = f"rgbt {vector([*color, kt])}" if kt else f"rgb {vector(color)}"
        shape = f"{vector(center)}, {number(radius)}"
        surface = f"pigment {{ {pigment} }} {finish}"
        if not kt:
            lines.append(f"sphere {{ {shape} {surface} }}")
            continue
        if distance < radius:  # the eye is inside
            far_wall = f"interior_texture {{ {surface} }}"
        else:
            far_wall = "interior_texture { pigment { rgbt 1 } finish { ambient 0 diffuse 0 } }"
        visible = f"texture {{ {surface} }} {far_wall} interior {{ ior 1 }}"
        lines += [
            "// transparent: the far wall is not seen, and another sphere casts the full shadow",
            f"sphere {{ {shape} {visible} no_shadow }}",
            f"sphere {{ {shape} pigment {{ rgb 0 }} no_image no_reflection }}",
        ]
    return lines


def _planes(planes: Planes, highlight: Highlight) -> list[str]:
    """Returns the planes, a line each."""
    p = planes
    columns = (p.point, p.normal, p.color, p.ka, p.kd, p.ks, p.exponent, p.kgr)
    lines = []
    for row in table_rows(*columns, p.checker_color, p.checker_size):
        point, normal, color, ka, kd, ks, exponent, kgr, other_color, size = row
        pigment = f"rgb {vector(color)}"
        if size:
            pigment = f"checker rgb {vector(color)}, rgb {vector(other_color)}"
            pigment += f" {_squares(point, normal, size)}"
        finish = _finish(ka, kd, ks, exponent, kgr, highlight)
        lines.append(_plane(point, normal, pigment, finish))
    return lines


def _plane(point: np.ndarray, normal: np.ndarray, pigment: str, finish: str) -> str:
    """Returns one plane."""
    point, normal = np.asarray(point, np.float64), np.asarray(normal, np.float64)
    normal = normal / np.linalg.norm(normal)
    height = number(np.dot(point, normal))
    return f"plane {{ {vector(normal)}, {height} pigment {{ {pigment} }} {finish} }}"


def _squares(point: np.ndarray, normal: np.ndarray, size: Number) -> str:
    """Returns the matrix that lays POV-Ray's cubes of side 1 into a plane.

    Squares are those of `Planes`. The plane cuts the cubes in their middle, as on their faces
    rounding would choose the colour.
    """
    n = np.asarray(normal, np.float64) / np.linalg.norm(normal.astype(np.float64))
    x, y, z = np.abs(n)
    axis = np.array([0.0, 1.0, 0.0] if x > y and x > z else [1.0, 0.0, 0.0])
    along = axis - n * np.dot(axis, n)
    along /= np.linalg.norm(along)
    axes = size * np.stack([along, np.cross(n, along), n])
    rows = [*axes.reshape(-1), *(point - axes[2] / 2)]
    return f"matrix {vector(rows)}"


def _back_plane(scene: Scene) -> list[str]:
    """Returns the back plane, if the scene has one."""
    back = scene.back_plane
    if back is None:
        return []
    frame = view_frame(scene.camera)
    middle = frame.eye + frame.forward * scene.camera.distance
    color, ka, kd = next(table_rows(back.color[None], back.ka[None], back.kd[None]))
    zero = kd.dtype.type(0)
    pigment, finish = f"rgb {vector(color)}", _finish(ka, kd, zero, zero, zero, "phong")
    plane = _plane(_points(middle), -_points(frame.forward), pigment, finish)
    return ["// the view plane", plane]
