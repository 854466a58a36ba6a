"""The light of one photograph of a ball: starts, models, and the choice among them."""

from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from ..base.errors import InputError
from .ball_photo import BallPhoto
from .ball_radiance import (
    HIGHEST,
    LOBES,
    LOWEST,
    WEIGHTINGS,
    BallSamples,
    LightModel,
    light_model,
)
from .highlights import brightest_spot
from .lambert import lambert_light
from .light_covariance import Covariance, facing, light_covariance
from .light_solver import LANES, LightFit, WeightedRows, solve_lights

Vector = Float[np.ndarray, "3"]

_PHONG, _HALFWAY, _BECKMANN, _GGX = range(len(LOBES))
_MATERIAL = slice(3, 6)  # the unknowns of the ball, not of the light

# Exponents of the starts: a broad, a usual and a sharp highlight. Inverse distance and coat of all.
_EXPONENTS, _NEARNESS, _COAT = (8.0, 60.0, 500.0), 0.1, 0.8

# The largest part of the cost that a light without fall-off may leave to be preferred: real lights
# fall off, the lecture's do not.
_CLEARLY_BETTER = 0.9

# The largest cost, in multiples of that of a light at some distance, with which a light at infinity
# explains the picture as well.
_AS_WELL = 1.25

# The part of all amplitudes from which a light is there at all, and no rounding.
_LEAST_LIGHT = 1e-5

# The least inverse distance that is one, in standard deviations; less is at infinity.
_NEAR = 2.0


class FoundLight(eqx.Module):
    """The light that was chosen, and its error."""

    fit: LightFit
    samples: BallSamples
    covariance: Covariance
    #: inverse distance in radii and its standard deviation, also where the light is at infinity
    nearness: tuple[float, float]

    @property
    def color(self) -> Vector:
        """Returns what a matt ball would show where it faces the light, in the samples' unit."""
        return np.asarray(self.fit.amplitudes, float)[:, 0] * facing(self.fit)

    @property
    def color_deviation(self) -> Vector:
        """Returns standard deviations of `color`."""
        return np.sqrt(np.diag(self.covariance)[3:])


class _Lane(eqx.Module):
    """A fit to be made: its model, its start and what is held."""

    model: LightModel
    start: Float[np.ndarray, "6"]
    held: Bool[np.ndarray, "6"]


def find_light(photo: BallPhoto) -> FoundLight:
    """Finds the light of a photograph of a ball.

    Six starts, from the highlight and from Lambert's law, by one model; then all models from the
    best; then other weights, and the light at infinity, which is preferred where the distance does
    not show.
    """
    samples = photo.samples
    starts = [
        _start(direction, _BECKMANN, exponent)
        for direction in _first_directions(photo)
        for exponent in _EXPONENTS
    ]
    best = best_of(solve_lanes(samples, starts))
    models = [(lobe, True) for lobe in range(len(LOBES))] + [(_PHONG, False), (_HALFWAY, False)]
    fits = solve_lanes(samples, [lane_from(best, lobe, falloff) for lobe, falloff in models])
    best, other = best_of(fits[: len(LOBES)]), best_of(fits[len(LOBES) :])
    best = other if other.cost < _CLEARLY_BETTER * best.cost else best
    return _choose(photo, samples, best, fits, False)


def find_again(photo: BallPhoto, known: FoundLight, material: LightFit) -> FoundLight:
    """Finds the light of a photograph once more, with another fit's highlight and coat."""
    fit = _with_material(known.fit, material)
    return _choose(photo, known.samples, fit, [known.fit], True)


def median_material(fits: Sequence[LightFit]) -> LightFit:
    """Returns a fit with the material that most fits tell of: the usual lobe, and its medians."""
    lobes = [(int(fit.model.lobe), bool(fit.model.falloff)) for fit in fits]
    usual = max(set(lobes), key=lobes.count)
    alike = [fit for fit, lobe in zip(fits, lobes, strict=True) if lobe == usual]
    middle = np.median([fit.unknowns for fit in alike], axis=0)
    return eqx.tree_at(lambda fit: fit.unknowns, alike[0], middle)


def _with_material(fit: LightFit, material: LightFit) -> LightFit:
    """Returns a fit's light with another fit's highlight and coat."""
    unknowns = np.asarray(fit.unknowns).copy()
    unknowns[_MATERIAL] = np.asarray(material.unknowns)[_MATERIAL]
    places = lambda fit: (fit.unknowns, fit.model.lobe, fit.model.falloff)
    model = material.model
    return eqx.tree_at(places, fit, (unknowns, model.lobe, model.falloff))


