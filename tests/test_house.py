"""The style of the house: docstrings, argument lists, sizes of files and folders."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1] / "spheretrace_jax"
FILES = sorted(ROOT.rglob("*.py"))

#: Words that open a clause, not a sentence: no docstring of a function opens with one of these.
CLAUSES = {"What", "Where", "Which", "Whether", "How", "Why", "Those", "That", "So"}
MOST_ARGUMENTS, MOST_ENTRIES, MOST_LINES = 7, 14, 350

Function = ast.FunctionDef | ast.AsyncFunctionDef


def functions(file: Path) -> Iterator[Function]:
    """Yields all functions of a file, also methods and nested functions."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, Function):
            yield node


def name(file: Path) -> str:
    return str(file.relative_to(ROOT))


@pytest.mark.parametrize("file", FILES, ids=name)
def test_docstrings_open_with_a_verb(file):
    docstrings = {f"{f.lineno} {f.name}": ast.get_docstring(f) for f in functions(file)}
    opening = {where: text.split()[0].strip("`,.:") for where, text in docstrings.items() if text}
    assert {where: word for where, word in opening.items() if word in CLAUSES} == {}


@pytest.mark.parametrize("file", FILES, ids=name)
def test_at_most_7_positional_arguments(file):
    counts = {
        f"{f.lineno} {f.name}": len(f.args.posonlyargs) + len(f.args.args)
        for f in functions(file)
        if f.name != "__init__"  # which fills the fields of a record
    }
    assert {where: count for where, count in counts.items() if count > MOST_ARGUMENTS} == {}


@pytest.mark.parametrize("file", FILES, ids=name)
def test_at_most_350_lines(file):
    lines = file.read_text(encoding="utf-8").count("\n")
    assert lines <= MOST_LINES


def test_at_most_14_entries_at_the_top():
    entries = [e.name for e in ROOT.iterdir() if not e.name.startswith(("_", "."))]
    assert len(entries) <= MOST_ENTRIES, entries


def test_folders_say_what_they_hold():
    folders = {file.parent for file in FILES}
    for folder in folders:
        text = (folder / "__init__.py").read_text(encoding="utf-8")
        assert ast.get_docstring(ast.parse(text)), folder


def test_no_test_imports_a_benchmark():
    tests = Path(__file__).parent
    for file in {*tests.rglob("*.py")} - {*(tests / "bench").glob("*.py"), Path(__file__)}:
        text = file.read_text(encoding="utf-8")
        assert "from bench" not in text and "import bench" not in text, file
