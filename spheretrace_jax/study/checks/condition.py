"""`Condition`: what a scene's own picture would tell a fit of it, and how well."""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from ...base.errors import InputError
from ...base.types import Highlight, Picture
from ...fit.diagnosis.identifiability import identify
from ...fit.diagnosis.trust import together
from ...fit.diagnosis.uncertainty import Uncertainty, estimate
from ...fit.fit import DEFAULT_FREE
from ...fit.model.parameters import GEOMETRY, value
from ...fit.model.products import PRODUCTS
from ...fit.problem.labels import labels_of
from ...fit.problem.make_problem import make_problem
from ...fit.problem.problem import normal_at
from ...rendering.render import draw
from ...scene.needs import Needs
from ...scene.scene import Scene
from ...scene.settings import render_settings

# Unknowns, which are of order one, that are known to no better than this are worth a word.
_WORTH = 1e-2

# A condition number above this: float32 has no digits left for the smallest singular value.
_BAD = 1e4


@dataclasses.dataclass(frozen=True)
class Condition:
    """How well a scene's picture determines what is free. `print` shows it in words."""

    names: tuple[str, ...]  #: what is free
    free: int  #: how many numbers that is
    rank: int  #: how many independent combinations of them show
    number: float  #: of J with columns of length 1, in the directions that show
    undetermined: tuple[str, ...]  #: what does not show at all, a sentence for each reason
    noise: float  #: the noise of the picture's numbers that the next is for
    loose: dict[str, float]  #: the unknowns that would be known to 1e-2 of their size or worse

    @property
    def ok(self) -> bool:
        """Whether float32 would do for the fit."""
        return self.number <= _BAD

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to know, in words."""
        words = together(self.undetermined)
        if self.number > _BAD:
            words.append(
                f"the fit's condition number is {self.number:.0e}: fit it in float64 "
                "(--dtype float64)"
            )
        if self.loose:
            worst = sorted(self.loose, key=lambda name: -self.loose[name])
            more = f" and {len(worst) - 5} more" if len(worst) > 5 else ""
            words.append(
                f"at noise {self.noise:g} these would be known to no better than {_WORTH:g}:"
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
    free: Sequence[str] | None = None,
    width: int = 64,
    height: int = 64,
    highlight: Highlight = "phong",
    bounces: int = 5,
    samples: int = 1,
    needs: Needs | None = None,
    noise: float = 1e-3,
) -> Condition:
    """What a fit to the scene's own picture determines at the scene itself, in float64.

    Unless centers, radii or the camera are free, of a picture of single rays.

    **Arguments:** `free`: as for `fit`; by default its own, as far as the scene has them. `noise`:
    of the picture's numbers. The others as for `render`.

    **Raises:** `InputError` for unknown names, and if nothing can be free.
    """
    with jax.enable_x64(True):
        scene = scene.astype(jnp.float64)
        if free is None:
            free = [name for name in DEFAULT_FREE if value(scene, name).size]
        if not free:
            raise InputError("the scene has neither spheres nor lights: nothing can be free")
        if not GEOMETRY & set(free):
            # edges say little of colours and lights; their Jacobian takes two minutes to compile
            scene = scene.with_antialias(0)
        drawn = render_settings(scene, width, height, highlight, bounces, samples, needs)
        picture = draw(scene, drawn)
        uncertainty = uncertainty_at(
            scene, picture, tuple(free), noise, highlight, bounces, samples
        )
        return _condition(uncertainty, tuple(free), noise)


def uncertainty_at(
    scene: Scene,
    picture: Picture,
    free: tuple[str, ...],
    noise: float,
    highlight: Highlight,
    bounces: int,
    samples: int = 1,
) -> Uncertainty:
    """How well a scene's own picture determines it, with so much noise."""
    problem = make_problem(
        scene, picture, free, highlight=highlight, bounces=bounces, samples=samples, noise=noise
    )
    values = problem.start()
    return estimate(problem, values, normal_at(problem, values), 1.0)


def _condition(uncertainty: Uncertainty, free: tuple[str, ...], noise: float) -> Condition:
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
    """What is determined, but to no better than a hundredth: ka color and kd color together, as
    their common scale never shows.
    """
    names, known = labels_of(uncertainty.problem), uncertainty.of_unknowns
    deviations = dict(zip(names.tolist(), known.tolist(), strict=True))
    for k in ("ka", "kd"):
        if {"color", k} <= free:
            deviations |= {
                f"sphere {i + 1}'s {k} color": float(np.max(row))
                for i, row in enumerate(uncertainty.of(PRODUCTS[f"{k}*color"]))
            }
    return {name: x for name, x in deviations.items() if _WORTH < x < np.inf}
