"""The report of a study: figures, a table of all points, and a page that explains them."""

import csv
import dataclasses
import io
import math
import os
from html import escape
from pathlib import Path

from ..files.atomic import write_text
from ..study.benchmarks.captions import caption, seconds
from ..study.benchmarks.work_precision import Diagram, Point
from ..study.study import Study
from . import page
from .figures import figure_png, new_figure, save_figure

_MARKERS = "os^vD<>pPX*"


def write_study(folder: str | os.PathLike[str], study: Study) -> list[Path]:
    """Writes `study.md`, `points.csv`, each diagram as PNG and SVG, and one page, `study.html`.

    The folder is made. The page holds its figures and needs no network.

    **Returns:** the files written.

    **Raises:** `OSError` if the files cannot be written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / name for name in ("study.md", "points.csv", "study.html")]
    parts = [page.paragraph(_about(study))]
    for diagram in study.diagrams:
        figure = _growth(diagram) if not diagram.error else _work_precision(diagram)
        for ending in ("png", "svg"):
            files.append(folder / f"{diagram.name}.{ending}")
            save_figure(figure, files[-1])
            figure.set_layout_engine("none")  # the layout takes longest, and is done
        parts += _html(diagram, figure_png(figure))
    write_text(files[1], _points(study))
    write_text(files[0], _page(study))
    write_text(files[2], page.page("Error against run time", *parts))
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
    paragraphs = ["# Error against run time", f"{_about(study)} All points: [csv](points.csv)."]
    for diagram in study.diagrams:
        paragraphs += [
            f"## {diagram.title}",
            f"![{diagram.title}]({diagram.name}.png)",
            " ".join(caption(diagram)),
            _truth(diagram),
            "\n".join(f"| {' | '.join(row)} |" for row in _table(diagram, rule="---")),
        ]
    return "\n\n".join(paragraphs) + "\n"


def _html(diagram: Diagram, png: bytes) -> list[str]:
    """Returns a diagram's part of the page, in HTML."""
    head, *rows = _table(diagram)
    return [
        page.heading(diagram.title),
        page.image(png, diagram.title),
        page.paragraph(" ".join([*caption(diagram), _truth(diagram)])),
        page.table(head, [list(map(escape, row)) for row in rows]),
    ]


def _about(study: Study) -> str:
    """Returns words for the machine, the settings and how times are measured."""
    settings = study.settings
    about = ", ".join(f"{name} {value}" for name, value in study.machine.items())
    return (
        f"Measured on {about}; highlights {settings.highlight}, bounces {settings.bounces}, seed "
        f"{settings.seed}. Times are medians of interleaved runs without compilation. "
        "Compilation times are listed apart, without programs that earlier methods of the same "
        "table had compiled."
    )


def _truth(diagram: Diagram) -> str:
    return f"Truth: {diagram.reference}." if diagram.error else f"{diagram.reference}."


def _table(diagram: Diagram, rule: str = "") -> list[tuple[str, ...]]:
    """Returns a table: for each method the ends of its curve, and the time of compilation.

    **Arguments:** `rule`: the cells of a row below the head, if there is one.
    """
    rows = [("method" if diagram.error else "work", "from", "to", "compilation")]
    rows += [(rule,) * 4] * bool(rule)
    if diagram.error:
        say = lambda p: f"{p.error:.1e} in {seconds(p.seconds)} ({p.knob})"
    else:
        say = lambda p: f"{seconds(p.seconds)}, {p.memory / 1e6:.3g} MB ({p.knob})"
    for method, points in diagram.curves.items():
        first, last = (seconds(points[k].compile_seconds) for k in (0, -1))
        compiling = first if first == last else f"{first} to {last}"
        rows.append((method, say(points[0]), say(points[-1]), compiling))
    return rows


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
