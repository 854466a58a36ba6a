"""`Needs`: the features that a scene's picture needs computed, and the reasons.

A picture is compiled for the needs of its scene alone: no shadow pass for one sphere, no reflection
without a mirror. The needs are static, so two scenes with the same needs and shapes share one
compiled function.
"""

import dataclasses
import functools
from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Array, Bool

from ..base.errors import InputError
from ..base.types import Index
from . import feature_tests
from .arrays import check_refraction, is_traced
from .parameters import LIGHT_PLACES, parameter_names, traced_names
from .scene import Scene, check_scene


@dataclasses.dataclass(frozen=True)
class Needs:
    """Features to compute, as static flags: hashable, comparable, a constant of compilation."""

    shadows: bool = True  #: an object may stand between another and a light
    highlights: bool = True  #: a ks is not 0
    coated: bool = True  #: an index of refraction is not 1
    inside: bool = True  #: a ray may start inside a sphere
    reflection: bool = True  #: a kgr is not 0
    transmission: bool = True  #: a kt is not 0
    branching: bool = True  #: an object both reflects and transmits
    dark_paths: bool = True  #: follow mirrors and bubbles whose kgr or kt is 0 (for derivatives)
    textures: bool = True  #: a sphere has a texture
    planes: bool = True  #: the scene has planes, the back plane included
    checkers: bool = True  #: a plane has a checker
    background: bool = True  #: the background is not black
    crossings: bool = True  #: objects may cross (an edge, where edges are covered)
    tinted: bool = True  #: a light's red, green and blue differ
    colors: bool = True  #: red, green and blue of a light or a colour differ
    falloff: bool = True  #: a light at a point grows dimmer with its distance
    clear: tuple[int, ...] = ()  #: lights that no object can block: no shadow pass
    depth: int | None = None  #: bounces after which no ray meets an object; None: no limit

    def shadows_of(self, light: Index) -> bool:
        """Tells whether objects may block a light: any light, while its number is not known."""
        return self.shadows and not (isinstance(light, int) and light in self.clear)

    @property
    def bounces(self) -> bool:
        """Tells whether rays go on after the first hit."""
        return self.reflection or self.transmission


def needs(scene: Scene | Sequence[Scene], *, free: Iterable[str] = ()) -> Needs:
    """Finds the features that the picture of a scene needs computed.

    Parameters that are traced, under jit, grad, vmap and the like, count as free: their values are
    not known. So a loss in the colours needs no more than the scene with free colours.

    **Arguments:** `scene`: a scene, or several scenes, for what they need together: pictures of all
    of them then share one compiled function. `free`: names of parameters that will be changed or
    differentiated later (`"ks"`, `"kgr"`, `"kt"`, `"center"`, ...). Features that free parameters
    could switch on are needed, even where the present value of a parameter is 0. A derivative with
    respect to `ks`, `kgr` or `kt` at 0 is right only if the parameter is free. (By `ior` at 1 it is
    0, but not the second one.)

    **Returns:** needs to pass to `render(..., needs=...)`.

    **Raises:** `InputError` for unknown names in `free`, for scenes whose arrays do not fit or
    hold an index of refraction below 1, and for no scene at all.
    """
    free = parameter_names(free)
    scenes = [check_scene(s) for s in (scene if isinstance(scene, Iterable) else [scene])]
    if not scenes:
        raise InputError("needs must be asked of at least one scene, got none")
    return functools.reduce(together, [needs_of(one, free) for one in scenes])


def needs_of(scene: Scene, free: frozenset[str] = frozenset()) -> Needs:
    """Finds the needs of one scene that was checked. **Arguments:** `free`: known names.

    **Raises:** `InputError` for indices of refraction below 1: these are looked at here.
    """
    free = free | traced_names(scene)
    spheres, planes = scene.spheres, scene.planes
    check_refraction("spheres.", spheres.ior)
    check_refraction("planes.", planes.ior)

    ks, kgr, kt = (_differs(scene, name, free) for name in ("ks", "kgr", "kt"))
    ior = _differs(scene, "ior", free, plain=1)
    objects, lights = scene.objects, len(scene.lights)
    moving = free & {"center", "radius", "theta", "phi", "mu", "look_at"}
    inside = bool(kt.any() or (len(spheres) and (moving or feature_tests.eye_inside(scene))))
    moves = inside or free & {"center", "radius", *LIGHT_PLACES}
    clear = () if moves else feature_tests.unshadowed_lights(scene)
    background = bool(
        scene.sky is not None or "background" in free or np.asarray(scene.background).any()
    )
    textures, checkers = any(spheres.pic), _any_nonzero(planes.checker_size)
    tinted = "light_color" in free or feature_tests.any_colored(scene.lights.color)
    colors = (
        textures
        or scene.sky is not None
        or free & {"color", "checker_color", "background"}
        or any(map(is_traced, _colors(scene)))
        or feature_tests.any_colored(*_colors(scene))
    )
    cross = moving or is_traced(planes) or (scene.antialias and feature_tests.objects_cross(scene))
    return Needs(
        shadows=lights > len(clear) and (objects > 1 or inside),
        highlights=lights > 0 and bool(ks.any()),
        coated=lights > 0 and bool(ior.any()),
        inside=inside,
        reflection=bool(kgr.any()),
        transmission=bool(kt.any()),
        branching=bool((kgr[: len(kt)] & kt).any()),
        dark_paths=bool(free & {"kgr", "kt"}),
        textures=textures,
        planes=objects > len(spheres),
        checkers=checkers,
        background=background,
        crossings=bool(scene.antialias) and bool(cross),
        tinted=tinted,
        colors=tinted or bool(colors),
        falloff=_falls_off(scene, free),
        clear=clear if len(clear) < lights else (),
        # the only object is convex: its mirrored rays see the sky
        depth=None if objects > 1 or inside else int(background),
    )


