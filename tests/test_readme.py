"""What the README shows runs as it stands: its Python, block after block, and its command lines."""

import re
import shlex
from pathlib import Path

import jax
import numpy as np
import pytest
from helpers.commands import TEXT, python

import spheretrace_jax as st

README = Path(__file__).parents[1] / "README.md"
SAID = README.read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", SAID, re.DOTALL)
COMMANDS = re.findall(r"^    ((?:spheretrace|python|make) .*?)(?:  +#.*)?$", SAID, re.MULTILINE)

#: The files that commands write.
WRITTEN = {
    "render": ["nine.png"],
    "fit": ["fitted.txt"],
    "study": ["study/study.md"],
    "convert": ["nine.pov"],
    "demo": ["spheretrace_demo/comparison.png"],
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Changes to a folder with what a checkout has, and a user's own files."""
    for name in ("data", "examples"):
        (tmp_path / name).symlink_to(README.parent / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(blocks: list[str]) -> dict:
    names: dict = {}
    with jax.enable_x64(False):
        for block in blocks:
            exec(compile(block, str(README), "exec"), names)
    return names


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_first_block(capsys):
    found = run(BLOCKS[:1])["found"]
    said = capsys.readouterr().out
    assert found.converged and found.trust.ok, found.trust.verdict
    assert said.startswith("converged after") and len(said.splitlines()) <= 10
    assert Path("fitted.txt").is_file()


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_all_blocks():
    assert len(BLOCKS) == 7
    run(BLOCKS)


def test_every_command_line_is_found():
    assert len(COMMANDS) == 15
    targets = re.findall(r"^(\w+):", (README.parent / "Makefile").read_text(), re.MULTILINE)
    made = [line.split()[1] for line in COMMANDS if line.startswith("make")]
    assert made == ["demo", "test"] and set(made) <= set(targets)  # `.ci/run` runs `make test`


@pytest.mark.slow
@pytest.mark.parametrize(
    "line", [line for line in COMMANDS if not line.startswith(("make", "spheretrace view"))]
)
def test_command_line(line, folder):
    scene = st.load_scene("data/nine_spheres.txt")
    st.write_image("photo.png", st.render(scene, width=96, height=96))
    st.write_image("mask.png", np.ones((96, 96, 3)))
    st.save_scene("geometry.txt", scene)
    Path("scene.txt").write_text(TEXT)
    program, *words = shlex.split(line)
    if program == "spheretrace":
        words = ["-c", "from spheretrace_jax.cli.main import main; main()", *words]
    done = python(*words, folder=folder, cache=folder / "cache")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.strip()
    for name in WRITTEN.get(line.split()[1], []):
        assert (folder / name).stat().st_size
