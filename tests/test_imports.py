"""The import rule: a folder imports only from folders above it, and nothing is a cycle."""

import ast
from functools import cache
from pathlib import Path

import pytest

PACKAGE = "spheretrace_jax"
ROOT = Path(__file__).parents[1] / PACKAGE
FILES = {
    ".".join([PACKAGE, *file.relative_to(ROOT).with_suffix("").parts]).removesuffix(
        ".__init__"
    ): file
    for file in sorted(ROOT.rglob("*.py"))
}

#: Of a folder the order of its entries: an entry imports only from itself and from those before it.
ORDER = {
    PACKAGE: "base < xla < scene < acceleration < tracing < antialiasing < rendering"
    " < files < fit < study < calibration < display < cli",
    f"{PACKAGE}.fit": "model < normal_equations < problem < solver < diagnosis"
    " < multistart, solution < result < fit",
    f"{PACKAGE}.study": "checks < benchmarks < study",
}
#: Folders that only compute, without files, plots and command line: the core, fit and study.
COMPUTE = "base xla scene acceleration tracing antialiasing rendering fit study".split()
#: Modules whose classes have methods that show something: these import `display` when called.
SHOWING = [f"{PACKAGE}.{name}" for name in ("scene.scene", "fit.result", "calibration.lights")]
HOST_LIBRARIES = {"OpenImageIO", "matplotlib", "rich", "tyro"}


@cache
def tree(module: str) -> ast.Module:
    return ast.parse(FILES[module].read_text(encoding="utf-8"))


def imports(module: str, *, when_loaded: bool = False) -> set[str]:
    """Returns the full names of the modules that a module imports, but for methods that show.

    **Arguments:** `when_loaded`: leave out imports inside functions, which run when called.
    """
    package = module if FILES[module].name == "__init__.py" else module.rpartition(".")[0]
    found = set()
    for node in nodes(tree(module), when_loaded):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package.split(".")[: len(package.split(".")) + 1 - node.level]
            source = ".".join([*base, *filter(None, [node.module])]) if node.level else node.module
            for alias in node.names:
                inner = f"{source}.{alias.name}"
                found.add(inner if inner in FILES else source)
    if module in SHOWING and not when_loaded:
        found = {name for name in found if entry(name, PACKAGE) != "display"}
    return found


def test_showing_modules_load_no_display():
    for module in SHOWING:
        loaded = imports(module, when_loaded=True)
        assert not [name for name in loaded if entry(name, PACKAGE) == "display"]


def nodes(node: ast.AST, when_loaded: bool):
    for child in ast.iter_child_nodes(node):
        if not (when_loaded and isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef)):
            yield child
            yield from nodes(child, when_loaded)


def entry(module: str, folder: str) -> str | None:
    """Returns the entry of a folder that a module is in, None if it is outside of the folder."""
    if not module.startswith(f"{folder}."):
        return None
    return module.removeprefix(f"{folder}.").split(".")[0]


def libraries(module: str, *, when_loaded: bool = False) -> set[str]:
    return {name.split(".")[0] for name in imports(module, when_loaded=when_loaded)}


def members(*folders: str) -> list[str]:
    return [module for module in FILES if entry(module, PACKAGE) in folders]


def test_imports_are_found():
    images = f"{PACKAGE}.files.images"
    expected = {"OpenImageIO", "numpy", f"{PACKAGE}.base.errors", f"{PACKAGE}.files.atomic"}
    assert expected <= imports(images)
    loaded = imports(images, when_loaded=True)
    assert "OpenImageIO" not in loaded and f"{PACKAGE}.files.atomic" in loaded
    assert f"{PACKAGE}.fit.fit" in imports(f"{PACKAGE}.fit")
    assert len(members("files")) >= 5 and len(members(*COMPUTE)) >= 50


@pytest.mark.parametrize("folder", ORDER)
def test_order(folder):
    levels = enumerate(ORDER[folder].split(" < "))
    level = {name: number for number, names in levels for name in names.split(", ")}
    entries = {entry(module, folder) for module in FILES} - {None}
    assert entries == set(level), "the order names every entry of the folder, and no other"
    upward = [
        f"{module} imports {used}"
        for module in FILES
        for used in sorted(imports(module))
        if (user := entry(module, folder))
        and (source := entry(used, folder)) not in (None, user)
        and level[source] >= level[user]
    ]
    assert upward == []


def test_computation_knows_no_files():
    for module in members(*COMPUTE):
        folders = {entry(name, PACKAGE) for name in imports(module)}
        assert not folders & {"files", "cli"}, module
        assert not libraries(module) & HOST_LIBRARIES, module


def test_package_loads_no_library_of_the_host():
    # nothing imports the command line, which may load what it needs
    for module in set(FILES) - set(members("cli")):
        assert not {name for name in imports(module) if entry(name, PACKAGE) == "cli"}, module
        assert not libraries(module, when_loaded=True) & HOST_LIBRARIES, module


def test_no_cycle():
    """Counts imports inside functions as well, except those of the package's public names."""
    edges = {name: imports(name) & set(FILES) - {PACKAGE} for name in FILES}
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
    assert users <= {*members("cli"), f"{PACKAGE}.files.images"}
    assert not [name for name in users if PACKAGE in imports(name, when_loaded=True)]


@pytest.mark.parametrize("module", FILES)
def test_no_module_changes_jax_settings(module):
    calls = [
        ast.unparse(node.func) for node in ast.walk(tree(module)) if isinstance(node, ast.Call)
    ]
    changes = [name for name in calls if name.endswith("config.update")]
    assert not changes or module == f"{PACKAGE}.cli.cache"  # which is a process of its own
    targets = [
        ast.unparse(target)
        for node in ast.walk(tree(module))
        if isinstance(node, ast.Assign)
        for target in node.targets
    ]
    assert not [name for name in targets if ".config." in name]
