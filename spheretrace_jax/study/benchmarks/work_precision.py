"""`Point` and `Diagram`: error against run time, in the manner of work-precision diagrams.

One curve per method, along which the method's own knob is swept (Hairer, Norsett, Wanner, Solving
Ordinary Differential Equations I, 1993, section II.10). Compilation is apart.
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
    knob: str  #: what was swept, such as `samples 4`
    size: float  #: its number
    dtype: str
    seconds: float  #: of one run, without compilation
    compile_seconds: float  #: what came before it, nan where that is part of another point's
    error: float  #: as the diagram says; nan where only time is measured
    memory: int  #: bytes of temporaries that the compiled program takes, 0 where not known


@dataclasses.dataclass(frozen=True)
class Diagram:
    """Points of several methods that do the same work."""

    name: str  #: of its figure's file
    title: str
    error: str  #: what the error is, with its unit; "" where time is shown against `knob`
    reference: str  #: what the truth is
    uncertainty: float  #: how far the truth itself may be off; nan where it is exact
    points: tuple[Point, ...]
    knob: str = "seconds"  #: what is along the figure's lower side

    @property
    def curves(self) -> dict[str, list[Point]]:
        """The points, method by method."""
        found: dict[str, list[Point]] = {}
        for point in self.points:
            found.setdefault(point.method, []).append(point)
        return found


class Program:
    """A function that is compiled at once for its arguments, timed and measured."""

    def __init__(self, function: Callable, *arguments: Any):
        began = time.perf_counter()
        jitted = jax.jit(function, compiler_options=compiler_options())
        self._run = jitted.lower(*arguments).compile()
        self.compile_seconds = time.perf_counter() - began
        self._arguments = arguments
        analysis = self._run.memory_analysis()  # None on some devices
        self.memory = 0 if analysis is None else int(analysis.temp_size_in_bytes)

    def __call__(self, *arguments: Any) -> Any:
        """What the function returns. **Arguments:** by default those that it was compiled for."""
        return jax.block_until_ready(self._run(*(arguments or self._arguments)))


def clock(works: dict[Any, Callable[[], Any]], seconds: float) -> dict[Any, float]:
    """Median seconds of a run of each: interleaved, so that all meet the same machine.

    **Arguments:** `works`: compiled already. `seconds`: for each of them, at least three runs
    unless one takes as long.
    """
    for work in works.values():
        work()
    taken: dict[Any, list[float]] = {key: [] for key in works}
    waiting = list(works)
    while waiting:
        for key in waiting:
            began = time.perf_counter()
            works[key]()
            taken[key].append(time.perf_counter() - began)
        spent = lambda key: sum(taken[key]) + statistics.median(taken[key]) > seconds
        enough = lambda key: spent(key) and (len(taken[key]) >= 3 or taken[key][0] > seconds)
        waiting = [key for key in waiting if not enough(key)]
    return {key: statistics.median(values) for key, values in taken.items()}


def relative(value: Any, truth: Any) -> float:
    """The relative error in the L2 norm; absolute where the truth is 0."""
    size = float(np.linalg.norm(truth))
    return float(np.linalg.norm(np.asarray(value, float) - truth)) / (size or 1.0)


def slope(points: Iterable[tuple[float, float]]) -> float:
    """The exponent p of y = c x^p, by least squares; nan of fewer than two points."""
    kept = [(math.log(x), math.log(y)) for x, y in points if x > 0 and y > 0]
    if len({x for x, _ in kept}) < 2:
        return float("nan")
    x, y = np.array(kept).T
    return float(np.polyfit(x, y, 1)[0])