def _choose(
    photo: BallPhoto, samples: BallSamples, best: LightFit, fits: Sequence[LightFit], given: bool
) -> FoundLight:
    """Weighs a fit against others, and a light at some distance against one at infinity.

    **Arguments:** `fits`: by other models. `given`: whether the material stays as it is.
    """
    lobe, falloff = int(best.model.lobe), bool(best.model.falloff)
    held = np.zeros(6, bool)
    held[_MATERIAL] = given
    far = held.copy()
    far[2] = True
    weightings = range(len(WEIGHTINGS))
    lanes = [lane_from(best, lobe, falloff, w, held=h) for h in (held, far) for w in weightings]
    solved = solve_lanes(samples, lanes)
    near, infinite = solved[: len(WEIGHTINGS)], solved[len(WEIGHTINGS) :]
    amplitudes = near[0].amplitudes
    if not amplitudes[:, :2].sum() > _LEAST_LIGHT * amplitudes.sum():
        raise InputError("the pixels of the ball that count show no light: all are as dark")
    alike = [fit for fit in fits if bool(fit.model.falloff) == falloff]

    def covariance(chosen: Sequence[LightFit], held: Bool[np.ndarray, "6"]) -> Covariance:
        fit = chosen[0]
        unknowns = np.asarray(fit.unknowns, float)
        free = ~held & (unknowns > np.array(LOWEST)) & (unknowns < np.array(HIGHEST))
        free[2] = not held[2]  # how far at least a light at infinity is, tells its slope there
        rivals = [(other, 1.0) for other in chosen[1:]]
        rivals += [(other, float(other.cost / fit.cost)) for other in alike]
        return light_covariance(fit, samples, photo.chosen, free, rivals, photo.moved)

    spread = covariance(near, held)
    nearness = float(near[0].unknowns[2]), float(np.sqrt(spread[2, 2]))
    as_well = infinite[0].cost < _AS_WELL * near[0].cost
    if nearness[0] == 0 or (as_well and nearness[0] < _NEAR * nearness[1]):
        return FoundLight(infinite[0], samples, covariance(infinite, far), nearness)
    return FoundLight(near[0], samples, spread, nearness)


def _first_directions(photo: BallPhoto) -> list[Vector]:
    """Returns the directions to begin with: the highlight's, and that of Lambert's law."""
    found, failed = [], []
    pixels = photo.pixels
    level = np.min(photo.picture[~photo.counts & pixels.mask[..., None]], initial=np.inf)
    try:
        found.append(brightest_spot(photo.picture, photo.outline).direction)
    except InputError as error:
        failed.append(error)
    try:
        lit = lambert_light(photo.picture, pixels.normals, pixels.mask, level=float(level))
        found.append(lit.direction)
    except InputError as error:
        failed.append(error)
    if not found:
        raise failed[0]
    return [found[0], found[-1]]


def _start(direction: Vector, lobe: int, exponent: float) -> _Lane:
    start = np.array([0, 0, _NEARNESS, np.log10(exponent), _COAT, 0])
    return _Lane(light_model(direction, lobe), start, np.zeros(6, bool))


def lane_from(
    fit: LightFit,
    lobe: int,
    falloff: bool,
    weighting: int = 0,
    held: Bool[np.ndarray, "6"] | None = None,
) -> _Lane:
    """Returns a lane that goes on from a fit by another model."""
    start = np.asarray(fit.unknowns, float).copy()
    start[:2] = 0
    held = np.zeros(6, bool) if held is None else held
    start[2] = 0 if held[2] else start[2]
    return _Lane(light_model(np.asarray(fit.direction), lobe, falloff, weighting), start, held)


def solve_lanes(samples: BallSamples, lanes: Sequence[_Lane]) -> list[LightFit]:
    """Makes six fits at once. **Returns:** each."""
    if len(lanes) != LANES:
        raise ValueError(f"expected {LANES} lanes, got {len(lanes)}")
    start = np.stack([lane.start for lane in lanes])
    held = np.stack([lane.held for lane in lanes])
    largest = float(np.finfo(np.asarray(samples.values).dtype).max)
    lower = np.where(held, start, np.maximum(LOWEST, -largest))
    upper = np.where(held, start, np.minimum(HIGHEST, largest))
    models = jax.tree.map(lambda *x: np.stack(x), *(lane.model for lane in lanes))
    start, lower, upper = (x.astype(samples.values.dtype) for x in (start, lower, upper))
    fits = jax.tree.map(np.asarray, solve_lights(samples, models, start, lower, upper))
    return [jax.tree.map(lambda leaf, k=k: leaf[k], fits) for k in range(LANES)]


def best_of(fits: Sequence[LightFit]) -> LightFit:
    """Returns the fit of least cost among fits by the same weights."""
    return min(fits, key=lambda fit: float(fit.cost) if np.isfinite(fit.cost) else np.inf)


def unexplained_part(rows: WeightedRows, samples: BallSamples) -> float:
    """Returns which part of the rms of weighted values a fit leaves. **Arguments:** its `rows`."""
    values = np.asarray(samples.values, float) * rows.weights
    return float(np.linalg.norm(rows.residual) / max(np.linalg.norm(values), 1e-300))
