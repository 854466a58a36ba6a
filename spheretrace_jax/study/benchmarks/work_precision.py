"""Work-precision diagrams: error against run time, one curve per method.

A parameter of the method, its knob, is swept along the curve (Hairer, Norsett, Wanner, Solving
Ordinary Differential Equations I, 1993, section II.10). Run time does not include compilation.
"""

import dataclasses
import math
import statistics
import time
from collections.abc import Callable, Iterable
from typing import Any

import jax
import numpy as np

from ...xla.jit import compiler_options


@dataclasses.dataclass(frozen=True)
class Point:
    """One run of one method."""

    diagram: str
    method: str
    knob: str  #: the swept parameter, such as `samples 4`
    size: float  #: the knob's number
    dtype: str
    seconds: float  #: of one run, without compilation
    compile_seconds: float  #: of compilation; nan where another point includes it
    error: float  #: in the diagram's unit; nan where only time is measured
    memory: int  #: temporaries of the compiled program, bytes; 0 if unknown


@dataclasses.dataclass(frozen=True)
class Diagram:
    """Points of several methods for the same task."""

    name: str  #: of the figure's file
    title: str
    error: str  #: the error, with its unit; "" where time is shown against `knob`
    reference: str  #: description of the reference
    uncertainty: float  #: error of the reference; nan for exact references
    points: tuple[Point, ...]
    knob: str = "seconds"  #: label of the figure's horizontal axis

    @property
    def curves(self) -> dict[str, list[Point]]:
        """Returns the points of each method."""
        curves: dict[str, list[Point]] = {}
        for point in self.points:
            curves.setdefault(point.method, []).append(point)
        return curves


class Program:
    """A function compiled for its arguments, with its compilation time and memory."""

    def __init__(self, function: Callable, *arguments: Any):
        began = time.perf_counter()
        jitted = jax.jit(function, compiler_options=compiler_options())
        self._run = jitted.lower(*arguments).compile()
        self.compile_seconds = time.perf_counter() - began
        self._arguments = arguments
        analysis = self._run.memory_analysis()  # None on some devices
        self.memory = 0 if analysis is None else int(analysis.temp_size_in_bytes)

    def __call__(self, *arguments: Any) -> Any:
        """Calls the function. **Arguments:** by default those of the compilation."""
        return jax.block_until_ready(self._run(*(arguments or self._arguments)))


def clock(runs: dict[Any, Callable[[], Any]], seconds: float) -> dict[Any, float]:
    """Measures the median time of each run, interleaved, so that all meet the same machine load.

    **Arguments:** `runs`: compiled functions. `seconds`: the time for each function, which makes
    at least three runs, unless one run takes longer.

    **Returns:** seconds.
    """
    for run in runs.values():
        run()
    taken: dict[Any, list[float]] = {key: [] for key in runs}
    waiting = list(runs)
    while waiting:
        for key in waiting:
            began = time.perf_counter()
            runs[key]()
            taken[key].append(time.perf_counter() - began)
        spent = lambda key: sum(taken[key]) + statistics.median(taken[key]) > seconds
        enough = lambda key: spent(key) and (len(taken[key]) >= 3 or taken[key][0] > seconds)
        waiting = [key for key in waiting if not enough(key)]
    return {key: statistics.median(values) for key, values in taken.items()}


def relative(value: Any, truth: Any) -> float:
    """Returns the relative error in the L2 norm; the absolute one where the truth is 0."""
    size = float(np.linalg.norm(truth))
    return float(np.linalg.norm(np.asarray(value, float) - truth)) / (size or 1.0)


def slope(points: Iterable[tuple[float, float]]) -> float:
    """Fits the exponent p of y = c x^p by least squares; nan for fewer than two points."""
    kept = [(math.log(x), math.log(y)) for x, y in points if x > 0 and y > 0]
    if len({x for x, _ in kept}) < 2:
        return float("nan")
    x, y = np.array(kept).T
    return float(np.polyfit(x, y, 1)[0])
