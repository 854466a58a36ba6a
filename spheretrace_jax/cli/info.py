"""The report of `spheretrace info`: tables of a scene and of its picture's needs."""

from collections.abc import Sequence, Sized
from pathlib import Path

import numpy as np

from ..scene.needs import left_out
from ..scene.scene import Scene

# Limit of the spheres shown, the first ones.
_MOST_SPHERES = 50


def print_scene(file: Path, scene: Scene) -> None:
    """Prints the content of a scene file."""
    from rich.console import Console

    console = Console()
    c, s = scene.camera, scene.spheres
    console.print(
        f"{file}: {_counted(s, 'sphere')}, {_counted(scene.lights, 'light')}, "
        f"{_counted(scene.planes, 'plane')}, {_counted(scene.textures, 'texture')}"
        f"{', the back plane' if scene.back_plane is not None else ''}",
        highlight=False,
        markup=False,
    )
    console.print(
        f"camera: theta {float(c.theta):g}, phi {float(c.phi):g}, mu {float(c.mu):g}, "
        f"distance {float(c.distance):g}, window {float(c.window):g}",
        highlight=False,
        markup=False,
    )
    for i, (p, color) in enumerate(zip(scene.lights.position, scene.lights.color, strict=True)):
        text = f"light {i + 1}: at {_short(p)}, color {_short(color)}"
        console.print(text, highlight=False, markup=False)
    heads = "sphere", "center", "radius", "color", "ka", "kd", "ks", "specExp", "kgr", "kt", "pic"
    columns = (s.center, s.radius, s.color, s.ka, s.kd, s.ks, s.exponent, s.kgr, s.kt)
    shown = min(len(s), _MOST_SPHERES)
    row = lambda i: (str(i + 1), *(_short(column[i]) for column in columns), str(s.pic[i]))
    print_table(heads, [row(i) for i in range(shown)])
    if len(s) > shown:
        console.print(f"and {len(s) - shown} more spheres")


def print_needs(scene: Scene, costs: dict[str, float]) -> None:
    """Prints the needs of a picture. **Arguments:** `costs`: those of `feature_costs`."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    table = Table("feature", "computed", "would cost", "why", box=SIMPLE_HEAD)
    for name, needed, why in left_out(scene):
        cost = f"+{max(costs[name], 0):.0%}" if name in costs else ""
        table.add_row(name, "yes" if needed else "left out", cost, why)
    Console().print(table)


def print_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Prints a narrow table."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    table = Table(*columns, box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    for row in rows:
        table.add_row(*row)
    Console().print(table)


def _short(value) -> str:
    """Returns numbers with up to six digits each."""
    return " ".join(f"{float(x):g}" for x in np.atleast_1d(np.asarray(value)))


def _counted(objects: Sized, name: str) -> str:
    """Returns the number of objects, with their name in the singular or the plural."""
    return f"{len(objects)} {name}{'' if len(objects) == 1 else 's'}"
