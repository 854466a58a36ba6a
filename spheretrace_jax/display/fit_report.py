"""The report of a fit: one HTML page, and the same in Markdown with pictures beside it."""

import os
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..base.errors import InputError
from ..files.atomic import check_target, write_text
from ..fit import Fit
from ..fit.diagnosis.trust import together
from ..fit.problem.problem import Problem, pictures_at
from ..study.study import machine
from . import page
from .figures import (
    Picture,
    displayed,
    draw_residual,
    figure_png,
    new_figure,
    picture_png,
    save_figure,
    shrunk,
)
from .parameter_rows import ParameterRow, parameter_rows

# The longest side of a picture in the page, in pixels: larger ones are shown as means of boxes.
# Three pictures of 800 x 800 are at most 5 MB.
_MOST_PIXELS = 800

_COLUMNS = ("parameter", "object", "before", "after", "+-")


class _Pictures(NamedTuple):
    """What a target and the scenes look like; NaN in pixels that do not count."""

    target: Picture
    start: Picture
    fit: Picture
    residual: Picture  #: NaN in numbers that do not count


def write_report(path: str | os.PathLike[str], fit: Fit) -> list[Path]:
    """Writes the report of a fit.

    **Arguments:** `path`: a file that ends in `.html`; or a folder, which is made.

    **Returns:** the files written.

    **Raises:** `InputError` for a file with another ending; `OSError` if one cannot be written.
    """
    path = Path(path)
    if path.suffix == ".html":
        check_target(path)
        write_text(path, fit_page(fit))
        return [path]
    if path.is_file() or path.suffix:
        raise InputError(f"{path}: expected a name that ends in .html, or a folder")
    path.mkdir(parents=True, exist_ok=True)
    names = ("comparison.png", "cost.png", "report.md", "report.html")
    files = [path / name for name in names]
    pictures, rows = fit_pictures(fit), list(parameter_rows(fit))
    save_figure(_comparison(pictures), files[0])
    save_figure(_cost_curve(fit), files[1])
    write_text(files[2], _markdown(fit, rows))
    write_text(files[3], _page(fit, pictures, rows))
    return files


def fit_page(fit: Fit) -> str:
    """Returns the report as one HTML page, which needs no network."""
    return _page(fit, fit_pictures(fit), list(parameter_rows(fit)))


def fit_pictures(fit: Fit) -> list[_Pictures]:
    """Returns target, start, fit and residual of each picture, by the program of the fit's steps.

    Residuals are the fit's picture less the target, without weights.
    """
    started = fit.problem.starting_at(fit.starts)
    if started.edges_move:
        started = started.traced_at(started.start())
    drawn = zip(_drawn(started, started.start()), _drawn(fit.problem, fit.values), strict=True)
    found = []
    for target, (before, after) in zip(fit.problem.targets, drawn, strict=True):
        counts = np.asarray(target.weight > 0)
        pixel = counts.any(-1, keepdims=True)
        image, before, after = (np.where(pixel, x, np.nan) for x in (target.image, before, after))
        found.append(_Pictures(image, before, after, np.where(counts, after - image, np.nan)))
    return found


def _drawn(problem: Problem, values: Any) -> list[np.ndarray]:
    drawn = pictures_at(problem, values)
    return [np.asarray(image) * np.asarray(exposure) for image, exposure in drawn]


def _page(fit: Fit, pictures: Sequence[_Pictures], rows: Sequence[ParameterRow]) -> str:
    """Returns the HTML page."""
    parts = [page.verdict(_sentence(fit.trust.verdict), fit.trust.grade)]
    parts.append(page.listed(together(fit.trust.remarks)))
    for k, shown in enumerate(pictures):
        number = f" {k + 1}" if len(pictures) > 1 else ""
        parts += [page.heading(f"Picture{number}"), *_picture_parts(shown)]
    parts += [
        page.heading("Cost"),
        page.figure(
            page.image(figure_png(_cost_curve(fit)), "cost after each step"),
            f"Half the sum of squares after each of {fit.steps} steps, the least so far.",
        ),
        page.heading("What is determined"),
        page.listed(together(str(fit.identifiability).splitlines())),
        page.heading("Parameters"),
        page.paragraph("+- is the standard deviation; - where the pictures do not determine it."),
        page.table(_COLUMNS, map(_cells, rows), words=(1,)),
        page.heading("Settings"),
        page.table(("setting", "value"), _settings(fit), words=(1,)),
    ]
    return page.page("Fit", *parts)


