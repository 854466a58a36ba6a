"""The documentation without building it: names and pages are there, and their code parses."""

import ast
import importlib.util
import json
import re
import types
from pathlib import Path

import pytest

import spheretrace_jax as st
from spheretrace_jax.scene.parameters import PARAMETERS

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
NOTEBOOKS = sorted(DOCS.rglob("*.ipynb"))
NAV = re.findall(r"[\w/]+\.md\b", (ROOT / "mkdocs.yml").read_text().partition("\nnav:\n")[2])


def test_every_public_name_is_in_the_reference():
    public = [
        name
        for name in vars(st)
        if not name.startswith("_") and not isinstance(getattr(st, name), types.ModuleType)
    ]
    pages = "\n".join(p.read_text() for p in sorted((DOCS / "reference").glob("*.md")))
    assert sorted(re.findall(r"^::: st\.(\w+)$", pages, re.MULTILINE)) == sorted(public)


def test_every_page_is_in_the_navigation():
    pages = [p.relative_to(DOCS).as_posix() for p in DOCS.rglob("*.md")]
    made = [p.relative_to(DOCS).with_suffix(".md").as_posix() for p in NOTEBOOKS]
    assert sorted(NAV) == sorted(pages + made)
    assert len(made) >= 6


@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_notebook(file):
    """Notebooks are kept without outputs, their code parses, and they begin with a title."""
    cells = json.loads(file.read_text())["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert cells[0]["source"][0].startswith("# ") and len(code) >= 3
    for cell in code:
        assert cell["outputs"] == [] and cell["execution_count"] is None
        ast.parse("".join(cell["source"]))


@pytest.fixture(scope="module")
def rows() -> dict[tuple[str, str], list[str]]:
    """The table of the page on parameters, by names and owners."""
    place = importlib.util.spec_from_file_location("reference", DOCS / "hooks" / "reference.py")
    assert place and place.loader
    reference = importlib.util.module_from_spec(place)
    place.loader.exec_module(reference)
    lines = [line for line in reference.table().splitlines() if line.startswith("| `")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {(row[0].strip("`"), row[1].strip("`")): row for row in cells}


def test_the_table_has_every_parameter(rows):
    places = {
        (p.name, f"scene.{'' if p.owner == 'scene' else p.owner + '.'}{p.attribute or p.name}"): p
        for p in PARAMETERS
    }
    assert set(rows) == set(places) and len(rows) == len(PARAMETERS)
    shapes = {"(n, 3)": (2, 3), "(n,)": (2,), "(m, 3)": (1, 3), "(m,)": (1,), "(p, 3)": (1, 3)}
    shapes |= {"(p,)": (1,), "(3,)": (3,), "(2,)": (2,), "()": ()}
    scene = st.Scene(
        st.Spheres([[0.0, 0, 0], [9, 0, 0]], [1.0, 2], (0.5, 0.5, 0.5)),
        st.Lights([[1.0, 2, 3]]),
        st.Camera(roll=0.1, look_at=(0, 0, 0), principal_point=(0, 0), pixel_aspect=1),
        st.Planes([[0.0, 0, 0]], [[0.0, 0, 1]], (0.5, 0.5, 0.5)),
    )
    for place, parameter in places.items():
        assert parameter.value(scene).shape == shapes[rows[place][2]], place


@pytest.mark.parametrize("owner", ["spheres", "lights", "camera"])
def test_the_table_says_what_the_fields_say(owner, rows):
    """The comments of a class's fields are written by hand, the table comes from the registry."""
    source = (ROOT / "spheretrace_jax" / "scene" / f"{owner}.py").read_text().splitlines()
    said, above = {}, ""
    for line in source:
        comment = line.partition("#:")[2].strip()
        if field := re.match(r"    (\w+): (?:Float|Scalar)", line):
            said[field[1]] = above + comment
        above = f"{above}{comment} " if line.startswith("    #:") else ""
    compared = 0
    for (name, place), row in rows.items():
        comment = said.get(place.rpartition(".")[2]) if f".{owner}." in place else None
        if comment is not None:
            moved = "moves edges" in comment, "moves shadow edges" in comment
            assert row[6] == {(True, False): "yes", (False, True): "of shadows"}.get(moved, "no"), (
                name
            )
            assert "differentiable" in comment and row[5] == "yes", name
            unit = next((u for u in ("radians", "world units") if u in comment), None)
            assert unit is None or row[3] == unit, name
            compared += 1
    assert compared == sum(p.owner == owner for p in PARAMETERS)