def together(a: Needs, b: Needs) -> Needs:
    """Returns the needs of two scenes together."""
    flags = {
        name: value or getattr(b, name)
        for name, value in dataclasses.asdict(a).items()
        if name not in ("clear", "depth")
    }
    # the lights of a scene that needs no shadows are all clear
    clear = [set(n.clear) for n in (a, b) if n.shadows]
    depth = None if a.depth is None or b.depth is None else max(a.depth, b.depth)
    both = tuple(sorted(set.intersection(*clear))) if clear else ()
    return Needs(**flags, clear=both, depth=depth)


def _differs(
    scene: Scene, name: str, free: frozenset[str], plain: int = 0
) -> Bool[np.ndarray, " objects"]:
    """Tells for each object whether its coefficient `name` may be other than `plain`."""
    values = [
        getattr(owner, name) for owner in (scene.spheres, scene.planes) if hasattr(owner, name)
    ]
    if name in free:
        return np.full(sum(len(value) for value in values), True)
    return np.concatenate([np.asarray(value) for value in values]) != plain


def _falls_off(scene: Scene, free: frozenset[str]) -> bool:
    """Tells whether a light at a point may have a fall-off."""
    near, falloff = scene.lights.numbers(directional=False), scene.lights.falloff
    if not near:
        return False
    return "light_falloff" in free or bool(np.asarray(falloff)[near].any())


def _any_nonzero(value: Array) -> bool:
    """Tells whether a number of an array may be other than 0."""
    return bool(value.size) and (is_traced(value) or bool(np.asarray(value).any()))


def _colors(scene: Scene) -> tuple[Array, ...]:
    """Returns the colours of all objects and of the background."""
    spheres, planes, back_plane = scene.spheres, scene.planes, scene.back_plane
    colors = (spheres.color, planes.color, planes.checker_color, scene.background)
    return colors if back_plane is None else (*colors, back_plane.color)


def left_out(scene: Scene) -> list[tuple[str, bool, str]]:
    """Lists the features, with whether `scene` needs each of them and the reason: for `info`."""
    needed = needs(scene)
    lit = len(scene.lights) > 0
    clear = ", ".join(str(k + 1) for k in needed.clear)
    table = {  # feature: the reason if it is needed, the reason if it is not
        "shadows": (
            "an object may stand between another and a light"
            + (f"; not for light {clear}, whose way is free" if clear else ""),
            "nothing can stand between an object and a light" if lit else "no lights",
        ),
        "highlights": ("some ks > 0", "every ks is 0" if lit else "no lights"),
        "coated": ("some ior > 1", "every ior is 1" if lit else "no lights"),
        "inside": ("the eye is in a sphere, or light passes one", "no ray starts inside a sphere"),
        "reflection": (
            "some kgr > 0" + ("" if needed.depth is None else "; the only object mirrors no other"),
            "every kgr is 0",
        ),
        "transmission": ("some kt > 0", "every kt is 0"),
        "branching": ("an object has both kgr and kt", "no object has both kgr and kt"),
        "textures": ("some pic > 0", "every pic is 0"),
        "planes": ("there are planes", "there are none"),
        "checkers": ("some plane has two colours", "no plane has two colours"),
        "background": ("a colour or a sky", "black"),
        "antialias": ("the flag is 1: edges are covered by area", "the flag is 0"),
        "crossings": (
            "objects may cut one another",
            "no object cuts another, or no edge is covered",
        ),
        "tinted": ("a light is coloured", "every light is white or grey"),
        "colors": ("something is coloured", "everything is white or grey: one channel"),
        "falloff": ("a light has a fall-off", "no light has a fall-off"),
    }
    flags = dataclasses.asdict(needed) | {"antialias": bool(scene.antialias)}
    return [(name, flags[name], reasons[not flags[name]]) for name, reasons in table.items()]
