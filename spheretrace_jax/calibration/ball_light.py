"""`BallLight`: a light that a photograph of a ball tells of, with its error and a verdict."""

from typing import Literal

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .ball_photo import BallPhoto
from .ball_radiance import LOBES
from .camera import Number, flip_frame
from .conic import BallOutline
from .highlights import Spot
from .light_covariance import confidence_radius
from .light_fit import FoundLight, unexplained_part
from .light_solver import rows_at

Vector = Float[np.ndarray, "3"]

Grade = Literal["good", "usable", "not to be used"]

# The error of a direction, in degrees, and the unexplained part of the picture's rms, up to which a
# light is good and usable.
_GRADES: tuple[tuple[Grade, float, float], ...] = (("good", 3.0, 0.1), ("usable", 15.0, 0.4))

# The part of the ball's pixels from which it is said that they do not count.
_MANY_LEFT_OUT = 0.1

# Standard deviations of the one-sided 95 % limit of a Gaussian.
_ONE_SIDED = 1.645


class BallLight(eqx.Module):
    """A light, as seen from a ball's centre.

    Directions are in the frame of photometric stereo: x right, y up, z toward the viewer.
    Distances are in the unit of the ball's radius that was given, 1 by default.
    """

    name: str  #: of the photograph
    direction: Vector  #: unit vector from the ball's centre to the light
    error: float  #: the radius around `direction` that holds the light with 95 %, degrees
    distance: float  #: from the ball's centre; infinite where none shows
    least_distance: float  #: the one-sided 95 % limit: the light is further away than this
    most_distance: float  #: likewise, infinite where no limit shows
    #: red, green and blue of the light at the ball, if the ball's own colour is `albedo`; the
    #: linear picture's unit. nan of a mirroring ball
    color: Vector
    color_error: Vector  #: standard deviations of `color`
    unexplained: float  #: part of the rms of the ball's pixels that the fit leaves
    grade: Grade
    remarks: tuple[str, ...]  #: what to know before it is used
    outline: BallOutline
    found: FoundLight | None  #: the fit; None of a mirroring ball
    ambient: Vector  #: what the ball shows without the light
    highlight: Vector  #: peak of the highlight, as bright as the light is at the centre

    @property
    def at_infinity(self) -> bool:
        """Tells whether the picture says nothing of the distance."""
        return bool(np.isinf(self.distance))

    def __str__(self) -> str:
        """Returns a line: direction, error, distance, grade and remarks."""
        x, y, z = self.direction
        far = f"at infinity, at least {self.least_distance:.3g} away"
        if not self.at_infinity:
            most = f"to {self.most_distance:.3g}" if np.isfinite(self.most_distance) else "or more"
            far = f"{self.distance:.4g} away ({self.least_distance:.3g} {most})"
        line = f"{self.name}: ({x:+.4f}, {y:+.4f}, {z:+.4f}) +- {self.error:.2f} deg, {far}; "
        return line + "; ".join((self.grade, *self.remarks))

    def record(self) -> dict[str, object]:
        """Returns the columns of lights.csv."""
        return {
            "name": self.name,
            "direction": self.direction,
            "error_degrees": self.error,
            "distance": self.distance,
            "least_distance": self.least_distance,
            "most_distance": self.most_distance,
            "color": self.color,
            "color_error": self.color_error,
            "unexplained": self.unexplained,
            "grade": self.grade,
        }


def light_of_fit(
    name: str,
    photo: BallPhoto,
    found: FoundLight,
    albedo: Vector,
    radius: Number,
    better: str | None = None,
) -> BallLight:
    """Makes the light of a fit.

    **Arguments:** `radius`: of the ball, in the unit of distances. `better`: as what the numbers
    fit better.
    """
    fit = found.fit
    error = float(np.degrees(confidence_radius(found.covariance[:2, :2])))
    nearness, deviation = found.nearness
    distance = 1 / float(fit.unknowns[2]) if fit.unknowns[2] > 0 else np.inf
    least = 1 / (nearness + _ONE_SIDED * deviation) if nearness + deviation > 0 else np.inf
    beyond = nearness - _ONE_SIDED * deviation
    amplitudes = np.asarray(fit.amplitudes, float) * photo.level
    rows = rows_at(fit, found.samples)
    unexplained = unexplained_part(rows, found.samples)
    weights = np.where(rows.weights > 0, rows.weights, np.inf)
    shine = np.asarray(rows.terms, float)[:, 1] / weights
    direction, brightest = np.asarray(fit.direction, float), int(shine.max(axis=0).argmax())
    normal = np.asarray(found.samples.normals, float)[:, brightest]
    # as bright as at the ball's centre: points that are closer to the light are brighter
    closer = np.sum((direction - float(fit.unknowns[2]) * normal) ** 2)
    peak = shine[:, brightest].max() * (closer if fit.model.falloff else 1)
    remarks = []
    share = 1 - photo.counts.any(axis=2).sum() / max(photo.pixels.mask.sum(), 1)
    if share > _MANY_LEFT_OUT:
        remarks.append(f"{share:.0%} of the ball do not count")
    if unexplained > _GRADES[0][2]:
        remarks.append(f"{unexplained:.0%} of the ball's brightness is not explained")
    if better is not None:
        remarks.append(f"it fits better if its numbers are taken as {better}")
    return BallLight(
        name,
        flip_frame(direction),
        error,
        distance * radius,
        min(least, distance) * radius,
        (1 / beyond if beyond > 0 else np.inf) * radius,
        found.color * photo.level / albedo,
        found.color_deviation * photo.level / albedo,
        unexplained,
        _grade(error, unexplained),
        tuple(remarks),
        photo.outline,
        found,
        amplitudes[:, 2],
        amplitudes[:, 1] * peak,
    )


def light_of_spot(name: str, spot: Spot, outline: BallOutline, radius: Number) -> BallLight:
    """Makes the light of a spot on a mirroring ball.

    A light at d radii is seen from the centre up to 1/d radians elsewhere than from the spot.
    """
    error = float(np.degrees(_radius_of(spot)))
    unknown = np.full(3, np.nan)
    return BallLight(
        name,
        flip_frame(spot.direction),
        error,
        np.inf,
        1.0 * radius,
        np.inf,
        unknown,
        unknown,
        0.0,
        _grade(error, 0.0),
        ("seen from the spot: a mirror does not tell the distance",),
        outline,
        None,
        unknown,
        unknown,
    )


def _radius_of(spot: Spot) -> float:
    """Returns the radius of 95 % of a spot's direction, in radians."""
    vectors = np.linalg.svd(spot.direction[None])[2][1:]
    return confidence_radius(vectors @ spot.covariance @ vectors.T)


def _grade(error: float, unexplained: float) -> Grade:
    for grade, most, left in _GRADES:
        if error <= most and unexplained <= left:
            return grade
    return "not to be used"


def lobe_name(light: BallLight) -> str:
    """Returns the shape of the highlight that was found, or `mirror`."""
    return "mirror" if light.found is None else LOBES[int(light.found.fit.model.lobe)]
