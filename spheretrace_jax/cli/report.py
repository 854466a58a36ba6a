"""The report of a fit: pictures in comparison, the cost curve, and a table of parameters."""

import os
from pathlib import Path

import numpy as np

from ..files.atomic import replacing, write_text
from ..fit import Fit
from ..fit.diagnosis.trust import together
from ..fit.model.accessors import CAMERA, value
from ..fit.model.parameters import bounding_sphere
from ..scene.scene import Scene


def _remarks(fit: Fit) -> list[str]:
    """Lists what the picture determines, and the remarks of `Fit.trust`."""
    known = fit.identifiability
    return [
        f"{known.rank} of {known.free} free numbers.",
        *(f"{r}." for r in together(fit.trust.remarks)),
    ]


def parameter_table(start: Scene, fit: Fit, free: tuple[str, ...]) -> str:
    """Returns a Markdown table of the free parameters, one line per object that is not held.

    Columns: before, after, and the standard deviation, which is `-` for undetermined numbers. A
    light whose distance does not show is at infinity, in a direction and at some distance at least.
    """
    lines = ["| parameter | object | before | after | +- |", "|---|---|---|---|---|"]
    deviations = fit.uncertainty.standard_deviations
    for name in free:
        if name == "exposure":
            continue
        before, after = (np.asarray(value(scene, name)) for scene in (start, fit.scene))
        spread = deviations[name]
        if before.ndim == 0 or name in CAMERA:
            numbers = " | ".join(map(_numbers, (before, after, spread)))
            lines.append(f"| {name} | camera | {numbers} |")
            continue
        kind = "light" if name.startswith("light") else "sphere"
        free_rows = fit.problem.parameters[0].free_numbers(name).reshape(len(before), -1)
        for i, row in enumerate(zip(before, after, spread, strict=True)):
            if not free_rows[i].any():
                continue
            if name == "light_position" and fit.uncertainty.light_distance(i).infinite:
                lines.append(f"| {name} | {kind} {i + 1} | {_numbers(row[0])} | {_far(fit, i)} |")
                continue
            lines.append(f"| {name} | {kind} {i + 1} | {' | '.join(map(_numbers, row))} |")
    return "\n".join(lines) + "\n"


def _far(fit: Fit, light: int) -> str:
    """Returns where a light at infinity is, and how well its direction is known."""
    middle, _ = bounding_sphere(fit.scene)
    offset = np.asarray(fit.scene.lights.position[light] - middle, np.float64)
    direction = _numbers(offset / np.linalg.norm(offset))
    least = fit.uncertainty.light_distance(light).least
    angle, _ = fit.uncertainty.of_light(0, light)
    degrees = f"{np.degrees(angle):.2g} degrees" if np.isfinite(angle) else "-"
    return f"at infinity (at least {least:.3g}, 95 %), toward {direction} | {degrees}"


def _numbers(value: np.ndarray | np.floating) -> str:
    """Returns finite numbers with six digits, others as `-`."""
    finite = lambda x: f"{float(x):.6g}" if np.isfinite(x) else "-"
    return " ".join(finite(x) for x in np.atleast_1d(value))


def write_report(
    folder: str | os.PathLike[str],
    fit: Fit,
    start: Scene,
    target: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    free: tuple[str, ...],
) -> list[Path]:
    """Writes `comparison.png`, `cost.png` and `report.md`; makes the folder.

    **Arguments:** `target`, `before`, `after`: the target, the start's and the fit's picture.
    `free`: the free parameters.

    **Returns:** the files written.

    **Raises:** `OSError` if the files cannot be written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / name for name in ("comparison.png", "cost.png", "report.md")]
    save_figure(_comparison(target, before, after), files[0])
    save_figure(_cost_curve(fit), files[1])
    text = [
        "# Fit",
        f"{fit.trust.verdict[0].upper()}{fit.trust.verdict[1:]}.",
        "![target, start, fit and residual](comparison.png)",
        "![cost after each step](cost.png)",
        "## What the picture determines",
        "\n".join(f"- {line}" for line in _remarks(fit)),
        "## Free parameters",
        parameter_table(start, fit, free),
    ]
    write_text(files[2], "\n\n".join(text))
    return files


def save_figure(figure, path: Path) -> None:
    """Writes a figure atomically, in the format of the ending."""
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120)


def new_figure(width: float, height: float):
    """Returns an empty figure. **Arguments:** `width`, `height`: in inches."""
    from matplotlib.figure import Figure  # not pyplot: no window system, no global state

    return Figure(figsize=(width, height), layout="constrained")


def _comparison(target: np.ndarray, before: np.ndarray, after: np.ndarray):
    """Draws the three pictures, and the residual of its worst channel."""
    from ..files.images import to_srgb

    figure = new_figure(13.0, 3.6)
    axes = figure.subplots(1, 4)
    pictures = {"target": target, "start": before, "fit": after}
    for ax, (title, picture) in zip(axes, pictures.items(), strict=False):
        ax.imshow(np.clip(to_srgb(np.asarray(picture)), 0, 1))
        ax.set_title(title)
    residual = np.asarray(after) - np.asarray(target)
    channel = np.abs(residual).argmax(-1, keepdims=True)
    worst = np.take_along_axis(residual, channel, -1)[..., 0]
    limit = max(float(np.abs(worst).max()), 1e-12)
    shown = axes[3].imshow(worst, cmap="RdBu", vmin=-limit, vmax=limit)
    axes[3].set_title("fit - target, worst channel")
    figure.colorbar(shown, ax=axes[3])
    for ax in axes:
        ax.set_axis_off()
    return figure


def _cost_curve(fit: Fit):
    """Draws the cost, step by step."""
    figure = new_figure(5.0, 3.6)
    ax = figure.subplots()
    ax.semilogy(np.arange(1, len(fit.costs) + 1), fit.costs, marker="o")
    ax.set(xlabel="step", ylabel="cost (half the sum of squares)", title="Levenberg-Marquardt")
    ax.grid(alpha=0.3)
    return figure
