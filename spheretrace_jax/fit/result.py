"""`Fit`: the result of a fit, and what is to be thought of it."""

import os
from functools import cached_property
from pathlib import Path

import equinox as eqx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, PyTree

from ..base.progress import working
from ..scene.scene import Scene
from .diagnosis.identifiability import Identifiability, identify
from .diagnosis.model_error import with_model_error
from .diagnosis.trust import Trust, judge, together
from .diagnosis.uncertainty import Uncertainty, estimate
from .model.constraints import objects_of
from .model.photo_noise import PhotoNoise
from .normal_equations.normal_equations import NormalEquations
from .problem.problem import Problem, normal_at
from .solver.driver import StoppedBy

#: The structured residual, as a part of a picture's root-mean-square, up to which a fit is usable:
#: 96 % of the picture's mean square are explained then.
TOLERANCE = 0.2

# Limit of the remarks in a fit's summary, in lines.
_MOST_REMARKS = 7

_STOPPED = {
    "interrupt": "interrupted",
    "callback": "stopped by the callback",
    "max_steps": "the maximum number of steps, max_steps, is reached",
}


class Fit(eqx.Module):
    """The result of a fit, and what is to be thought of it."""

    scenes: list[Scene]  #: the best scenes found, one for each picture
    exposures: list[Float[Array, " 3"]]  #: what each picture is multiplied by, per channel
    result: optx.RESULTS  #: whether the solver converged; a readable message if not
    steps: int  #: evaluations of the picture and its Jacobian, from all starts together
    cost: float  #: half the sum of the squared residuals
    #: the least so far, after every step; first those of wider pixels. Covered edges of shadows
    #: stay where lights were when the edges were traced, which may change costs by 1e-3 of them:
    #: when they are traced again costs are measured anew, and may be larger
    costs: tuple[float, ...]
    left_out: int  #: how many of the targets' numbers do not count: clipped, masked or too dark
    counted: int  #: how many do
    stopped_by: StoppedBy | None  #: what ended it before it was done; the scene is the best so far
    problem: Problem
    values: PyTree  #: the unknowns at the solution
    starts: list[Scene]  #: the scenes that were given, one for each picture
    noise_given: bool  #: whether residuals are multiples of a known noise
    brightest_given: bool = False  #: whether the user said from where on numbers are saturated
    tolerance: float = TOLERANCE  #: the part of the pictures that may be left unexplained

    def __str__(self) -> str:
        """Returns a summary of about ten lines; `repr` shows the whole pytree.

        It says whether to trust the fit, what was free, and what the pictures do not determine.
        """
        known, remarks = self.identifiability, together(self.trust.remarks)
        free = ", ".join(map(self._free_words, self.problem.parameters[0].free))
        lines = [
            self.trust.verdict,
            f"free: {free}; {known.rank} of {known.free} numbers determined",
        ]
        lines += remarks[:_MOST_REMARKS]
        if len(remarks) > _MOST_REMARKS:
            more = len(remarks) - _MOST_REMARKS
            lines.append(f"and {more} more remarks: print(found.trust)")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """Returns the verdict and the remarks beside a small picture, for notebooks."""
        from ..display.notebook import fit_html

        return fit_html(self)

    def _free_words(self, name: str) -> str:
        """Returns a name, and of how many objects it is free if not of all."""
        numbers = self.problem.parameters[0].free_numbers(name)
        if numbers.all():
            return name
        rows = numbers.reshape(len(numbers), -1).any(axis=1)
        return f"{name} of {np.count_nonzero(rows)} of {rows.size} {objects_of(name)}s"

    @property
    def scene(self) -> Scene:
        """Returns the best scene found; of several pictures the first one's."""
        return self.scenes[0]

    @property
    def exposure(self) -> Float[Array, " 3"]:
        """Returns what the picture is multiplied by, per channel; 1 unless it is free."""
        return self.exposures[0]

    @property
    def photo_noise(self) -> list[PhotoNoise]:
        """Returns each picture's noise as estimated by `noise="photo"`; else an empty list."""
        found = (target.photo_noise for target in self.problem.targets)
        return [PhotoNoise(*map(float, x)) for x in found if x is not None]

    @property
    def interrupted(self) -> bool:
        """Returns whether the user or the callback stopped it: the scene is the best so far."""
        return self.stopped_by in ("interrupt", "callback")

    @property
    def result_message(self) -> str:
        """Returns what stopped the fit, or why the solver did not converge."""
        if self.stopped_by and (self.interrupted or not self.converged):
            return _STOPPED[self.stopped_by]
        # more sentences follow, on root finding and linear solvers
        return " ".join(str(optx.RESULTS[self.result]).split()).split(". ")[0].rstrip(".")

    @property
    def converged(self) -> bool:
        """Returns whether no better scene is within the tolerance."""
        return bool(self.result == optx.RESULTS.successful)

    @cached_property
    def normal(self) -> NormalEquations:
        """Returns the normal equations at the solution."""
        return normal_at(self.problem, self.values)

    @cached_property
    def identifiability(self) -> Identifiability:
        """Returns what the pictures determine, and in words what they do not."""
        return identify(self.uncertainty)

    @cached_property
    def uncertainty(self) -> Uncertainty:
        """Returns how well the pictures determine the result, also where it explains them badly."""
        noise = 1.0 if self.noise_given else None
        white = estimate(self.problem, self.values, self.normal, noise)
        return with_model_error(white, self.normal)

    @cached_property
    def trust(self) -> Trust:
        """Returns whether the result is what it seems to be."""
        return judge(self)

    def report(self, path: str | os.PathLike[str]) -> list[Path]:
        """Writes a report: verdict, pictures, residual, cost, parameters with standard deviations.

        **Arguments:** `path`: a file that ends in `.html`, one page with its pictures inside; or a
        folder, which is made, for the page, a Markdown report and its pictures.

        **Returns:** the files written.

        **Raises:** `InputError` for other endings, `OSError` if a file cannot be written.
        """
        from ..display.fit_report import write_report

        with working("writing the report"):
            return write_report(path, self)
