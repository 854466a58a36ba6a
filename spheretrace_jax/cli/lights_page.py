"""The page of `spheretrace lights`: photographs with ball, light and residual drawn over them."""

import base64
import io
from collections.abc import Callable
from html import escape
from pathlib import Path

import numpy as np

from ..calibration.ball_light import BallLight, lobe_name
from ..calibration.camera import flip_frame
from ..calibration.conic import outline_points
from ..calibration.lights import BallLights
from ..files.atomic import write_text
from .report import new_figure

# Around the ball this part of its radius is shown.
_AROUND = 0.35

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2em auto; max-width: 70em; padding: 0 1em; }
table { border-collapse: collapse; width: 100%; }
td, th { padding: .2em .6em; text-align: right; border-bottom: 1px solid #ccc; }
td:first-child, th:first-child, td:last-child, th:last-child { text-align: left; }
figure { margin: 2em 0; } img { max-width: 100%; }
.good { color: #176117; } .usable { color: #8a5a00; } .bad { color: #a01010; font-weight: bold; }
"""


def write_page(path: Path, found: BallLights, step: Callable[[str], None]) -> None:
    """Writes one HTML file with pictures inside, which needs no network.

    **Arguments:** `step`: called with each light's name when it is drawn.

    **Raises:** `OSError` if the file cannot be written.
    """
    rows, figures = [], []
    for k, light in enumerate(found):
        rows.append(_row(light))
        if found.photos[k] is not None:
            picture = _drawn(found, k)
            figures.append(
                f"<figure><img alt='{escape(light.name)}' src='data:image/png;base64,{picture}'>"
                f"<figcaption>{escape(str(light))}</figcaption></figure>"
            )
        step(light.name)
    names = ("photograph", "x", "y", "z", "error, degrees", "distance", "at least", "red", "green",
             "blue", "highlight", "not explained", "grade")  # fmt: skip
    head = "".join(f"<th>{name}</th>" for name in names)
    write_text(
        path,
        f"<!DOCTYPE html><html lang='en'><meta charset='utf-8'><title>Lights</title>"
        f"<meta name='viewport' content='width=device-width'><style>{_STYLE}</style>"
        f"<h1>Lights of {len(found)} photographs</h1>"
        "<p>Directions from the ball's centre: x right, y up, z toward the viewer. The error is "
        "the radius around a direction that holds the light with 95 %.</p>"
        f"<table><tr>{head}</tr>{''.join(rows)}</table>{''.join(figures)}</html>",
    )


def _row(light: BallLight) -> str:
    """Returns the table's row of a light."""
    number = lambda x: "∞" if np.isinf(x) else "-" if np.isnan(x) else f"{x:.4g}"
    cells = [f"{x:+.4f}" for x in light.direction]
    cells += [f"{light.error:.2f}", number(light.distance), number(light.least_distance)]
    cells += [number(x) for x in light.color] + [lobe_name(light), f"{light.unexplained:.1%}"]
    kind = light.grade if light.grade in ("good", "usable") else "bad"
    body = "".join(f"<td>{cell}</td>" for cell in cells)
    return f"<tr><td>{escape(light.name)}</td>{body}<td class='{kind}'>{light.grade}</td></tr>"


def _drawn(found: BallLights, k: int) -> str:
    """Draws photograph, fit and residual around the ball. **Returns:** a PNG in base 64."""
    from ..files.images import to_srgb

    light, photo = found[k], found.photos[k]
    assert photo is not None
    shown = found.picture(k)
    height, width = photo.picture.shape[:2]
    edge = outline_points(light.outline, np.linspace(0, 2 * np.pi, 200))
    around = _AROUND * light.outline.radius
    (left, top), (right, bottom) = edge.min(0) - around, edge.max(0) + around
    figure = new_figure(11.0, 3.6)
    axes = figure.subplots(1, 3)
    scale = 1 / max(float(np.nanquantile(photo.picture[photo.pixels.mask], 0.995)), 1e-300)
    background = np.where(np.isfinite(shown), shown, 0)
    for ax, picture in zip(axes[:2], (photo.picture, background), strict=True):
        ax.imshow(np.clip(to_srgb(picture * scale), 0, 1), extent=(0, width, height, 0))
        ax.plot(*edge.T, color="tab:orange", linewidth=0.8)
    toward = flip_frame(light.direction)[:2] * light.outline.radius
    middle = light.outline.center
    axes[0].plot(*np.stack([middle, middle + toward]).T, color="tab:cyan", linewidth=1)
    axes[0].plot(*(middle + toward), "o", color="tab:cyan", markersize=4)
    counts = photo.counts.any(axis=2)
    difference = np.where(photo.counts, shown - photo.picture, 0).sum(axis=2) * scale
    residual = np.where(counts, difference / np.maximum(photo.counts.sum(axis=2), 1), np.nan)
    limit = max(float(np.abs(residual[counts]).max()), 1e-12)
    image = axes[2].imshow(
        residual, cmap="RdBu", vmin=-limit, vmax=limit, extent=(0, width, height, 0)
    )
    figure.colorbar(image, ax=axes[2])
    for ax, title in zip(axes, (light.name, "fit", "fit - photograph"), strict=True):
        ax.set(title=title, xlim=(left, right), ylim=(bottom, top))
        ax.set_axis_off()
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=80)
    return base64.b64encode(file.getvalue()).decode()
