"""Tries a built wheel as a user would: in an empty environment, away from the checkout.

Runs `spheretrace demo`, the README's first block of Python, and a type checker on an example.

python tests/wheel/try_wheel.py dist
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).parents[2]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="the folder with one wheel")
    (wheel,) = parser.parse_args().folder.resolve().glob("*.whl")
    with tempfile.TemporaryDirectory() as name:
        try_wheel(wheel, Path(name))
    print(f"{wheel.name}: the demo, the README's first block and the types are as they should be")


def try_wheel(wheel: Path, folder: Path) -> None:
    """Installs a wheel into a new environment in an empty folder, and uses it there.

    **Raises:** `subprocess.CalledProcessError`: what the user would do fails.
    """
    venv.create(folder / "environment", with_pip=True)
    programs = folder / "environment" / "bin"
    python = programs / "python"

    def call(*command) -> None:
        subprocess.run([str(word) for word in command], cwd=folder, check=True)

    call(python, "-m", "pip", "install", "--quiet", wheel)
    call(programs / "spheretrace", "demo", "--no-cache")
    assert (folder / "spheretrace_demo" / "comparison.png").is_file()

    # the README reads its data from the checkout; the wheel has the same files
    where = "import spheretrace_jax; print(spheretrace_jax.__path__[0])"
    package = subprocess.check_output([str(python), "-c", where], cwd=folder, text=True).strip()
    assert Path(package).is_relative_to(folder.resolve()), f"not the wheel's package: {package}"
    assert (Path(package) / "display" / "view" / "page" / "index.html").is_file()
    shutil.copytree(Path(package) / "data", folder / "data")
    block = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL)
    call(python, "-c", block[0])
    assert (folder / "fitted.txt").is_file()

    shutil.copy(ROOT / "tests" / "wheel" / "typed_example.py", folder)
    call(sys.executable, "-m", "pyright", "--pythonpath", python, "typed_example.py")


if __name__ == "__main__":
    main()
