"""The report of `spheretrace info`: tables of a scene and of its picture's needs."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..scene.needs import left_out
from ..scene.scene import Scene
from ..scene.summary import camera_line, contents, light_line, short

# Limit of the spheres shown, the first ones.
_MOST_SPHERES = 50


def print_scene(file: Path, scene: Scene) -> None:
    """Prints the content of a scene file."""
    from rich.console import Console

    console = Console()
    s, lights = scene.spheres, scene.lights
    lines = [f"{file}: {contents(scene)}", camera_line(scene)]
    for line in (*lines, *(light_line(scene, i) for i in range(len(lights)))):
        console.print(line, highlight=False, markup=False)
    heads = ("sphere", "center", "radius", "color", "ka", "kd", "ks", "specExp", "kgr", "kt", "pic")
    columns = (s.center, s.radius, s.color, s.ka, s.kd, s.ks, s.exponent, s.kgr, s.kt, s.pic)
    if np.any(np.asarray(s.ior) != 1):
        heads, columns = (*heads, "ior"), (*columns, s.ior)
    shown = min(len(s), _MOST_SPHERES)
    row = lambda i: (str(i + 1), *(short(column[i]) for column in columns))
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
