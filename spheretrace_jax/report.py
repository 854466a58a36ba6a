"""What a fit found, for people: pictures side by side, the cost curve, tables of parameters."""

import os
from pathlib import Path

import numpy as np

from .files.atomic import replacing, write_text
from .fit import Fit
from .fit.parameters import value
from .scene import Scene


def verdict(fit: Fit) -> str:
    """One sentence: whether the fit can be trusted, and how well it explains the picture."""
    misfit = np.sqrt(2 * fit.cost / fit.counted) if fit.counted else float("nan")
    left_out = f"; {fit.left_out} clipped numbers left out" if fit.left_out else ""
    if fit.interrupted:
        end = "interrupted: the best scene so far"
    elif fit.converged:
        end = "converged"
    else:
        end = f"NOT converged ({str(fit.result_message).split('.')[0].strip()})"
    return f"{end} after {fit.steps} steps, root-mean-square residual {misfit:.2e}{left_out}"


def determined(scene: Scene) -> dict[str, np.ndarray]:
    """What a picture determines: the products of colour and coefficients, ks, the lights."""
    s = scene.spheres
    return {
        "ka*color": np.asarray(s.ka)[:, None] * np.asarray(s.color),
        "kd*color": np.asarray(s.kd)[:, None] * np.asarray(s.color),
        "ks": np.asarray(s.ks),
        "light_position": np.asarray(scene.lights.position),
    }


def parameter_table(start: Scene, fitted: Scene, free: tuple[str, ...]) -> str:
    """A Markdown table of the free parameters, before and after, one line per object."""
    lines = ["| parameter | object | before | after |", "|---|---|---|---|"]
    for name in free:
        before, after = (np.asarray(value(scene, name)) for scene in (start, fitted))
        if before.ndim == 0:
            lines.append(f"| {name} | camera | {_numbers(before)} | {_numbers(after)} |")
            continue
        kind = "light" if name.startswith("light") else "sphere"
        for i, (b, a) in enumerate(zip(before, after, strict=True)):
            lines.append(f"| {name} | {kind} {i + 1} | {_numbers(b)} | {_numbers(a)} |")
    return "\n".join(lines) + "\n"


def _numbers(value: np.ndarray | np.floating) -> str:
    return " ".join(f"{float(x):.6g}" for x in np.atleast_1d(value))


def write_report(
    folder: str | os.PathLike,
    fit: Fit,
    start: Scene,
    target: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    free: tuple[str, ...],
) -> list[Path]:
    """Writes `comparison.png`, `cost.png` and `report.md` to a folder, which it makes if need be.

    **Arguments:** `target`, `before`, `after`: the target, the start's and the fit's picture.

    **Returns:** the files written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / name for name in ("comparison.png", "cost.png", "report.md")]
    _save(_comparison(target, before, after), files[0])
    _save(_cost_curve(fit), files[1])
    text = [
        "# Fit",
        f"{verdict(fit)[0].upper()}{verdict(fit)[1:]}.",
        "![target, start, fit and residual](comparison.png)",
        "![cost after each step](cost.png)",
        "## Free parameters",
        "Multiplying color by a number and dividing ka and kd by it changes no picture: where all",
        "three are free, ka is kept at its start where the bounds allow it.",
        parameter_table(start, fit.scene, free),
    ]
    write_text(files[2], "\n\n".join(text[:5]) + "\n\n" + "\n".join(text[5:7]) + "\n\n" + text[7])
    return files


def _save(figure, path: Path) -> None:
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120)


def _figure(width: float, height: float):
    from matplotlib.figure import Figure  # not pyplot: no window system, no global state

    return Figure(figsize=(width, height), layout="constrained")


def _comparison(target: np.ndarray, before: np.ndarray, after: np.ndarray):
    from .files.images import to_srgb

    figure = _figure(13.0, 3.6)
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
    figure = _figure(5.0, 3.6)
    ax = figure.subplots()
    ax.semilogy(np.arange(1, len(fit.costs) + 1), fit.costs, marker="o")
    ax.set(xlabel="step", ylabel="cost (half the sum of squares)", title="Levenberg-Marquardt")
    ax.grid(alpha=0.3)
    return figure
