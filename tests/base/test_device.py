"""A machine without the device that JAX is told to use."""

import os
import subprocess
import sys

import jax
import pytest
from helpers.commands import TEXT

import spheretrace_jax as st
from spheretrace_jax.base.device import check_device


@pytest.mark.parametrize("error", [AssertionError(), RuntimeError("Unable to initialize backend")])
def test_no_device(error, monkeypatch):
    def fail():
        raise error

    monkeypatch.setattr(jax, "default_backend", fail)
    with pytest.raises(st.InputError, match="JAX finds no device: JAX_PLATFORMS is"):
        check_device.__wrapped__()


@pytest.mark.slow
@pytest.mark.parametrize("platform", ["cuda", "nonsense"])
def test_the_command_line_says_so_in_one_line(platform, tmp_path):
    (tmp_path / "scene.txt").write_text(TEXT)
    words = ("render", "scene.txt", "-o", "a.png", "--no-cache")
    done = subprocess.run(
        [sys.executable, "-m", "spheretrace_jax.cli", *words],
        env=os.environ | {"JAX_PLATFORMS": platform, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    said = done.stderr.splitlines()
    assert (done.returncode, done.stdout) == (2, "") and len(said) == 1
    assert said[0].startswith(f"spheretrace: JAX finds no device: JAX_PLATFORMS is '{platform}'")
    assert not (tmp_path / "a.png").exists()
