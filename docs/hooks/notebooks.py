"""Executes the tutorials' notebooks while the site is built: pages of their text and outputs.

The repository holds notebooks without outputs. A cell that fails ends the build. With `NOTEBOOKS=0`
in the environment nothing is executed, which suits work on the text.
"""

import os
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import PurePosixPath

import nbformat
from mkdocs.structure.files import File, Files
from nbclient import NotebookClient
from nbconvert import MarkdownExporter

#: Seconds that a cell may take, compilation included.
CELL = 600

#: Notebooks at a time: each mostly compiles, which takes one core.
TOGETHER = 2


def on_files(files: Files, *, config) -> Files:
    """Adds a page for each notebook, which itself stays, as a file to download."""
    found = [file for file in files if file.src_uri.endswith(".ipynb")]
    with ThreadPoolExecutor(TOGETHER) as pool:
        for file, (page, pictures) in zip(found, pool.map(converted, found), strict=True):
            uri = PurePosixPath(file.src_uri)
            made = {uri.with_suffix(".md").name: page} | pictures
            for name, content in made.items():
                files.append(File.generated(config, str(uri.parent / name), content=content))
    return files


def converted(file: File) -> tuple[str, dict[str, bytes]]:
    """Executes a notebook. **Returns:** its Markdown, and its pictures by their names."""
    notebook = nbformat.reads(file.content_string, as_version=4)
    if os.environ.get("NOTEBOOKS") != "0":
        with tempfile.TemporaryDirectory() as folder:
            client = NotebookClient(
                notebook, timeout=CELL, kernel_name="python3", coalesce_streams=True,
                resources={"metadata": {"path": folder}},
            )  # fmt: skip
            client.execute()
        for cell in notebook.cells:
            if cell.cell_type == "code":  # a line of progress that was cleared is an empty text
                cell.outputs = [o for o in cell.outputs if o.get("data", o) != {"text/plain": ""}]
    name = file.src_uri.rpartition("/")[2]
    stem = name.removesuffix(".ipynb")
    resources = {"unique_key": stem, "output_files_dir": f"{stem}_files"}
    page, made = MarkdownExporter().from_notebook_node(notebook, resources=resources)
    title, _, rest = page.lstrip().partition("\n")
    note = f"*This page is a notebook: [download {name}]({name}) and run it.*"
    return f"{title}\n\n{note}\n{rest}", made["outputs"]
