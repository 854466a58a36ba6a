"""The command line, run in this process or in another, and the files that it leaves."""

import contextlib
import io
import os
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import patch

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import spheretrace_jax as st
from spheretrace_jax.cli import main

TEXT = """\
-.01 .01 500 800 // theta phi mu distance
0
1
100 500 800
2
-90 0 0 80  .9 .3 .1  .2 .6 .3   8  0 0 0
 90 0 0 70  .2 .4 .8  .3 .5 .4  12  0 0 0
"""
FIT = ("fit", "start.txt", "target.exr", "-o", "fitted.txt", "--dtype", "float64")

#: Every command that writes, with its files.
WRITING = {
    "render png": (("render", "scene.txt", "-o", "out.png", "--size", "32x24"), ["out.png"]),
    "render exr": (("render", "scene.txt", "-o", "out.exr", "--size", "32x24"), ["out.exr"]),
    "fit": ((*FIT, "--free", "kd,ks"), ["fitted.txt"]),
    "convert": (("convert", "scene.txt", "out.pov"), ["out.pov"]),
}
REPORT = ["report/comparison.png", "report/cost.png", "report/report.md"]


def fill(folder: Path) -> None:
    """Puts a scene, its picture and a start with wrong coefficients into a folder."""
    (folder / "scene.txt").write_text(TEXT)
    truth = st.load_scene(folder / "scene.txt", np.float64)
    st.write_image(folder / "target.exr", st.render(truth, width=24, height=24))
    wrong = eqx.tree_at(
        lambda s: (s.spheres.kd, s.spheres.ks), truth, (jnp.full(2, 0.4), jnp.full(2, 0.2))
    )
    st.save_scene(folder / "start.txt", wrong)


@contextlib.contextmanager
def workplace() -> Iterator[Path]:
    """Changes to a new folder with these files, which every user may read."""
    with tempfile.TemporaryDirectory() as name, contextlib.chdir(name):
        Path(name).chmod(0o755)
        fill(Path(name))
        yield Path(name)


def status_of(*words: object) -> int:
    """Runs the program in this process, and returns its exit status."""
    with (
        patch.object(sys, "argv", ["spheretrace", *map(str, words)]),
        patch.object(os, "_exit", sys.exit),
        patch.object(sys, "unraisablehook", sys.unraisablehook),
        patch.object(main, "use_default_cache"),  # sets JAX for the whole process
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("always")
        try:
            main.main()
        except SystemExit as end:
            return end.code or 0
    raise AssertionError("main did not exit")


def spheretrace(*words: object) -> tuple[int, str, str]:
    """Runs the program in this process: `(status, stdout, stderr)`."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = status_of(*words)
    return status, out.getvalue(), err.getvalue()


def files(folder: Path) -> dict[str, bytes]:
    """Returns the contents of all files in a folder and its folders."""
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


def python(*words: str, folder: Path, cache: Path | None = None) -> subprocess.CompletedProcess:
    """Runs Python in another process. **Arguments:** `cache`: in place of the user's cache."""
    cache = Path(tempfile.gettempdir()) / "spheretrace_tests_cache" if cache is None else cache
    environment = os.environ | {"JAX_PLATFORMS": "cpu", "XDG_CACHE_HOME": str(cache)}
    return subprocess.run(
        [sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True
    )


@contextlib.contextmanager
def disk_full(size: int = 128) -> Iterator[None]:
    """Limits the size of files, in bytes, as a full disk would."""
    import resource

    limit = resource.RLIMIT_FSIZE
    before = resource.getrlimit(limit)
    resource.setrlimit(limit, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(limit, before)


@contextlib.contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """Protects a folder from writing; root runs as another user meanwhile."""
    folder.chmod(0o555)
    root = os.geteuid() == 0
    try:
        if root:
            os.setresuid(65534, 65534, 0)
        yield
    finally:
        if root:
            os.setresuid(0, 0, 0)
        folder.chmod(0o755)
