"""Runs the whole catalogue and writes docs/extremes.md: `make extremes`."""

import sys
import warnings
from pathlib import Path
from types import ModuleType

import jax

TESTS = Path(__file__).parent.parent
PAGE = TESTS.parent / "docs" / "extremes.md"

HEAD = """# What happens at the extremes

Every line is a test (`tests/test_extremes.py`); `make extremes` runs them and writes this page.
A line gives the extreme input, the promise that must hold, and the measurement. ulp: a unit in the
last place of a number. eps: the relative distance of neighbouring numbers of a type.
"""


def table(module: ModuleType) -> tuple[str, bool]:
    """Writes a part of the catalogue as Markdown; also returns whether all its promises hold."""
    from extremes.case import cases

    title, _, about = (module.__doc__ or "").partition("\n")
    lines = [f"## {title.rstrip('.')}", about.strip(), ""]
    lines += ["| tried | promised | measured | from |", "|---|---|---|---|"]
    good = True
    for one in cases(module):
        print(one.tried, flush=True)
        try:
            measured = one.check()
        except AssertionError as error:
            good, measured = False, f"**broken**: {' '.join(str(error).split())}"
        cells = one.tried, one.promise, measured, one.source
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n", good


def main() -> None:
    sys.path.insert(0, str(TESTS))
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore")
    from extremes import PARTS

    tables, good = zip(*map(table, PARTS), strict=True)
    PAGE.write_text("\n".join([HEAD, *tables]))
    print(f"{PAGE}: {'all promises hold' if all(good) else 'NOT all promises hold'}")
    sys.exit(0 if all(good) else 1)


if __name__ == "__main__":
    main()
