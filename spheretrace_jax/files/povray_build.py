"""From what a POV-Ray file says to a scene: ambient light, shadows, checkers, mirrored worlds."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from ..scene.lights import Lights
from ..scene.planes import Planes
from ..scene.scene import Scene
from ..scene.spheres import Spheres
from ..scene.texture import Texture
from .povray_camera import PovrayCamera, build_camera
from .povray_lights import FADING
from .povray_surface import Surface
from .povray_tokens import PovrayTokens
from .tokens import Token
from .view import unit_vector

#: Less than this part of the distance to a sphere, a light's fade_distance shows no more.
_NEAR = 1e-3


class Light(NamedTuple):
    """A light as POV-Ray has it."""

    token: Token
    position: np.ndarray
    color: list[float]
    direction: np.ndarray | None  #: toward it, if it is parallel
    fade: float | None  #: fade_distance, where fade_power is 2


class Sphere(NamedTuple):
    """A sphere as POV-Ray has it."""

    token: Token
    center: np.ndarray
    radius: float
    surface: Surface
    shadowless: bool


class Plane(NamedTuple):
    """A plane as POV-Ray has it: `height` along its normal of length 1."""

    token: Token
    normal: np.ndarray
    height: float
    surface: Surface


@dataclass
class PovrayWorld:
    """All that a POV-Ray file says of a scene."""

    camera: PovrayCamera | None = None
    lights: list[Light] = field(default_factory=list)
    spheres: list[Sphere] = field(default_factory=list)
    shadows: list[tuple[Token, np.ndarray, float]] = field(default_factory=list)
    planes: list[Plane] = field(default_factory=list)
    images: dict[str, tuple[Token, str]] = field(default_factory=dict)
    background: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    sky: tuple[Token, str] | None = None
    ambient: tuple[Token | None, np.ndarray] = (None, np.ones(3))
    warnings: list[tuple[int, str]] = field(default_factory=list)

    def say(self, token: Token, message: str) -> None:
        """Notes what is not carried over from a token's line, and what was done instead."""
        self.warnings.append((token.line, message))


def build_scene(
    tokens: PovrayTokens,
    world: PovrayWorld,
    image: Callable[[Token, str], Texture],
    dtype: np.dtype,
) -> Scene:
    """Builds the scene of a POV-Ray file.

    **Arguments:** `image`: reads the picture that a token names.

    **Raises:** `SceneError` at the statement that no scene here can be.
    """
    camera = world.camera
    assert camera is not None
    flip = np.ones(3)
    if camera.mirrored:
        flip = np.array([1.0, 1, -1])
        world.say(camera.token, "a left-handed camera: z of the world is mirrored")
        for token, _ in world.images.values():
            tokens.fail(token, "a left-handed camera would mirror bitmaps")
        for name in ("location", "right", "up", "direction"):
            setattr(camera, name, getattr(camera, name) * flip)
    if camera.fixed_aspect:
        world.say(
            camera.token, "right of a fixed width: pixels are square, as wide as they are high"
        )
    if camera.wide_angle:
        world.say(camera.token, "an angle of the picture's width: that of a square picture")
    _match_shadows(world)
    _say_highlights(tokens, world)
    lights = _lights(world, flip, dtype)
    scale = _ambient_scale(tokens, world, lights)
    number = lambda values, *shape: np.asarray(values, dtype).reshape(-1, *shape)
    names = [name for name in world.images if world.sky is None or name != world.sky[1]]
    textures = [world.images[name] for name in names]
    spheres = [s.surface for s in world.spheres]
    pic = [_image_number(tokens, names, s) for s in world.spheres]
    planes = [_plane(tokens, plane, flip) for plane in world.planes]
    sky = None
    if world.sky is not None:
        token, name = world.sky
        if name not in world.images:
            tokens.fail(token, f"the bitmap {name} was not declared")
        sky = image(*world.images[name])
    return Scene(
        Spheres(
            number([s.center * flip for s in world.spheres], 3),
            number([s.radius for s in world.spheres]),
            **_materials(spheres, scale, dtype),
            kt=number([s.kt for s in spheres]),
            pic=pic,
        ),
        lights,
        build_camera(tokens, camera, dtype),
        Planes(
            number([point for point, *_ in planes], 3),
            number([normal for _, normal, *_ in planes], 3),
            **_materials([surface for *_, surface, _ in planes], scale, dtype),
            checker_color=number([s.other_color or [0.0] * 3 for *_, s, _ in planes], 3),
            checker_size=number([size for *_, size in planes]),
        ),
        [image(*file) for file in textures],
        np.asarray(world.background, dtype),
        sky,
    )


def _materials(surfaces: list[Surface], scale: float, dtype: np.dtype) -> dict[str, Any]:
    """Returns the materials of objects; POV-Ray dims ambient and diffuse light by 1 - kt."""
    rows = [
        (*s.color, s.ambient * (1 - s.kt) * scale, s.diffuse * (1 - s.kt), s.ks, s.exponent, s.kgr)
        for s in surfaces
    ]
    table = np.array(rows, dtype).reshape(-1, 8)
    names = ("ka", "kd", "ks", "exponent", "kgr")
    return {"color": table[:, :3], **dict(zip(names, table[:, 3:].T, strict=True))}


