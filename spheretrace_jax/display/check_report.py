"""The report of a check: derivatives, rounding and the conditioning of a fit, as tables."""

from collections.abc import Sequence
from html import escape
from typing import NamedTuple

from ..study.checks.condition import Condition
from ..study.checks.gradients import GradientTable
from ..study.checks.stability import StabilityTable
from . import page

# Limit of the pixels shown, the worst first.
_MOST_PIXELS = 10


class CheckSection(NamedTuple):
    """What one check found."""

    ok: bool
    verdict: str  #: one sentence
    columns: tuple[str, ...]
    rows: list[tuple[str, ...]]  #: none: there is no table
    remarks: tuple[str, ...]


def check_sections(
    gradients: GradientTable, stability: StabilityTable, condition: Condition
) -> list[CheckSection]:
    """Returns what the three checks found."""
    return [_gradients(gradients), _stability(stability), _condition(condition)]


def check_page(title: str, sections: Sequence[CheckSection]) -> str:
    """Returns one HTML page, which needs no network."""
    parts = []
    for section in sections:
        parts.append(page.verdict(section.verdict, "good" if section.ok else "not to be used"))
        if section.rows:
            cells = [list(map(escape, row)) for row in section.rows]
            parts.append(page.table(section.columns, cells))
        parts.append(page.listed(section.remarks))
    return page.page(title, *parts)


def _gradients(table: GradientTable) -> CheckSection:
    """Returns the agreement of the derivatives."""
    agreement = "agree" if table.ok else "do NOT agree"
    return CheckSection(
        table.ok,
        f"derivatives: forward mode, reverse mode and differences {agreement}",
        (*table.columns, "agree"),
        [(*table.cells(row), "yes" if row.agree else "NO") for row in table.rows],
        table.words,
    )


def _stability(table: StabilityTable) -> CheckSection:
    """Returns the differences between float32 and float64."""
    agreement = "shows the same" if table.ok else "does NOT show the same"
    rows = [
        (
            str(row.column), str(row.row), f"{row.error:.1e}", f"{row.ulps:.0f}",
            row.cause, f"{row.factor:.1g}", row.place,
        )
        for row in table.rows[:_MOST_PIXELS]
    ]  # fmt: skip
    return CheckSection(
        table.ok,
        f"float32 {agreement} as float64: median error {table.median:.1e}, "
        f"largest {table.largest:.1e}; {table.shown} of {table.pixels} pixels "
        f"({table.share:.2g} of the picture) are off by more than {table.limit:.1e}",
        ("column", "row", "error", "ulps", "cause", "factor", "where"),
        rows,
        table.warnings,
    )


def _condition(condition: Condition) -> CheckSection:
    """Returns the conditioning of a fit."""
    agreement = "is well conditioned" if condition.ok else "is NOT well conditioned"
    return CheckSection(
        condition.ok,
        f"a fit of {', '.join(condition.names)} {agreement}: {condition.rank} of {condition.free} "
        f"free numbers are determined, condition number {condition.number:.1e}",
        (),
        [],
        condition.warnings,
    )
