"""What a diagram says, in two sentences."""

import math

from .work_precision import Diagram, Point, slope

#: Of the sweeps, the part at the large end from which exponents are fitted.
_LARGE = 3


def caption(diagram: Diagram) -> tuple[str, str]:
    """Two sentences: how the methods compare, and where they end."""
    return _growth(diagram) if not diagram.error else _work_precision(diagram)


def seconds(value: float) -> str:
    """A time as people say it."""
    if value < 1e-3:
        return f"{1e6 * value:.0f} us"
    return f"{1e3 * value:.3g} ms" if value < 1 else f"{value:.3g} s"


def _work_precision(diagram: Diagram) -> tuple[str, str]:
    best = {name: min(points, key=lambda p: p.error) for name, points in diagram.curves.items()}
    order = sorted(best.values(), key=lambda p: p.error)
    # what half of the methods reach, and at least two if there are
    level = _rounded_up(order[max((len(order) - 1) // 2, min(1, len(order) - 1))].error)
    first = {name: _first_below(points, level) for name, points in diagram.curves.items()}
    reach = sorted((p for p in first.values() if p), key=lambda p: p.seconds)
    times = ", ".join(f"{seconds(p.seconds)} with {p.method} ({p.knob})" for p in reach[:4])
    short = len(first) - len(reach)
    others = f"; {short} of {len(first)} methods do not come so near" if short else ""
    end = order[0]
    known = diagram.uncertainty
    truth = f"; the truth itself is known to {known:.1e}" if math.isfinite(known) else ""
    return (
        f"An error of {level:.0e} takes {times}{others}.",
        f"The least error is {end.error:.1e}, of {end.method} ({end.knob}) "
        f"in {seconds(end.seconds)}{truth}.",
    )


def _growth(diagram: Diagram) -> tuple[str, str]:
    exponents, ends = [], []
    for work, points in diagram.curves.items():
        large = sorted(points, key=lambda p: p.size)[-_LARGE:]
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
    below = [p for p in points if p.error <= level]
    return min(below, key=lambda p: p.seconds) if below else None


def _rounded_up(error: float) -> float:
    """The next number of one digit."""
    if not error > 0 or not math.isfinite(error):
        return error
    unit = 10.0 ** math.floor(math.log10(error))
    return math.ceil(error / unit - 1e-9) * unit
