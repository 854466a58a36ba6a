"""Writes the reference from the code: public names by their docstrings, and the parameters."""

import dataclasses
import os
import re
import subprocess
import sys
from typing import get_args

import spheretrace_jax as st
from spheretrace_jax.scene.parameters import LIGHT_PLACES, PARAMETERS, Parameter

NAME = re.compile(r"^::: st\.(\w+)$", re.MULTILINE)
TABLE = "<!-- the table of parameters -->"
COMMANDS = "<!-- the commands -->"

OWNERS = {
    "spheres": st.Spheres, "lights": st.Lights, "planes": st.Planes, "camera": st.Camera,
    "scene": st.Scene,
}  # fmt: skip
RANGES = {
    "unit": "0 to 1", "positive": "above 0", "nonnegative": "0 or above",
    "refraction": "1 or above", "any": "any",
}  # fmt: skip


def on_page_markdown(markdown: str, **_) -> str:
    """Puts docstrings, the table and the commands' help where a page asks for them."""
    if COMMANDS in markdown:
        markdown = markdown.replace(COMMANDS, helps())
    return NAME.sub(directive, markdown).replace(TABLE, table())


def helps() -> str:
    """Returns what each command says of itself, in a section each."""
    from spheretrace_jax.cli.commands import COMMANDS

    return "\n".join(f"## {name}\n\n```text\n{help_of(name)}\n```\n" for name in COMMANDS)


def help_of(command: str) -> str:
    words = [sys.executable, "-m", "spheretrace_jax.cli", command, "--help"]
    plain = os.environ | {"COLUMNS": "84", "NO_COLOR": "1", "TERM": "dumb"}
    said = subprocess.run(words, env=plain, capture_output=True, text=True, check=True)
    return said.stdout.strip()


def directive(found: re.Match) -> str:
    """Returns what mkdocstrings takes for a public name, which it looks for where it is defined."""
    public = getattr(st, found[1])
    label = f"st.{found[1]}"
    return (
        f'<a id="{label}"></a>\n\n::: {public.__module__}.{public.__qualname__}\n'
        f"    options:\n      heading: {label}\n      toc_label: {label}\n"
    )


def table() -> str:
    """Returns the parameters of a scene as a table, and below what is no parameter."""
    head = (
        "name",
        "where",
        "shape",
        "unit",
        "range",
        "differentiable",
        "moves edges",
        "may be fitted",
    )
    rows = [head, ["---"] * len(head), *map(row, PARAMETERS)]
    lines = ["| " + " | ".join(cells) + " |" for cells in rows]
    return "\n".join([*lines, "", "Not differentiable, as these select code:", "", *static()])


def row(parameter: Parameter) -> list[str]:
    attribute = parameter.attribute or parameter.name
    where = "scene" if parameter.owner == "scene" else f"scene.{parameter.owner}"
    return [
        f"`{parameter.name}`",
        f"`{where}.{attribute}`",
        shape(OWNERS[parameter.owner], attribute),
        parameter.unit or "–",
        RANGES[parameter.range],
        "yes",
        moved(parameter),
        "yes" if parameter.fitted else "no",
    ]


def moved(parameter: Parameter) -> str:
    if parameter.moves_silhouettes:
        return "yes"
    return "of shadows" if parameter.name in LIGHT_PLACES else "no"


def shape(owner: type, attribute: str) -> str:
    """Returns the axes of an array by its type: `(n, 3)`; `()` of a number."""
    kind = next(f.type for f in dataclasses.fields(owner) if f.name == attribute)
    kinds = [k for k in (*get_args(kind), kind) if hasattr(k, "dim_str")]
    axes = kinds[0].dim_str.split()
    return f"({', '.join(axes)}{',' if len(axes) == 1 else ''})"


def static() -> list[str]:
    """Returns the fields that are no arrays, by their classes."""
    found = {
        name: [f.name for f in dataclasses.fields(owner) if f.metadata.get("static")]
        for name, owner in OWNERS.items()
    }
    return [
        f"- `{'scene' if name == 'scene' else 'scene.' + name}`: "
        + ", ".join(f"`{field}`" for field in fields)
        for name, fields in found.items()
        if fields
    ]