def _picture_parts(shown: _Pictures) -> list[str]:
    """Returns the pieces of HTML of one picture."""
    small = {
        name: shrunk(getattr(shown, name), _MOST_PIXELS) for name in ("target", "fit", "start")
    }
    images = {name: page.image(picture_png(x), name) for name, x in small.items()}
    figures = [page.figure(images[name], name) for name in ("target", "start", "fit")]
    residual = shrunk(shown.residual, _MOST_PIXELS)
    figure = new_figure(6.4, 4.8)
    ax = figure.subplots()
    figure.colorbar(draw_residual(ax, residual), ax=ax)
    left_out = np.isnan(shown.residual).mean()
    grey = f" {left_out:.2%} of the numbers do not count; grey: of no channel." * bool(left_out)
    boxes = " Pictures are shown as means of boxes of pixels." * (residual.shape != shown[3].shape)
    return [
        page.side_by_side(*figures),
        page.paragraph("Target on the left, fit on the right:"),
        page.slider(images["target"], images["fit"], "how much of target and fit shows"),
        page.figure(
            page.image(figure_png(figure), "residual"),
            f"Fit - target, in linear numbers, the worst channel of each pixel.{grey}{boxes}",
        ),
    ]


def _cells(row: ParameterRow) -> list[str]:
    """Returns a row of the table, colours with a swatch before their numbers."""
    cells = [escape(cell) for cell in row[:5]]
    for k, color in enumerate(row.colors or ()):
        red, green, blue = (round(float(x) * 255) for x in displayed(color[None, None])[0, 0])
        style = f"background: rgb({red} {green} {blue})"
        cells[2 + k] = f"<span class='swatch' style='{style}'></span>{cells[2 + k]}"
    return cells


def _settings(fit: Fit) -> list[tuple[str, str]]:
    """Returns what the fit was asked for, and versions."""
    first, target = fit.problem.settings[0], fit.problem.targets[0]
    sizes = ", ".join(f"{s.width} x {s.height}" for s in fit.problem.settings)
    free = ", ".join(fit.problem.parameters[0].free)
    settings = {
        "pictures": sizes, "free": free, "highlight": first.highlight, "bounces": first.bounces,
        "samples": first.samples, "antialias": int(first.antialias), "loss": target.loss,
        "dtype": fit.scene.dtype, "tolerance": fit.tolerance,
    }  # fmt: skip
    return [(name, escape(str(x))) for name, x in {**settings, **machine()}.items()]


def _markdown(fit: Fit, rows: Sequence[ParameterRow]) -> str:
    """Returns the report in Markdown."""
    known = fit.identifiability
    remarks = [f"{known.rank} of {known.free} free numbers."]
    remarks += [f"{r}." for r in together(fit.trust.remarks)]
    line = lambda cells: f"| {' | '.join(cells)} |"
    lines = [line(_COLUMNS), "|---|---|---|---|---|", *(line(row[:5]) for row in rows)]
    text = [
        "# Fit",
        f"{_sentence(fit.trust.verdict)}",
        "![target, start, fit and residual](comparison.png)",
        "![cost after each step](cost.png)",
        "## What the picture determines",
        "\n".join(f"- {line}" for line in remarks),
        "## Free parameters",
        "\n".join(lines),
    ]
    return "\n\n".join(text) + "\n"


def _sentence(words: str) -> str:
    return f"{words[0].upper()}{words[1:]}."


def _comparison(pictures: Sequence[_Pictures]) -> Any:
    """Draws target, start, fit and residual, a row for each picture."""
    figure = new_figure(13.0, 3.6 * len(pictures))
    for row, shown in zip(figure.subplots(len(pictures), 4, squeeze=False), pictures, strict=True):
        for ax, name in zip(row, ("target", "start", "fit"), strict=False):
            ax.imshow(displayed(getattr(shown, name)))
            ax.set_title(name)
            ax.set_axis_off()
        figure.colorbar(draw_residual(row[3], shown.residual), ax=row[3])
        row[3].set_title("fit - target, worst channel")
    return figure


def _cost_curve(fit: Fit) -> Any:
    """Draws the cost, step by step."""
    figure = new_figure(5.0, 3.6)
    ax = figure.subplots()
    costs = np.array(fit.costs, float)
    ax.plot(np.arange(1, len(costs) + 1), costs, marker="o")
    if (costs > 0).any():
        ax.set_yscale("log")
    ax.set(xlabel="step", ylabel="cost (half the sum of squares)", title="Levenberg-Marquardt")
    ax.grid(alpha=0.3)
    return figure
