"""Error causes: the reasons for which a pixel in float32 differs from float64."""

import dataclasses
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from ...rendering.samples import sample_positions
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

#: The sentence for each cause, with the remedy.
CAUSES: dict[Cause, str] = {
    "grazing": "{objects}: N.V or N.L is near 0 in {pixels}, where float32 loses digits "
    "(factor {factor})",
    "silhouette tie": "{objects}: an edge is within rounding of the rays of {pixels}, which may "
    "show either side of it",
    "highlight exponent": "{objects}: the exponents multiply the rounding of (R.V)^n by up to "
    "{factor} in {pixels}: use float64 (--dtype float64) or smaller exponents",
    "cancellation": "float32 loses {objects}, up to {factor} radii away from the eye or the "
    "origin, in {pixels}: use float64 (--dtype float64)",
    "mirrors": "{objects}: mirrors multiply the rounding of rays by up to {factor} in {pixels}: "
    "use float64 (--dtype float64) or fewer bounces",
    "overflow": "{objects}: squares of lengths leave the range of float32 in {pixels}: use float64 "
    "(--dtype float64) or other units of length",
    "rounding": "{objects}: nothing multiplies rounding errors, but they show in {pixels}",
}

_EPS = float(np.finfo(np.float32).eps)

# Largest growth of rounding errors that counts as ordinary: it explains no error.
_ORDINARY_GROWTH = 30

# Estimate of the rounding operations in one colour.
_ROUNDINGS = 100

# Largest relative error of an edge's position in a tie. Positions with larger errors are lost by
# cancellation or by mirrors.
_LARGEST_TIE = 1e-4


@dataclasses.dataclass(frozen=True)
class Explanation:
    """The cause of a pixel's error: the fields are those of `StabilityRow`."""

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
) -> list[Explanation]:
    """Finds the causes of the pixels' errors.

    **Arguments:** `both`: the scene in float32 and in float64. `pixels`: numbered row by row.
    `error`: the pixels' errors. `brightest`: the picture's largest number.

    **Returns:** an explanation for each pixel.
    """
    # where paths branch, the two paths that always reflect, or always go straight on
    choices = (0, 1) if settings.bounces and settings.needs.branching else (0,)
    offsets = np.stack(jax.tree.map(np.asarray, sample_positions(both[1], settings)), axis=-1)
    logs = [_log_both(both, settings, pixels, offset, c) for offset in offsets for c in choices]
    difference = np.stack([_difference(single, double) for single, double in logs])
    worst_path = difference.argmax(axis=0)
    of_pixel = lambda log, k: jax.tree.map(lambda x: x[:, k], log)
    lengths = _Lengths(both[1])
    explanations = []
    for k, (path, e) in enumerate(zip(worst_path, error, strict=True)):
        single, double = (of_pixel(log, k) for log in logs[path])
        explanations.append(_explain_ray(lengths, single, double, float(e), brightest))
    return explanations


def _log_both(
    both: tuple[Scene, Scene],
    settings: RenderSettings,
    pixels: np.ndarray,
    offset: np.ndarray,
    choice: int,
) -> tuple[RayRecord, RayRecord]:
    """Logs one ray through each pixel, in both precisions. **Returns:** two logs in float64."""

    def log(scene: Scene) -> RayRecord:
        left, top = jnp.asarray(offset, scene.dtype)
        record = log_rays(scene, settings, jnp.asarray(pixels, jnp.int32), left, top, choice)
        return jax.tree.map(_double, record)

    single, double = both
    return log(single), log(double)


def _double(x: jax.Array) -> np.ndarray:
    """Converts floating arrays to float64, and all arrays to NumPy."""
    array = np.asarray(x)
    return array.astype(np.float64) if np.issubdtype(array.dtype, np.floating) else array


def _difference(single: RayRecord, double: RayRecord) -> np.ndarray:
    """Returns the difference of a ray's colours in both precisions; infinity for nan."""
    difference = np.abs(single.color.sum(0) - double.color.sum(0)).max(-1)
    return np.where(np.isfinite(difference), difference, np.inf)


class _Lengths:
    """Lengths of a scene on which the accuracy of intersections depends."""

    def __init__(self, scene: Scene):
        s, p = jax.tree.map(np.asarray, (scene.spheres, scene.planes))
        self.center, self.radius, self.point, self.normal = s.center, s.radius, p.point, p.normal
        self.lights = scene.lights

    def name(self, i: int) -> str:
        """Names an object, in words."""
        if i < 0:
            return "the background"
        n, planes = len(self.radius), len(self.point)
        if i < n:
            return f"sphere {i + 1}"
        return f"plane {i - n + 1}" if i < n + planes else "the back plane"

    def growth(self, i: int, origin: ArrayLike) -> float:
        """Returns the growth of the rounding errors of positions, in units of an object's size.

        **Arguments:** `i`: the object's number. `origin`: the ray's.
        """
        n, origin = len(self.radius), np.asarray(origin)
        if not 0 <= i < n + len(self.point):
            return 1.0
        if i < n:
            position, size = self.center[i], self.radius[i]
        else:
            position, normal = self.point[i - n], self.normal[i - n]
            size = abs(np.dot(position - origin, normal)) / np.linalg.norm(normal)
        lengths = [np.linalg.norm(x) for x in (position, origin, position - origin)]
        return float(max(lengths) / size) if size > 0 else 1.0

    def overflows(self, i: int, origin: ArrayLike) -> bool:
        """Tells whether the squared lengths of an intersection leave the range of float32."""
        if not 0 <= i < len(self.radius):
            return False
        range_ = np.finfo(np.float32)
        lengths = [self.radius[i], np.linalg.norm(self.center[i] - np.asarray(origin))]
        return any(not range_.tiny < x * x < range_.max for x in lengths if x)

    def nearest_edge(self, origin: ArrayLike, direction: ArrayLike, end: float = np.inf) -> int:
        """Finds the sphere whose silhouette, or shadow edge, a ray passes most closely.

        **Arguments:** `end`: the ray's length. **Returns:** the sphere's number, -1 for none.
        """
        if not len(self.radius):
            return -1
        oc, direction = self.center - np.asarray(origin), np.asarray(direction)
        along = oc @ direction
        distance = np.linalg.norm(oc - along[:, None] * direction, axis=1)
        ahead = (along > 0) & (along < end)
        gap = np.abs(distance - self.radius) / self.radius
        return int(np.argmin(np.where(ahead, gap, np.inf)))


