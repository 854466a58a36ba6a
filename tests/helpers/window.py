"""The program `spheretrace view` in a process of its own, for browsers to open."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def window(folder: Path, *words: str) -> Iterator[str]:
    """Runs `spheretrace view` in a folder. **Yields:** the address of its page."""
    program = "from spheretrace_jax.cli.main import main; main()"
    command = [sys.executable, "-W", "ignore", "-c", program, "view", *words, "--no-browser"]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().split(": ")[1].split(" ")[0]
        finally:
            process.send_signal(2)
            assert process.wait(timeout=30) == 130
