"""The cache of compiled programs: kept by itself, never in the way."""

import re
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import files, fill, python

import spheretrace_jax as st

PROGRAM = ("-m", "spheretrace_jax.cli")
RENDER = ("render", "scene.txt", "-o", "out.exr", "--size", "16x12")


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Runs the program with a cache of its own: `(status, stdout, stderr)`."""
    monkeypatch.chdir(tmp_path)
    fill(tmp_path)

    def run(*words: str) -> tuple[int, str, str]:
        done = python(*PROGRAM, *words, folder=tmp_path, cache=tmp_path / "cache")
        return done.returncode, done.stdout, done.stderr

    return run


def kept() -> dict[str, bytes]:
    return {name: data for name, data in files(Path("cache")).items() if name.endswith("-cache")}


def test_programs_are_kept_and_cleared(run):
    assert run(*RENDER, "--no-cache")[0] == 0 and not Path("cache").exists()
    assert run(*RENDER)[::2] == (0, "")
    first = st.read_image("out.exr")
    programs = kept()
    assert len(programs) > 3
    assert run(*RENDER)[::2] == (0, "") and kept().keys() == programs.keys()
    np.testing.assert_array_equal(st.read_image("out.exr"), first)
    other = next(Path("cache").rglob("*-cache")).with_name("notes.txt")
    other.write_text("not JAX's")
    status, out, err = run("cache")
    assert (status, err) == (0, "")
    assert re.search(rf"cache.spheretrace_jax: {len(programs)} compiled programs kept, \d", out)
    assert "deleted" in run("cache", "--clear")[1]
    assert not kept() and other.is_file()
    assert ": 0 compiled programs kept, 0.0 MB" in run("cache")[1]


@pytest.mark.slow
def test_damaged_and_foreign_caches_are_ignored(run):
    assert run(*RENDER)[0] == 0
    for file in Path("cache").rglob("*-cache"):
        file.write_bytes(b"damaged")
    status, _, err = run(*RENDER)
    assert status == 0 and len(err.splitlines()) == 1
    assert "compiled programs are damaged and not used" in err
    next(Path("cache").rglob("CACHEDIR.TAG")).unlink()
    status, _, err = run(*RENDER)
    assert status == 0 and len(err.splitlines()) == 1
    assert "compiled programs are not kept: " in err and "was not made by spheretrace" in err


def test_cache_that_is_a_file(run):
    Path("cache").write_text("a file")
    status, _, err = run(*RENDER)
    assert status == 0 and len(err.splitlines()) == 1 and "are not kept" in err