def _explain_ray(
    scene: _Lengths, single: RayRecord, double: RayRecord, error: float, brightest: float
) -> Explanation:
    """Finds the cause of one ray's error.

    **Arguments:** `single`, `double`: the log of the ray in both precisions.
    """
    if not error < np.inf and not np.isfinite(_difference(single, double)):
        return Explanation("overflow", np.inf, scene.name(int(double.id[0])), 0)
    for b in range(len(double.id)):
        if single.alive[b] != double.alive[b]:
            break
        if double.alive[b] and (explanation := _explain_parting(scene, single, double, b)):
            return explanation
    explanation = _explain_growth(scene, single, double)
    # a pixel's error is at most that of the worst of its rays
    elsewhere = _difference(single, double) < error / 2
    if elsewhere and error > _ROUNDINGS * explanation.factor * _EPS * brightest:
        return _explain_edge(scene, double)
    return explanation


def _explain_edge(scene: _Lengths, double: RayRecord) -> Explanation:
    """Explains an error that the logged ray does not have, by the edge nearest to the ray.

    The error arises at this edge, or the ray's formulas, compiled in another way, give the other
    side of the edge.
    """
    origin = double.origin[0]
    edge = scene.nearest_edge(origin, double.direction[0])
    ids = {int(double.id[0]), edge} - {-1}
    growth, i = max(((scene.growth(i, origin), i) for i in ids), default=(1.0, -1))
    if growth * _EPS > _LARGEST_TIE:
        return Explanation("cancellation", growth, scene.name(i), 0)
    return Explanation("silhouette tie", 1.0, scene.name(edge), 0)


def _explain_parting(
    scene: _Lengths, single: RayRecord, double: RayRecord, b: int
) -> Explanation | None:
    """Explains another object or another shadow at bounce `b`; None where both are the same."""
    ids = int(single.id[b]), int(double.id[b])
    origin, i = double.origin[b], max(ids)
    if ids[0] == ids[1] and single.inside[b] == double.inside[b]:
        changed = (single.lit & single.turned)[b] != (double.lit & double.turned)[b]
        if not changed.any():
            return None
        light = int(np.argmax(changed))
        if single.turned[b, light] == double.turned[b, light]:
            return _explain_shadow(scene, double, b, light)
        return Explanation("grazing", np.inf, scene.name(i), b)
    growth, i = max((scene.growth(i, origin), i) for i in ids)
    if any(scene.overflows(i, origin) for i in ids):
        return Explanation("overflow", np.inf, scene.name(i), b)
    if growth * _EPS > _LARGEST_TIE:
        return Explanation("cancellation", growth, scene.name(i), b)
    by_mirrors = _growth_by_mirrors(single, double, b)
    if by_mirrors * _EPS > _LARGEST_TIE:
        return Explanation("mirrors", by_mirrors, scene.name(i), b)
    return Explanation("silhouette tie", 1.0, scene.name(max(ids)), b)


def _explain_shadow(scene: _Lengths, double: RayRecord, b: int, light: int) -> Explanation:
    """Explains that a light is visible from a point in one precision only."""
    point, lit_object = np.asarray(double.point[b]), int(double.id[b])
    directional = scene.lights.directional[light]
    to_light = np.asarray(scene.lights.position[light]) - (0 if directional else point)
    distance = float(np.linalg.norm(to_light))
    end = np.inf if directional else distance
    blocker = scene.nearest_edge(point, to_light / distance, end)
    growth, i = max((scene.growth(i, point), i) for i in (lit_object, blocker))
    if growth * _EPS > _LARGEST_TIE:
        return Explanation("cancellation", growth, scene.name(i), b)
    return Explanation("silhouette tie", 1.0, f"the shadow of {scene.name(blocker)}", b)


def _explain_growth(scene: _Lengths, single: RayRecord, double: RayRecord) -> Explanation:
    """Finds the largest growth of rounding errors, at the bounce with most of the error."""
    alive = np.logical_and.accumulate(single.alive & double.alive)
    difference = np.where(alive, np.abs(single.color - double.color).max(-1), -1)
    b = int(difference.argmax())
    i = int(double.id[b])
    factors: dict[Cause, float] = {"cancellation": scene.growth(i, double.origin[b])}
    if b:
        factors["mirrors"] = _growth_by_mirrors(single, double, b)
    if i >= 0 and double.cos_view[b] > 0:
        factors["grazing"] = float(1 / double.cos_view[b])
    if abs(single.shine[b] - double.shine[b]) >= difference[b] / 2:
        factors["highlight exponent"] = float(double.steep[b])
    cause = max(factors, key=lambda name: factors[name])
    if factors[cause] <= _ORDINARY_GROWTH:
        return Explanation("rounding", factors[cause], scene.name(i), b)
    return Explanation(cause, factors[cause], scene.name(i), b)


def _growth_by_mirrors(single: RayRecord, double: RayRecord, b: int) -> float:
    """Returns the growth of the rounding errors of a mirrored ray's direction."""
    return float(np.abs(single.direction[b] - double.direction[b]).max() / _EPS)
