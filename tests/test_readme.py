"""The README's Python runs as it stands, block after block."""

import re
from pathlib import Path

import jax
import pytest

README = Path(__file__).parents[1] / "README.md"
BLOCKS = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Changes to a folder with the data of a checkout."""
    (tmp_path / "data").symlink_to(README.parent / "data")
    monkeypatch.chdir(tmp_path)


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
    assert len(BLOCKS) == 6
    run(BLOCKS)
