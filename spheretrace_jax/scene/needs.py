"""`Needs`: the features that a scene's picture needs computed, and the reasons.

A picture is compiled for the needs of its scene alone: no shadow pass for one sphere, no reflection
without a mirror. The needs are static, so two scenes with the same needs and shapes share one
compiled function.
"""

import dataclasses
from collections.abc import Iterable

import jax
import jax.core
import numpy as np
from jaxtyping import Array, Bool

from ..base.errors import InputError
from ..base.types import Index
from . import feature_tests
from .parameters import parameter_names
from .scene import Scene


@dataclasses.dataclass(frozen=True)
class Needs:
    """Features to compute, as static flags: hashable, comparable, a constant of compilation."""

    shadows: bool = True  #: an object may stand between another and a light
    highlights: bool = True  #: a ks is not 0
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
    clear: tuple[int, ...] = ()  #: lights that no object can block: no shadow pass
    depth: int | None = None  #: bounces after which no ray meets an object; None: no limit

    def shadows_of(self, light: Index) -> bool:
        """Tells whether objects may block a light: any light, while its number is not known."""
        return self.shadows and not (isinstance(light, int) and light in self.clear)

    @property
    def bounces(self) -> bool:
        """Tells whether rays go on after the first hit."""
        return self.reflection or self.transmission


def needs(scene: Scene, *, free: Iterable[str] = ()) -> Needs:
    """Finds the features that the picture of a scene needs computed.

    **Arguments:** `scene`: a scene of concrete numbers. `free`: names of parameters that will be
    changed or differentiated later (`"ks"`, `"kgr"`, `"kt"`, `"center"`, ...). Features that free
    parameters could switch on are needed, even where the present value of a parameter is 0. A
    derivative with respect to `ks`, `kgr` or `kt` at 0 is right only if the parameter is in `free`.

    **Returns:** needs to pass to `render(..., needs=...)`, also under jit, grad and vmap.

    **Raises:** `InputError` for unknown names in `free`, for dtypes that no scene may have, and
    under a trace, where the numbers are not known.
    """
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(scene)):
        raise InputError(
            "the needs of a scene depend on its numbers, which are not known under jit, grad or "
            "vmap: compute needs = spheretrace_jax.needs(scene) outside and pass needs=needs"
        )
    scene.check_dtype()
    free = parameter_names(free)
    spheres, planes = scene.spheres, scene.planes

    ks, kgr, kt = (_nonzero(scene, name, free) for name in ("ks", "kgr", "kt"))
    objects, lights = scene.objects, len(scene.lights)
    moving = free & {"center", "radius", "theta", "phi", "mu"}
    inside = bool(kt.any() or (len(spheres) and (moving or feature_tests.eye_inside(scene))))
    moves = inside or free & {"center", "radius", "light_position"}
    clear = () if moves else feature_tests.unshadowed_lights(scene)
    background = bool(
        scene.sky is not None or "background" in free or np.asarray(scene.background).any()
    )
    textures, checkers = any(spheres.pic), bool(np.asarray(planes.checker_size).any())
    tinted = "light_color" in free or feature_tests.any_colored(scene.lights.color)
    colors = (
        textures
        or scene.sky is not None
        or free & {"color", "checker_color", "background"}
        or feature_tests.any_colored(*_colors(scene))
    )
    return Needs(
        shadows=lights > len(clear) and (objects > 1 or inside),
        highlights=lights > 0 and bool(ks.any()),
        inside=inside,
        reflection=bool(kgr.any()),
        transmission=bool(kt.any()),
        branching=bool((kgr[: len(kt)] & kt).any()),
        dark_paths=bool(free & {"kgr", "kt"}),
        textures=textures,
        planes=objects > len(spheres),
        checkers=checkers,
        background=background,
        crossings=bool(scene.antialias) and (bool(moving) or feature_tests.objects_cross(scene)),
        tinted=tinted,
        colors=tinted or bool(colors),
        clear=clear if len(clear) < lights else (),
        # the only object is convex: its mirrored rays see the sky
        depth=None if objects > 1 or inside else int(background),
    )


def _nonzero(scene: Scene, name: str, free: frozenset[str]) -> Bool[np.ndarray, " objects"]:
    """Tells for each object whether its coefficient `name` may be other than 0."""
    value = np.asarray(getattr(scene.spheres, name))
    if hasattr(scene.planes, name):
        value = np.concatenate([value, np.asarray(getattr(scene.planes, name))])
    return np.full(value.shape, True) if name in free else value != 0


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
    }
    flags = dataclasses.asdict(needed) | {"antialias": bool(scene.antialias)}
    return [(name, flags[name], reasons[not flags[name]]) for name, reasons in table.items()]
