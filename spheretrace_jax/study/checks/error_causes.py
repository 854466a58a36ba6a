"""`Why`: what makes a pixel's float32 differ from its float64."""

import dataclasses
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from ...rendering.render import sample_places
from ...scene.scene import Scene
from ...scene.settings import RenderSettings
from .ray_log import RayRecord, log_rays

Cause = Literal[
    "grazing",
    "silhouette tie",
    "highlight exponent",
    "cancellation",
    "mirrors",
    "overflow",
    "rounding",
]

#: What each cause means and what to do about it.
CAUSES: dict[Cause, str] = {
    "grazing": "{things}: N.V or N.L is near 0 in {pixels}, where float32 loses digits "
    "(factor {factor})",
    "silhouette tie": "{things}: an edge is within rounding of the rays of {pixels}, which may "
    "show either side of it",
    "highlight exponent": "{things}: the exponents multiply the rounding of (R.V)^n by up to "
    "{factor} in {pixels}: use float64 (--dtype float64) or smaller exponents",
    "cancellation": "float32 loses {things}, up to {factor} radii away from the eye or the "
    "origin, in {pixels}: use float64 (--dtype float64)",
    "mirrors": "{things}: mirrors multiply the rounding of rays by up to {factor} in {pixels}: "
    "use float64 (--dtype float64) or fewer bounces",
    "overflow": "{things}: squares of lengths leave the range of float32 in {pixels}: use float64 "
    "(--dtype float64) or other units of length",
    "rounding": "{things}: nothing multiplies rounding errors, but they show in {pixels}",
}

_EPS = float(np.finfo(np.float32).eps)

# What multiplies rounding by no more than this does not explain an error.
_ORDINARY = 30

# A colour takes about so many roundings.
_ROUNDINGS = 100

# Edges that are known to no better than this part of the radius are no ties.
_LOST = 1e-4


@dataclasses.dataclass(frozen=True)
class Why:
    """Why a pixel differs: as `StabilityRow`."""

    cause: Cause
    factor: float
    object: str
    bounce: int


def explain(
    both: tuple[Scene, Scene],
    settings: RenderSettings,
    pixels: np.ndarray,
    error: Float[np.ndarray, " pixels"],
    brightest: float,
) -> list[Why]:
    """Why some pixels differ.

    **Arguments:** `both`: the scene in float32 and in float64. `error`: how much they differ.
    `brightest`: the picture's largest number.
    """
    # where objects both reflect and transmit, the paths that always do the one or the other
    choices = (0, 1) if settings.bounces and settings.needs.branching else (0,)
    places = np.stack(jax.tree.map(np.asarray, sample_places(both[1], settings)), axis=-1)
    pairs = [_trails(both, settings, pixels, place, c) for place in places for c in choices]
    apart = np.stack([_apart(single, double) for single, double in pairs])
    which = apart.argmax(axis=0)
    at = lambda stop, k: jax.tree.map(lambda x: x[:, k], stop)
    scene = _Lengths(both[1])
    found = []
    for k, (i, e) in enumerate(zip(which, error, strict=True)):
        single, double = pairs[i]
        found.append(_why(scene, at(single, k), at(double, k), float(e), brightest))
    return found


def _trails(
    both: tuple[Scene, Scene],
    settings: RenderSettings,
    pixels: np.ndarray,
    place: np.ndarray,
    choice: int,
) -> tuple[RayRecord, RayRecord]:
    def follow(scene: Scene) -> RayRecord:
        left, top = jnp.asarray(place, scene.dtype)
        stop = log_rays(scene, settings, jnp.asarray(pixels, jnp.int32), left, top, choice)
        return jax.tree.map(_double, stop)

    single, double = both
    return follow(single), follow(double)


def _double(x: jax.Array) -> np.ndarray:
    array = np.asarray(x)
    return array.astype(np.float64) if np.issubdtype(array.dtype, np.floating) else array


def _apart(single: RayRecord, double: RayRecord) -> np.ndarray:
    """How far a ray's two colours are apart, and infinitely where one is no number."""
    apart = np.abs(single.color.sum(0) - double.color.sum(0)).max(-1)
    return np.where(np.isfinite(apart), apart, np.inf)


class _Lengths:
    """The lengths of a scene on which the accuracy of intersections depends."""

    def __init__(self, scene: Scene):
        s, p = jax.tree.map(np.asarray, (scene.spheres, scene.planes))
        self.center, self.radius, self.point, self.normal = s.center, s.radius, p.point, p.normal
        self.lights = np.asarray(scene.lights.position)

    def name(self, i: int) -> str:
        if i < 0:
            return "the background"
        n, planes = len(self.radius), len(self.point)
        if i < n:
            return f"sphere {i + 1}"
        return f"plane {i - n + 1}" if i < n + planes else "the back plane"

    def lost(self, i: int, origin: ArrayLike) -> float:
        """By what rounding an object's or a ray's place grows, in units of the object itself."""
        n, origin = len(self.radius), np.asarray(origin)
        if not 0 <= i < n + len(self.point):
            return 1.0
        if i < n:
            place, size = self.center[i], self.radius[i]
        else:
            place, normal = self.point[i - n], self.normal[i - n]
            size = abs(np.dot(place - origin, normal)) / np.linalg.norm(normal)
        lengths = [np.linalg.norm(x) for x in (place, origin, place - origin)]
        return float(max(lengths) / size) if size > 0 else 1.0

    def beyond(self, i: int, origin: ArrayLike) -> bool:
        """Whether the squares of the lengths of an intersection do not fit into float32."""
        if not 0 <= i < len(self.radius):
            return False
        range_ = np.finfo(np.float32)
        lengths = [self.radius[i], np.linalg.norm(self.center[i] - np.asarray(origin))]
        return any(not range_.tiny < x * x < range_.max for x in lengths if x)

    def nearest_edge(self, origin: ArrayLike, direction: ArrayLike, reach: float = np.inf) -> int:
        """The sphere whose silhouette, or shadow's edge, a ray passes most closely."""
        if not len(self.radius):
            return -1
        oc, direction = self.center - np.asarray(origin), np.asarray(direction)
        along = oc @ direction
        off = np.linalg.norm(oc - along[:, None] * direction, axis=1)
        ahead = (along > 0) & (along < reach)
        return int(np.argmin(np.where(ahead, np.abs(off - self.radius) / self.radius, np.inf)))


