"""Data flows one way: the core knows no files, plots or command line, and nothing is a cycle."""

import ast
from functools import cache
from pathlib import Path

import pytest

PACKAGE = "spheretrace_jax"
FOLDER = Path(__file__).parent.parent / PACKAGE
FILES = {
    ".".join([PACKAGE, *file.relative_to(FOLDER).with_suffix("").parts]).removesuffix(
        ".__init__"
    ): file
    for file in sorted(FOLDER.rglob("*.py"))
}

CORE = """
    _types appearance area camera cells charts cost coverage edges errors grid halfplane
    intersect layers lists marked needs options outlines paths peel penumbra phases possible
    radiance render scene shading sharding texture tracing tracing.plain varying vec visibility
    world
""".split()
OUTER = tuple(
    f"{PACKAGE}.{name}"
    for name in "files report diagrams info check progress commands cli demo".split()
)
HOST_LIBRARIES = ("OpenImageIO", "matplotlib", "rich", "tyro")


@cache
def tree(module: str) -> ast.Module:
    return ast.parse(FILES[module].read_text(encoding="utf-8"))


def imports(module: str, *, when_loaded: bool = False) -> set[str]:
    """The modules that one imports, by their full names.

    **Arguments:** `when_loaded`: only those that are imported with it, not those that its
    functions import when called.
    """
    package = module if FILES[module].name == "__init__.py" else module.rpartition(".")[0]
    found = set()
    for node in walk(tree(module), when_loaded):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package.split(".")[: len(package.split(".")) + 1 - node.level]
            source = ".".join([*base, *filter(None, [node.module])]) if node.level else node.module
            for alias in node.names:
                inner = f"{source}.{alias.name}"
                found.add(inner if inner in FILES else source)
    return found


def walk(node: ast.AST, when_loaded: bool):
    for child in ast.iter_child_nodes(node):
        if not (when_loaded and isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef)):
            yield child
            yield from walk(child, when_loaded)


def within(module: str, packages: tuple[str, ...]) -> bool:
    return any(module == package or module.startswith(f"{package}.") for package in packages)


def below(module: str) -> list[str]:
    return [name for name in FILES if within(name, (f"{PACKAGE}.{module}",))]


def test_imports_are_found():
    found = imports(f"{PACKAGE}.files.images")
    assert {"OpenImageIO", "numpy", f"{PACKAGE}.errors", f"{PACKAGE}.files.atomic"} <= found
    found = imports(f"{PACKAGE}.files.images", when_loaded=True)
    assert "OpenImageIO" not in found and f"{PACKAGE}.files.atomic" in found
    assert f"{PACKAGE}.fit.solve" in imports(f"{PACKAGE}.fit")
    assert f"{PACKAGE}.cli" in FILES and len(below("files")) >= 5


@pytest.mark.parametrize("module", CORE)
def test_the_core_knows_nothing_around_it(module):
    outer = (*OUTER, f"{PACKAGE}.fit", f"{PACKAGE}.study", PACKAGE, *HOST_LIBRARIES)
    found = imports(f"{PACKAGE}.{module}")
    of_core = {f"{PACKAGE}.{name}" for name in CORE}
    assert not {name for name in found - of_core if within(name, outer)}


def test_the_plain_path_tracer_shares_nothing_with_the_fast_renderer():
    found = {name for name in imports(f"{PACKAGE}.tracing.plain") if within(name, (PACKAGE,))}
    assert found == {f"{PACKAGE}.{name}" for name in ("_types", "errors", "scene")}


def test_every_module_beside_the_core_has_a_known_place():
    known = (f"{PACKAGE}.fit", f"{PACKAGE}.study", *OUTER)
    places = (PACKAGE, *known, *(f"{PACKAGE}.{name}" for name in CORE))
    assert [name for name in FILES if name != PACKAGE and not within(name, places[1:])] == []


@pytest.mark.parametrize("part", ["fit", "study"])
def test_what_computes_knows_no_files_no_report_and_no_command_line(part):
    assert below(part)
    for module in below(part):
        found = imports(module)
        assert not {name for name in found if within(name, (*OUTER, *HOST_LIBRARIES))}, module
        assert PACKAGE not in found, f"{module} imports the package itself, and so everything"


def test_fit_does_not_know_what_studies_it():
    for module in below("fit"):
        assert not {name for name in imports(module) if within(name, (f"{PACKAGE}.study",))}


def test_the_package_loads_no_library_of_the_host():
    """What the command line itself imports does not count: nothing imports it."""
    program = {f"{PACKAGE}.cli", f"{PACKAGE}.commands"}
    assert not [name for name in set(FILES) - program if program & imports(name)]
    for module in set(FILES) - program:
        found = imports(module, when_loaded=True)
        assert not {name for name in found if within(name, HOST_LIBRARIES)}, module


def test_no_import_is_a_cycle():
    """Not even one that is put off until a function is called, but for the package's own names."""
    edges = {name: {x for x in imports(name) if x in FILES and x != PACKAGE} for name in FILES}
    edges[PACKAGE] = imports(PACKAGE) & set(FILES)
    done: set[str] = set()

    def visit(module: str, path: tuple[str, ...]) -> None:
        assert module not in path, " -> ".join([*path[path.index(module) :], module])
        if module not in done:
            for other in sorted(edges[module]):
                visit(other, (*path, module))
            done.add(module)

    for module in FILES:
        visit(module, ())


def test_only_programs_import_the_whole_package():
    users = {name for name in FILES if PACKAGE in imports(name)}
    programs = ("commands", "progress", "report", "files.images")
    assert users <= {f"{PACKAGE}.{name}" for name in programs}
    assert not [name for name in users if PACKAGE in imports(name, when_loaded=True)]


@pytest.mark.parametrize("module", FILES)
def test_no_module_changes_jax_s_settings(module):
    calls = [ast.unparse(n.func) for n in ast.walk(tree(module)) if isinstance(n, ast.Call)]
    changes = [name for name in calls if name.endswith("config.update")]
    assert not changes or module == f"{PACKAGE}.cli"  # which is a process of its own
    targets = [
        ast.unparse(target)
        for node in ast.walk(tree(module))
        if isinstance(node, ast.Assign)
        for target in node.targets
    ]
    assert not [name for name in targets if ".config." in name]
