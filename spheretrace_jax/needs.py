"""`Needs`: what a scene needs computed, and what is left out and why.

A picture is compiled for the needs of its scene and nothing else: no shadow pass for one sphere,
no reflection without a mirror. The needs are static, so two scenes with the same needs and shapes
share one compiled function.
"""

import dataclasses
from collections.abc import Iterable

import jax
import jax.core
import numpy as np

from .errors import InputError
from .scene import Camera, Lights, Planes, Scene, Spheres

# Of more spheres than these, whether any two cut one another is not looked up pair by pair.
_MANY = 2000


@dataclasses.dataclass(frozen=True)
class Needs:
    """What to compute, as static flags: hashable, comparable, a constant of compilation."""

    shadows: bool = True  #: some object may stand between another and a light
    highlights: bool = True  #: some ks is not 0
    inside: bool = True  #: a ray may start inside a sphere
    reflection: bool = True  #: some kgr is not 0
    transmission: bool = True  #: some kt is not 0
    branching: bool = True  #: some object both reflects and transmits
    dark_paths: bool = True  #: follow mirrors and bubbles whose kgr or kt is 0 (for derivatives)
    textures: bool = True  #: some sphere wears a texture
    planes: bool = True  #: there are planes, the back plane included
    checkers: bool = True  #: some plane has a checker
    background: bool = True  #: the background is not black
    crossings: bool = True  #: objects may cut one another (an edge, where edges are covered)

    @property
    def bounces(self) -> bool:
        """Whether rays go on after the first hit."""
        return self.reflection or self.transmission


def needs(scene: Scene, *, free: Iterable[str] = ()) -> Needs:
    """What `scene` needs computed.

    **Arguments:** `scene`: a scene of concrete numbers. `free`: names of parameters that will be
    changed or differentiated later (`"ks"`, `"kgr"`, `"kt"`, `"center"`, ...): what they could
    switch on is then needed, even where their present value is 0. A derivative with respect to
    `ks`, `kgr` or `kt` at 0 is right only if they are declared so.

    **Returns:** the needs, to pass to `render(..., needs=...)`, also under jit, grad and vmap.

    **Raises:** `InputError` for unknown names in `free`, and under a trace, where the numbers are
    not known.
    """
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(scene)):
        raise InputError(
            "the needs of a scene depend on its numbers, which are not known under jit, grad or "
            "vmap: compute needs = spheretrace_jax.needs(scene) outside and pass needs=needs"
        )
    free = _names(free)
    spheres, planes = scene.spheres, scene.planes

    def some(name: str) -> np.ndarray:
        """Per object, whether it may have a `name` other than 0."""
        value = np.asarray(getattr(spheres, name))
        if hasattr(planes, name):
            value = np.concatenate([value, np.asarray(getattr(planes, name))])
        return np.full(value.shape, True) if name in free else value != 0

    kgr, kt = some("kgr"), some("kt")
    objects = scene.objects
    moving = free & {"center", "radius", "theta", "phi", "mu"}
    inside = bool(kt.any() or (len(spheres) and (moving or _eye_is_inside(scene))))
    return Needs(
        shadows=len(scene.lights) > 0 and (objects > 1 or inside),
        highlights=len(scene.lights) > 0 and bool(some("ks").any()),
        inside=inside,
        reflection=bool(kgr.any()),
        transmission=bool(kt.any()),
        branching=bool((kgr[: len(kt)] & kt).any()),
        dark_paths=bool(free & {"kgr", "kt"}),
        textures=any(spheres.pic),
        planes=objects > len(spheres),
        checkers=bool((np.asarray(planes.checker_size) != 0).any()),
        background=scene.sky is not None
        or "background" in free
        or bool((np.asarray(scene.background) != 0).any()),
        crossings=bool(scene.antialias) and (bool(moving) or _some_cross(scene)),
    )


def _names(free: Iterable[str]) -> frozenset[str]:
    """**Raises:** `InputError` for names of no parameter, and for a bare string."""
    parts = (Spheres, Lights, Planes, Camera)
    known = {field.name for part in parts for field in dataclasses.fields(part)}
    known |= {"background", "light_position", "light_color"}
    names = frozenset([free] if isinstance(free, str) else free)
    unknown = sorted(names - known)
    if unknown:
        raise InputError(f"free must name parameters of the scene, got {', '.join(unknown)}")
    return names


def _eye_is_inside(scene: Scene) -> bool:
    """Whether the eye is inside a sphere or on it, or so near that rounding may decide."""
    theta, phi, mu = (
        np.float64(x) for x in (scene.camera.theta, scene.camera.phi, scene.camera.mu)
    )
    eye = mu * np.array([np.sin(phi) * np.cos(theta), np.sin(phi) * np.sin(theta), np.cos(phi)])
    center = np.asarray(scene.spheres.center, np.float64)
    radius = np.asarray(scene.spheres.radius, np.float64)
    slack = 8 * np.finfo(scene.dtype).eps * (np.linalg.norm(center, axis=1) + mu + radius)
    return bool((np.linalg.norm(center - eye, axis=1) <= radius + slack).any())


def _some_cross(scene: Scene) -> bool:
    """Whether any two objects cut one another. Of very many objects it is taken for granted."""
    center = np.asarray(scene.spheres.center, np.float64)
    radius = np.asarray(scene.spheres.radius, np.float64)
    planes = len(scene.planes) + (scene.back_plane is not None)
    if planes > 1 or len(radius) > _MANY or scene.back_plane is not None:
        return True
    for point, normal in zip(scene.planes.point, scene.planes.normal, strict=True):
        normal = np.asarray(normal, np.float64) / np.linalg.norm(normal)
        if (np.abs((center - np.asarray(point)) @ normal) <= radius).any():
            return True
    apart = np.linalg.norm(center[:, None] - center[None], axis=-1)
    sum_, difference = radius[:, None] + radius[None], np.abs(radius[:, None] - radius[None])
    cut = (apart <= sum_) & (apart >= difference)
    return bool(cut[~np.eye(len(radius), dtype=bool)].any())


def left_out(scene: Scene) -> list[tuple[str, bool, str]]:
    """Each feature, whether `scene` needs it, and why (or why not): what `info` prints."""
    n = needs(scene)
    lit = len(scene.lights) > 0
    table = {
        "shadows": (
            "an object may stand between another and a light",
            "nothing can stand between an object and a light" if lit else "no lights",
        ),
        "highlights": ("some ks > 0", "every ks is 0" if lit else "no lights"),
        "inside": ("the eye is in a sphere, or light passes one", "no ray starts inside a sphere"),
        "reflection": ("some kgr > 0", "every kgr is 0"),
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
    }
    found = dataclasses.asdict(n) | {"antialias": bool(scene.antialias)}
    return [(name, found[name], why[not found[name]]) for name, why in table.items()]
