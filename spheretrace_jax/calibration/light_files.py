"""Files of light directions, as programs for photometric stereo and relighting read them.

Directions are unit vectors in the frame of photometric stereo: x right, y up, z toward the viewer.
`camera.flip_frame` makes them from the camera's.
"""

import csv
import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..base.errors import InputError, printable
from ..files.atomic import write_text

Rows = Float[np.ndarray, "lights 3"]
Path_ = str | os.PathLike[str]

Record = Mapping[str, "str | float | int | Sequence[float] | np.ndarray"]
"""A light: values by the name of their field. A field with several numbers has several columns."""

#: The columns of the fields that have several; other fields have one column of their own name.
COLUMNS = {"direction": ("x", "y", "z"), "color": ("red", "green", "blue")}


def write_lp(path: Path_, names: Sequence[str], directions: Rows) -> None:
    """Writes an .lp file: the number of lights, then a line `name x y z` for each.

    **Raises:** `InputError` for directions that are no unit vectors; `OSError` if the file cannot
    be written.
    """
    directions = _unit_vectors(directions)
    if len(names) != len(directions):
        raise InputError(f"names: expected {len(directions)}, one for each light, got {len(names)}")
    lines = [f"{name} {_line(row)}" for name, row in zip(names, directions, strict=True)]
    write_text(path, "\n".join([str(len(lines)), *lines, ""]))


def read_lp(path: Path_) -> tuple[list[str], Rows]:
    """Reads an .lp file. **Returns:** names, which may hold blanks, and unit vectors.

    **Raises:** `InputError`, with file and line; `OSError` if the file cannot be read.
    """
    (first, head), *lines = _lines(path) or [(1, "")]
    if not head.strip().isdigit() or int(head) != len(lines):
        raise InputError(
            f"{path}:{first}: expected the number of the lines that follow, {len(lines)}, "
            f"got {printable(head.strip())!r}"
        )
    names, rows = [], []
    for number, line in lines:
        name, *vector = line.strip().rsplit(None, 3)
        names.append(name)
        rows.append(_vector(path, number, vector))
    return names, _normalized(path, rows, [number for number, _ in lines])


def write_rows(path: Path_, rows: Rows) -> None:
    """Writes three numbers a line: light_directions.txt or light_intensities.txt (DiLiGenT).

    **Raises:** `InputError` for numbers that are not finite; `OSError` if the file cannot be
    written.
    """
    rows = np.asarray(rows, float).reshape(-1, 3)
    if not np.isfinite(rows).all():
        raise InputError(f"{path}: expected finite numbers, some are not")
    write_text(path, "".join(f"{_line(row)}\n" for row in rows))


def read_rows(path: Path_) -> Rows:
    """Reads three numbers a line.

    **Raises:** `InputError`, with file and line; `OSError` if the file cannot be read.
    """
    rows = [_vector(path, number, line.split()) for number, line in _lines(path)]
    return np.array(rows).reshape(-1, 3)


def write_lights(path: Path_, lights: Sequence[Record]) -> None:
    """Writes lights.csv: a header, and a line for each light.

    **Arguments:** `lights`: any fields, the same for all lights. Three numbers have the columns of
    `COLUMNS`, or the field's name with _x, _y and _z.

    **Raises:** `InputError` if the lights have different fields; `OSError` if the file cannot be
    written.
    """
    tables = [_flat(light) for light in lights]
    header = list(tables[0]) if tables else ["name", *COLUMNS["direction"]]
    if any(list(table) != header for table in tables):
        raise InputError(f"{path}: expected the same fields for all lights")
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(table.values() for table in tables)
    write_text(path, text.getvalue())


def read_lights(path: Path_) -> list[dict[str, str | float | np.ndarray]]:
    """Reads lights.csv, as `write_lights` writes it: texts, numbers, and arrays of three.

    **Raises:** `InputError`, with file and line; `OSError` if the file cannot be read.
    """
    with open(path, newline="", encoding="utf-8") as file:
        table = list(csv.reader(file))
    if not table:
        raise InputError(f"{path}:1: expected a header, the file is empty")
    lights = []
    for number, row in enumerate(table[1:], 2):
        if len(row) != len(table[0]):
            raise InputError(f"{path}:{number}: expected {len(table[0])} columns, got {len(row)}")
        lights.append(_gathered(dict(zip(table[0], map(_value, row), strict=True))))
    return lights


def _flat(light: Record) -> dict[str, str]:
    """Returns the columns of a light as text."""
    columns: dict[str, str] = {}
    for field, value in light.items():
        if isinstance(value, str):
            columns[field] = value
        elif np.ndim(value) == 0:
            columns[field] = f"{float(value):.9g}"  # type: ignore[arg-type]
        else:
            names = COLUMNS.get(field, tuple(f"{field}_{axis}" for axis in "xyz"))
            numbers = np.asarray(value, float)
            columns |= {n: f"{v:.9g}" for n, v in zip(names, numbers.tolist(), strict=True)}
    return columns


def _gathered(columns: dict[str, str | float]) -> dict[str, str | float | np.ndarray]:
    """Joins the columns of fields with three numbers."""
    light: dict[str, str | float | np.ndarray] = dict(columns)
    stems = {name[:-2]: tuple(f"{name[:-2]}_{axis}" for axis in "xyz") for name in columns}
    for field, names in {**stems, **COLUMNS}.items():
        if field and all(isinstance(columns.get(name), float) for name in names):
            light[field] = np.array([light.pop(name) for name in names], float)
    return light


def _value(text: str) -> str | float:
    try:
        return float(text)
    except ValueError:
        return text


def _lines(path: Path_) -> list[tuple[int, str]]:
    """Returns the lines of a text file that are not empty, with their numbers."""
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}:1: expected a text file") from None
    return [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip()]


def _vector(path: Path_, number: int, words: Sequence[str]) -> list[float]:
    values = [_value(word) for word in words]
    numbers = [v for v in values if isinstance(v, float) and np.isfinite(v)]
    if len(words) != 3 or len(numbers) != 3:
        got = printable(" ".join(words)) or "nothing"
        raise InputError(f"{path}:{number}: expected three numbers, got {got!r}")
    return numbers


def _normalized(path: Path_, rows: list[list[float]], numbers: list[int]) -> Rows:
    vectors = np.array(rows, float).reshape(-1, 3)
    lengths = np.linalg.norm(vectors, axis=1)
    for length, number in zip(lengths, numbers, strict=True):
        if not length > 0:
            raise InputError(f"{path}:{number}: expected a direction, got three zeros")
    return vectors / lengths[:, None]


def _unit_vectors(directions: Rows) -> Rows:
    rows = np.asarray(directions, float).reshape(-1, 3)
    lengths = np.linalg.norm(rows, axis=1)
    if not np.allclose(lengths, 1, rtol=0, atol=1e-5):
        raise InputError("directions: expected unit vectors, some have another length")
    return rows


def _line(row: np.ndarray) -> str:
    return " ".join(f"{value:.9f}" for value in row.tolist())
