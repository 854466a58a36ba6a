"""`Condition`: the conditioning of a fit to a scene's own picture."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from ...base.errors import InputError
from ...base.types import Highlight, Picture
from ...fit.diagnosis.identifiability import identify
from ...fit.diagnosis.trust import together
from ...fit.diagnosis.uncertainty import Uncertainty, estimate
from ...fit.model.accessors import GEOMETRY, default_free, value
from ...fit.model.products import PRODUCTS
from ...fit.problem.labels import labels_of
from ...fit.problem.make_problem import make_problem
from ...fit.problem.problem import normal_at
from ...rendering.render import draw
from ...scene.needs import Needs
from ...scene.scene import Scene, check_scene
from .settings import double_settings

# Standard deviation from which an unknown counts as loosely determined, and is named in a warning.
# Unknowns are of order one.
_LOOSE = 1e-2

# Largest condition number that counts as good. Above it, float32 has no digits left for the
# smallest singular value.
_LARGEST_CONDITION = 1e4


@dataclasses.dataclass(frozen=True)
class Condition:
    """The conditioning of a scene's free parameters. `print` shows it in words."""

    names: tuple[str, ...]  #: the free parameters
    free: int  #: number of free unknowns
    rank: int  #: number of independent combinations that the picture determines
    number: float  #: condition number of J, its columns of length 1, in those combinations
    undetermined: tuple[str, ...]  #: the undetermined unknowns, a sentence for each reason
    noise: float  #: standard deviation of the picture's noise, for `loose`
    loose: dict[str, float]  #: unknowns with deviations above 1e-2

    @property
    def ok(self) -> bool:
        """Tells whether float32 suffices for the fit."""
        return self.number <= _LARGEST_CONDITION

    @property
    def warnings(self) -> tuple[str, ...]:
        """Returns the weaknesses of the fit, in words."""
        words = together(self.undetermined)
        if self.number > _LARGEST_CONDITION:
            words.append(
                f"the fit's condition number is {self.number:.0e}: fit it in float64 "
                "(--dtype float64)"
            )
        if self.loose:
            worst = sorted(self.loose, key=lambda name: -self.loose[name])
            more = f" and {len(worst) - 5} more" if len(worst) > 5 else ""
            words.append(
                f"at noise {self.noise:g} these would be known to no better than {_LOOSE:g}:"
                f"  {', '.join(worst[:5])}{more} "
                f"({self.loose[worst[0]]:.1g} at worst)"
            )
        return tuple(words)

    def __str__(self) -> str:
        first = (
            f"{self.rank} of {self.free} free numbers are determined, condition number "
            f"{self.number:.1e}"
        )
        return "\n".join([first, *self.warnings])


def check_condition(
    scene: Scene,
    *,
    free: str | Sequence[str] | None = None,
    width: int = 64,
    height: int = 64,
    highlight: Highlight = "phong",
    bounces: int = 5,
    samples: int = 1,
    needs: Needs | None = None,
    noise: float = 1e-3,
) -> Condition:
    """Computes what a fit to the scene's own picture determines at the scene itself, in float64.

    The picture is one of single rays, unless centers, radii or the camera are free.

    **Arguments:** `free`: as for `fit`; by default those of `fit` that the scene has. `noise`: the
    standard deviation of the picture's numbers. The other arguments are those of `render`.

    **Raises:** `InputError` for unknown names, and if the scene has no parameter to set free.
    """
    scene = check_scene(scene)
    with jax.enable_x64(True):
        if free is None:
            free = [name for name in default_free(scene) if value(scene, name).size]
        if not free:
            raise InputError("the scene has neither spheres nor lights: nothing can be free")
        if not GEOMETRY & set(free):
            # edges say little of colours and lights; their Jacobian takes two minutes to compile
            scene = scene.with_antialias(0)
        drawn: dict[str, Any] = dict(highlight=highlight, bounces=bounces, samples=samples)
        scene, settings = double_settings(scene, width, height, needs=needs, **drawn)
        picture, names = draw(scene, settings), tuple(free)
        return _condition(uncertainty_at(scene, picture, names, noise, **drawn), names, noise)


def uncertainty_at(
    scene: Scene,
    picture: Picture,
    free: tuple[str, ...],
    noise: float,
    *,
    highlight: Highlight,
    bounces: int,
    samples: int = 1,
) -> Uncertainty:
    """Estimates the uncertainty of a scene from its own picture.

    **Arguments:** `free`: the free parameters. `noise`: the standard deviation of the picture's
    numbers. The other arguments are those of `render`.
    """
    problem = make_problem(
        scene, picture, free, highlight=highlight, bounces=bounces, samples=samples,
        noise=noise,
    )  # fmt: skip
    values = problem.start()
    return estimate(problem, values, normal_at(problem, values), 1.0)


def _condition(uncertainty: Uncertainty, free: tuple[str, ...], noise: float) -> Condition:
    """Summarizes an uncertainty."""
    known = identify(uncertainty)
    shown = known.singular_values[: known.rank]
    return Condition(
        names=free,
        free=known.free,
        rank=known.rank,
        number=float(shown[0] / shown[-1]) if known.rank else 1.0,
        undetermined=known.undetermined,
        noise=noise,
        loose=_loose(uncertainty, set(free)),
    )


def _loose(uncertainty: Uncertainty, free: set[str]) -> dict[str, float]:
    """Lists the loosely determined unknowns, with their standard deviations.

    Products ka color and kd color count as one unknown each, as no picture determines their common
    scale.
    """
    names, known = labels_of(uncertainty.problem), uncertainty.of_unknowns
    deviations = dict(zip(names.tolist(), known.tolist(), strict=True))
    for k in ("ka", "kd"):
        if {"color", k} <= free:
            deviations |= {
                f"sphere {i + 1}'s {k} color": float(np.max(row))
                for i, row in enumerate(uncertainty.of(PRODUCTS[f"{k}*color"]))
            }
    return {name: x for name, x in deviations.items() if _LOOSE < x < np.inf}
