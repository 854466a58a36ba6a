"""The checks of `spheretrace check`: derivatives, rounding, and the conditioning of a fit."""

from collections.abc import Sequence
from typing import Any

from ..base.progress import working
from ..display.check_report import CheckSection, check_sections
from ..scene.needs import needs
from ..scene.scene import Scene
from ..study.checks.condition import check_condition
from ..study.checks.gradients import check_gradients, present
from ..study.checks.stability import check_stability
from .info import print_table


def check(
    scene: Scene, free: Sequence[str] | None, second: bool, **picture: Any
) -> list[CheckSection]:
    """Checks a scene.

    **Arguments:** `free`: the free parameters of a fit, by default those of `fit`. `picture`: size,
    highlight, bounces and samples, as for `render`. `second`: whether second derivatives are
    checked too.

    **Returns:** what is found: whether derivatives agree, whether float32 shows the same picture as
    float64, and whether a fit would be well conditioned.
    """
    known = needs(scene, free=present(scene))  # one for all checks, which then share programs
    # first, as this check fails at once for unknown names
    with working("what a fit would find"):
        condition = check_condition(scene, free=free, needs=known, **picture)
    with working("float32 against float64"):
        stability = check_stability(scene, needs=known, **picture)
    with working("derivatives, forwards, backwards and by differences"):
        gradients = check_gradients(scene, needs=known, every=False, second=second, **picture)
    return check_sections(gradients, stability, condition)


def print_sections(sections: Sequence[CheckSection]) -> None:
    """Prints what the checks found."""
    for k, section in enumerate(sections):
        print("\n" * bool(k) + section.verdict)
        if section.rows:
            print_table(section.columns, section.rows)
        for remark in section.remarks:
            print(remark)