def _why(
    scene: _Lengths, single: RayRecord, double: RayRecord, error: float, brightest: float
) -> Why:
    """**Arguments:** `single`, `double`: the stops of one ray in both precisions."""
    if not error < np.inf and not np.isfinite(_apart(single, double)):
        return Why("overflow", np.inf, scene.name(int(double.id[0])), 0)
    for b in range(len(double.id)):
        if single.alive[b] != double.alive[b]:
            break
        if double.alive[b] and (why := _parted(scene, single, double, b)):
            return why
    why = _grown(scene, single, double)
    # no pixel is off by more than the worst of its rays
    elsewhere = _apart(single, double) < error / 2
    if elsewhere and error > _ROUNDINGS * why.factor * _EPS * brightest:
        return _of_edge(scene, double)
    return why


def _of_edge(scene: _Lengths, double: RayRecord) -> Why:
    """Where the ray itself does not have the error: it is in an edge beside it, or the ray's
    formulas, compiled another way, fall on the other side of one.
    """
    origin = double.origin[0]
    edge = scene.nearest_edge(origin, double.direction[0])
    ids = {int(double.id[0]), edge} - {-1}
    lost, i = max(((scene.lost(i, origin), i) for i in ids), default=(1.0, -1))
    if lost * _EPS > _LOST:
        return Why("cancellation", lost, scene.name(i), 0)
    return Why("silhouette tie", 1.0, scene.name(edge), 0)


def _parted(scene: _Lengths, single: RayRecord, double: RayRecord, b: int) -> Why | None:
    """Why something else is met or lit at a bounce, if it is."""
    ids = int(single.id[b]), int(double.id[b])
    origin, who = double.origin[b], max(ids)
    if ids[0] != ids[1] or single.inside[b] != double.inside[b]:
        lost, who = max((scene.lost(i, origin), i) for i in ids)
    elif (reached := (single.lit & single.turned)[b] != (double.lit & double.turned)[b]).any():
        light = int(np.argmax(reached))
        if single.turned[b, light] == double.turned[b, light]:
            return _shadow(scene, double, b, light)
        return Why("grazing", np.inf, scene.name(who), b)
    else:
        return None
    if any(scene.beyond(i, origin) for i in ids):
        return Why("overflow", np.inf, scene.name(who), b)
    if lost * _EPS > _LOST:
        return Why("cancellation", lost, scene.name(who), b)
    turned = _turned(single, double, b)
    if turned * _EPS > _LOST:
        return Why("mirrors", turned, scene.name(who), b)
    return Why("silhouette tie", 1.0, scene.name(max(ids)), b)


def _shadow(scene: _Lengths, double: RayRecord, b: int, light: int) -> Why:
    """Why a light reaches a point in one precision only."""
    point, own = np.asarray(double.point[b]), int(double.id[b])
    to_light = scene.lights[light] - point
    reach = float(np.linalg.norm(to_light))
    blocker = scene.nearest_edge(point, to_light / reach, reach)
    lost, who = max((scene.lost(i, point), i) for i in (own, blocker))
    if lost * _EPS > _LOST:
        return Why("cancellation", lost, scene.name(who), b)
    return Why("silhouette tie", 1.0, f"the shadow of {scene.name(blocker)}", b)


def _grown(scene: _Lengths, single: RayRecord, double: RayRecord) -> Why:
    """What multiplies rounding most at the bounce that brings most of the error."""
    alive = np.logical_and.accumulate(single.alive & double.alive)
    apart = np.where(alive, np.abs(single.color - double.color).max(-1), -1)
    b = int(apart.argmax())
    i = int(double.id[b])
    factors: dict[Cause, float] = {"cancellation": scene.lost(i, double.origin[b])}
    if b:
        factors["mirrors"] = _turned(single, double, b)
    if i >= 0 and double.facing[b] > 0:
        factors["grazing"] = float(1 / double.facing[b])
    if abs(single.shine[b] - double.shine[b]) >= apart[b] / 2:
        factors["highlight exponent"] = float(double.steep[b])
    cause = max(factors, key=lambda name: factors[name])
    if factors[cause] <= _ORDINARY:
        return Why("rounding", factors[cause], scene.name(i), b)
    return Why(cause, factors[cause], scene.name(i), b)


def _turned(single: RayRecord, double: RayRecord, b: int) -> float:
    """By what the rounding of a mirrored ray's direction has grown."""
    return float(np.abs(single.direction[b] - double.direction[b]).max() / _EPS)
