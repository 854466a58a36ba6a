"""The report of `spheretrace check`: derivatives, rounding, and the conditioning of a fit."""

from collections.abc import Sequence
from typing import Any

from ..scene.needs import needs
from ..scene.scene import Scene
from ..study.checks.condition import Condition, check_condition
from ..study.checks.gradients import GradientTable, check_gradients, present
from ..study.checks.stability import StabilityTable, check_stability
from .info import print_table
from .progress import busy

# Limit of the pixels shown, the worst first.
_MOST_PIXELS = 10


def check(scene: Scene, free: Sequence[str] | None, second: bool, **picture: Any) -> bool:
    """Checks a scene and prints the results, check by check.

    **Arguments:** `free`: the free parameters of a fit, by default those of `fit`. `picture`: size,
    highlight, bounces and samples, as for `render`. `second`: whether second derivatives are
    checked too.

    **Returns:** True if derivatives agree, float32 shows the same picture as float64, and a fit
    would be well conditioned.
    """
    known = needs(scene, free=present(scene))  # one for all checks, which then share programs
    # first, as this check fails at once for unknown names
    with busy("what a fit would find"):
        condition = check_condition(scene, free=free, needs=known, **picture)
    with busy("float32 against float64"):
        stability = check_stability(scene, needs=known, **picture)
    with busy("derivatives, forwards, backwards and by differences"):
        gradients = check_gradients(scene, needs=known, every=False, second=second, **picture)
    _print_gradients(gradients)
    _print_stability(stability)
    _print_condition(condition)
    return gradients.ok and stability.ok and condition.ok


def _print_gradients(table: GradientTable) -> None:
    """Prints the agreement of the derivatives."""
    agreement = "agree" if table.ok else "do NOT agree"
    _print_lines(f"derivatives: forward mode, reverse mode and differences {agreement}")
    rows = [(*table.cells(row), "yes" if row.agree else "NO") for row in table.rows]
    print_table((*table.columns, "agree"), rows)
    _print_lines(*table.words, "")


def _print_stability(table: StabilityTable) -> None:
    """Prints the differences between float32 and float64."""
    agreement = "shows the same" if table.ok else "does NOT show the same"
    _print_lines(
        f"float32 {agreement} as float64: median error {table.median:.1e}, "
        f"largest {table.largest:.1e}; {table.shown} of {table.pixels} pixels "
        f"({table.share:.2g} of the picture) are off by more than {table.limit:.1e}"
    )
    rows = [
        (
            str(row.column), str(row.row), f"{row.error:.1e}", f"{row.ulps:.0f}",
            row.cause, f"{row.factor:.1g}", row.place,
        )
        for row in table.rows[:_MOST_PIXELS]
    ]  # fmt: skip
    if rows:
        print_table(("column", "row", "error", "ulps", "cause", "factor", "where"), rows)
    _print_lines(*table.warnings, "")


def _print_condition(condition: Condition) -> None:
    """Prints the conditioning of a fit."""
    agreement = "is well conditioned" if condition.ok else "is NOT well conditioned"
    _print_lines(
        f"a fit of {', '.join(condition.names)} {agreement}: {condition.rank} of {condition.free} "
        f"free numbers are determined, condition number {condition.number:.1e}",
        *condition.warnings,
    )


def _print_lines(*lines: str) -> None:
    """Prints lines."""
    print(*lines, sep="\n")
