"""The page of `spheretrace lights`: photographs with ball, light and residual drawn over them."""

from html import escape
from pathlib import Path

import numpy as np

from ..base.progress import working
from ..calibration.ball_light import BallLight, lobe_name
from ..calibration.camera import flip_frame
from ..calibration.conic import outline_points
from ..calibration.lights import BallLights
from ..files.atomic import write_text
from . import page
from .figures import displayed, figure_png, new_figure

# Around the ball this part of its radius is shown.
_AROUND = 0.35


def write_page(path: Path, found: BallLights) -> None:
    """Writes one HTML file with pictures inside, which needs no network.

    **Raises:** `OSError` if the file cannot be written.
    """
    write_text(path, lights_page(found))


def lights_page(found: BallLights) -> str:
    """Returns the page: a table of the lights, and each photograph with ball and residual."""
    figures = []
    with working("drawing", len(found)) as step:
        for k, light in enumerate(found):
            if found.photos[k] is not None:
                figures.append(page.figure(page.image(_drawn(found, k), light.name), str(light)))
            step(light.name)
    return page.page(
        f"Lights of {len(found)} photographs",
        page.paragraph(
            "Directions from the ball's centre: x right, y up, z toward the viewer. The error is "
            "the radius around a direction that holds the light with 95 %."
        ),
        lights_table(found),
        *figures,
    )


def lights_table(found: BallLights) -> str:
    """Returns the table of the lights."""
    names = ("photograph", "x", "y", "z", "error, degrees", "distance", "at least", "red", "green",
             "blue", "highlight", "not explained", "grade")  # fmt: skip
    return page.table(names, map(_row, found), words=(12,))


def _row(light: BallLight) -> list[str]:
    """Returns the table's row of a light."""
    number = lambda x: "∞" if np.isinf(x) else "-" if np.isnan(x) else f"{x:.4g}"
    cells = [escape(light.name), *(f"{x:+.4f}" for x in light.direction)]
    cells += [f"{light.error:.2f}", number(light.distance), number(light.least_distance)]
    cells += [number(x) for x in light.color] + [lobe_name(light), f"{light.unexplained:.1%}"]
    grade = page.GRADES.get(light.grade, "bad")
    return [*cells, f"<span class='{grade}'>{light.grade}</span>"]


def _drawn(found: BallLights, k: int) -> bytes:
    """Draws photograph, fit and residual around the ball. **Returns:** a PNG file."""
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
        ax.imshow(displayed(picture * scale), extent=(0, width, height, 0))
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
    return figure_png(figure, dpi=80)
