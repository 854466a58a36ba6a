"""Captions: the conclusions of a diagram, in two sentences."""

import math

from .work_precision import Diagram, Point, slope

# Number of points, the largest of a sweep, from which exponents are fitted.
_FITTED_POINTS = 3


def caption(diagram: Diagram) -> tuple[str, str]:
    """Returns two sentences: the comparison of the methods, and the end of their curves."""
    return _growth(diagram) if not diagram.error else _work_precision(diagram)


def seconds(value: float) -> str:
    """Returns a time with its unit: us, ms or s."""
    if value < 1e-3:
        return f"{1e6 * value:.0f} us"
    return f"{1e3 * value:.3g} ms" if value < 1 else f"{value:.3g} s"


def _work_precision(diagram: Diagram) -> tuple[str, str]:
    """Compares the times of an error that half of the methods attain, and names the least error."""
    best = {name: min(points, key=lambda p: p.error) for name, points in diagram.curves.items()}
    order = sorted(best.values(), key=lambda p: p.error)
    # the error that half of the methods attain, and at least two methods if possible
    level = _rounded_up(order[max((len(order) - 1) // 2, min(1, len(order) - 1))].error)
    first = {name: _first_below(points, level) for name, points in diagram.curves.items()}
    fastest = sorted((p for p in first.values() if p), key=lambda p: p.seconds)
    times = ", ".join(f"{seconds(p.seconds)} with {p.method} ({p.knob})" for p in fastest[:4])
    failing = len(first) - len(fastest)
    others = f"; {failing} of {len(first)} methods do not come so near" if failing else ""
    end, error = order[0], diagram.uncertainty
    truth = f"; the truth itself is known to {error:.1e}" if math.isfinite(error) else ""
    return (
        f"An error of {level:.0e} takes {times}{others}.",
        f"The least error is {end.error:.1e}, of {end.method} ({end.knob}) "
        f"in {seconds(end.seconds)}{truth}.",
    )


def _growth(diagram: Diagram) -> tuple[str, str]:
    """Describes the growth of time at the large end, and the largest time and memory."""
    exponents, ends = [], []
    for work, points in diagram.curves.items():
        large = sorted(points, key=lambda p: p.size)[-_FITTED_POINTS:]
        power = slope((p.size, p.seconds) for p in large)
        exponents.append(f"of a {work} grows as ({diagram.knob})^{power:.2f}")
        last = large[-1]
        ends.append(
            f"a {work} takes {seconds(last.seconds)} and {last.memory / 1e6:.3g} MB of temporaries"
        )
    largest = max(diagram.points, key=lambda p: p.size)
    return (
        f"At the large end the time {', '.join(exponents)}.",
        f"With {largest.knob} {', '.join(ends)}.",
    )


def _first_below(points: list[Point], level: float) -> Point | None:
    """Finds the fastest point with at most an error of `level`."""
    below = [p for p in points if p.error <= level]
    return min(below, key=lambda p: p.seconds) if below else None


def _rounded_up(error: float) -> float:
    """Rounds up to one digit."""
    if not error > 0 or not math.isfinite(error):
        return error
    unit = 10.0 ** math.floor(math.log10(error))
    return math.ceil(error / unit - 1e-9) * unit