def _lights(world: PovrayWorld, flip: np.ndarray, dtype: np.dtype) -> Lights:
    """Builds the lights. A fall-off 2 / (1 + (r/D)^2) becomes the inverse-square law."""
    rows = []
    for light in world.lights:
        position, color, falloff = light.position, np.array(light.color), 0.0
        if light.direction is not None:
            position = unit_vector(light.direction)
        if light.fade is not None:
            apart = [np.linalg.norm(s.center - position) - s.radius for s in world.spheres]
            if light.fade < _NEAR * min(apart, default=1.0):
                # as `light_sources` writes it
                falloff, color = light.fade / FADING, color * (2 * FADING**2)
            else:
                falloff = light.fade * 2**0.5
                message = f"fade_distance {light.fade:g}: the inverse-square law, as far away"
                world.say(light.token, message)
        rows.append([*(position * flip), *color, falloff])
    table = np.array(rows, dtype).reshape(-1, 7)
    far = [light.direction is not None for light in world.lights]
    return Lights(table[:, :3], table[:, 3:6], far, table[:, 6])


def _ambient_scale(tokens: PovrayTokens, world: PovrayWorld, lights: Lights) -> float:
    """Returns POV-Ray's ambient light as a part of the scene's, which is the mean of its lights."""
    token, ambient = world.ambient
    mean = np.asarray(lights.color, np.float64).mean(axis=0) if len(lights) else np.zeros(3)
    if np.allclose(ambient, mean, rtol=1e-6, atol=0):
        return 1.0
    at = token or (world.lights[0].token if world.lights else tokens.last)
    if not ambient.any():
        return 0.0
    if not mean.any():
        world.say(at, "ambient light without lights: there is none")
        return 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.nan_to_num(ambient / mean, nan=0.0, posinf=0.0)
    scale = float(ratio.mean())
    if np.ptp(ratio) > 1e-6 * scale:
        world.say(at, "ambient light of another colour than the mean of the lights: its mean")
    return scale


def _match_shadows(world: PovrayWorld) -> None:
    """Pairs spheres without a shadow with those that cast it."""
    casters = {(*center, radius) for _, center, radius in world.shadows}
    spheres = {(*s.center, s.radius) for s in world.spheres if s.shadowless}
    for sphere in world.spheres:
        if sphere.shadowless and (*sphere.center, sphere.radius) not in casters:
            world.say(sphere.token, "no_shadow: the sphere casts a shadow")
        elif sphere.surface.kt and not sphere.shadowless:
            world.say(sphere.token, "a transparent sphere: its shadow is full, its far wall unseen")
    for token, center, radius in world.shadows:
        if (*center, radius) not in spheres:
            world.say(token, "a sphere that only casts a shadow: left out")


def _say_highlights(tokens: PovrayTokens, world: PovrayWorld) -> None:
    """Notes that highlights are Blinn's. **Raises:** `SceneError` for both kinds in one file."""
    objects = [*world.spheres, *world.planes]
    first = {o.surface.highlight: o.token for o in reversed(objects) if o.surface.highlight}
    if len(first) == 2:
        later = max(first.values(), key=lambda token: token.line)
        tokens.fail(later, "phong and specular in one file: a picture here has one kind")
    if "blinn" in first:
        world.say(first["blinn"], "specular: render with --highlight blinn, highlight='blinn'")


def _image_number(tokens: PovrayTokens, names: list[str], sphere: Sphere) -> int:
    """Returns the number of a sphere's texture, from 1; 0 for none."""
    name = sphere.surface.image
    if sphere.surface.other_color is not None:
        tokens.fail(sphere.token, "a checker on a sphere: only planes have one here")
    if name and name not in names:
        tokens.fail(sphere.token, f"the bitmap {name} was not declared")
    return names.index(name) + 1 if name else 0


def _plane(
    tokens: PovrayTokens, plane: Plane, flip: np.ndarray
) -> tuple[np.ndarray, np.ndarray, Surface, float]:
    """Returns a plane's point and normal, its surface and the side of its squares, 0 for none.

    **Raises:** `SceneError` for bitmaps, and for checkers that lie otherwise than in `Planes`.
    """
    surface, normal = plane.surface, unit_vector(plane.normal) * flip
    point = normal * plane.height
    if surface.image:
        tokens.fail(plane.token, "a bitmap on a plane: only spheres have one here")
    if surface.squares is None:
        return point, normal, surface, 0.0
    axes, origin = surface.squares[:3] * flip, surface.squares[3] * flip
    sizes = np.linalg.norm(axes, axis=1)
    if not sizes.all():
        tokens.fail(plane.token, "the matrix of a checker must not have an axis of length 0")
    x, y, z = np.abs(normal)
    axis = np.array([0.0, 1, 0] if x > y and x > z else [1.0, 0, 0])
    along = unit_vector(axis - normal * (axis @ normal))
    turned = (axes / sizes[:, None]) @ np.stack([along, np.cross(normal, along), normal]).T
    # axes of the squares may be exchanged or turned round: each of these turns exchanges colours
    order = np.abs(turned).argmax(axis=1)
    signs = turned[np.arange(3), order]
    if not np.allclose(np.abs(signs), 1, atol=1e-9) or sorted(order) != [0, 1, 2]:
        tokens.fail(plane.token, "squares here lie along the world's x axis, on the plane")
    side, deep = sizes[order < 2], int(np.flatnonzero(order == 2)[0])
    layer = (point - origin) @ (axes[deep] / sizes[deep]) / sizes[deep]
    if not np.isclose(*side, rtol=1e-9) or abs(layer - np.round(layer)) < 1e-6:
        tokens.fail(plane.token, "the checker's cubes must be cut in their middle, into squares")
    if (int(np.floor(layer)) + int((signs[order < 2] < 0).sum())) % 2:
        assert surface.other_color is not None
        surface.color, surface.other_color = surface.other_color, surface.color
    return origin + axes[deep] * layer, normal, surface, float(side[0])
