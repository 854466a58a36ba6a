"""The report of a study: figures, a table of all points, and a page that explains them."""

import csv
import dataclasses
import io
import math
import os
from pathlib import Path

from ..files.atomic import write_text
from ..study.benchmarks.captions import caption, seconds
from ..study.benchmarks.work_precision import Diagram, Point
from ..study.study import Study
from .report import new_figure, save_figure

_MARKERS = "os^vD<>pPX*"


def write_study(folder: str | os.PathLike[str], study: Study) -> list[Path]:
    """Writes `study.md`, `points.csv` and each diagram as PNG and SVG; makes the folder.

    **Returns:** the files written.

    **Raises:** `OSError` if the files cannot be written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / "study.md", folder / "points.csv"]
    for diagram in study.diagrams:
        figure = _growth(diagram) if not diagram.error else _work_precision(diagram)
        for ending in ("png", "svg"):
            files.append(folder / f"{diagram.name}.{ending}")
            save_figure(figure, files[-1])
            figure.set_layout_engine("none")  # the layout takes longest, and is done
    write_text(files[1], _points(study))
    write_text(files[0], _page(study))
    return files


def _points(study: Study) -> str:
    """Returns all points as comma-separated values, with the seed and the machine."""
    text = io.StringIO()
    names = [field.name for field in dataclasses.fields(Point)]
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow([*names, "seed", *study.machine])
    for diagram in study.diagrams:
        for point in diagram.points:
            values = (getattr(point, name) for name in names)
            rows.writerow([*values, study.settings.seed, *study.machine.values()])
    return text.getvalue()


def _page(study: Study) -> str:
    """Returns the page, in Markdown."""
    settings = study.settings
    about = ", ".join(f"{name} {value}" for name, value in study.machine.items())
    paragraphs = [
        "# Error against run time",
        f"Measured on {about}; highlights {settings.highlight}, bounces {settings.bounces}, seed "
        f"{settings.seed}. Times are medians of interleaved runs without compilation. "
        "Compilation times are listed apart, without programs that earlier methods of the same "
        "table had compiled. All points are in [points.csv](points.csv).",
    ]
    for diagram in study.diagrams:
        paragraphs += [
            f"## {diagram.title}",
            f"![{diagram.title}]({diagram.name}.png)",
            " ".join(caption(diagram)),
            f"Truth: {diagram.reference}." if diagram.error else f"{diagram.reference}.",
            _table(diagram),
        ]
    return "\n\n".join(paragraphs) + "\n"


def _table(diagram: Diagram) -> str:
    """Returns a table: for each method the ends of its curve, and the time of compilation."""
    if diagram.error:
        lines = ["| method | from | to | compilation |", "|---|---|---|---|"]
        say = lambda p: f"{p.error:.1e} in {seconds(p.seconds)} ({p.knob})"
    else:
        lines = ["| work | from | to | compilation |", "|---|---|---|---|"]
        say = lambda p: f"{seconds(p.seconds)}, {p.memory / 1e6:.3g} MB ({p.knob})"
    for method, points in diagram.curves.items():
        first, last = (seconds(points[k].compile_seconds) for k in (0, -1))
        compiling = first if first == last else f"{first} to {last}"
        lines.append(f"| {method} | {say(points[0])} | {say(points[-1])} | {compiling} |")
    return "\n".join(lines)


def _work_precision(diagram: Diagram):
    """Draws error against time."""
    figure = new_figure(8.0, 4.6)
    ax = figure.subplots()
    for (method, points), marker in zip(diagram.curves.items(), _MARKERS * 9, strict=False):
        ax.loglog(
            [p.seconds for p in points], [p.error for p in points], marker=marker, label=method,
            markersize=4,
        )  # fmt: skip
    if math.isfinite(diagram.uncertainty):
        ax.axhline(diagram.uncertainty, color="grey", linestyle=":", label="the truth is known to")
    ax.set(xlabel="seconds, without compilation", ylabel=diagram.error)
    _finish(figure, ax, diagram.title)
    return figure


def _growth(diagram: Diagram):
    """Draws time and memory against a size."""
    figure = new_figure(9.0, 3.8)
    time, memory = figure.subplots(1, 2)
    for work, points in diagram.curves.items():
        size = [p.size for p in points]
        time.loglog(size, [p.seconds for p in points], marker="o", label=work)
        memory.loglog(size, [p.memory / 1e6 for p in points], marker="o")
    time.set(xlabel=diagram.knob, ylabel="seconds")
    memory.set(xlabel=diagram.knob, ylabel="temporaries, MB")
    memory.grid(alpha=0.3)
    _finish(figure, time, diagram.title)
    return figure


def _finish(figure, ax, title: str) -> None:
    """Adds the title, the legend and a grid."""
    ax.grid(alpha=0.3, which="both")
    figure.suptitle(title)
    figure.legend(loc="outside right center", fontsize="small")
