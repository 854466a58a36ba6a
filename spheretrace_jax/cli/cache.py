"""The cache of compiled programs: a folder in which JAX finds what earlier runs compiled."""

import hashlib
import platform
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import FlagCreatePairsOff, arg

from .arguments import Command, check_folder

# The standard mark of a cache folder (bford.info/cachedir); backups leave such folders out.
_TAG, _SIGNATURE = "CACHEDIR.TAG", "Signature: 8a477f597d28d172789f06886806bc55"


@dataclass(kw_only=True)
class CacheCommand(Command):
    """Show where compiled programs are kept, and how large they are.

    The commands that compile keep what they compiled in the user's cache, unless they are told
    not to: the next run then starts sooner.
    """

    clear: Annotated[bool, FlagCreatePairsOff, arg(help="delete the compiled programs")] = False

    def run(self) -> int:
        """Prints the folder and the size of the programs, and deletes these if asked to."""
        folder = user_folder()
        found = [file for each in folder.glob("*") if is_ours(each) for file in entries(each)]
        size = sum(file.stat().st_size for file in found)
        programs = sum(file.name.endswith("-cache") for file in found)
        if self.clear:
            for file in found:
                file.unlink()
        state = "deleted" if self.clear else "kept"
        print(f"{folder}: {programs} compiled programs {state}, {size / 1e6:.1f} MB")
        return 0


def user_folder() -> Path:
    """Returns the program's folder in the user's cache."""
    import platformdirs

    return platformdirs.user_cache_path("spheretrace_jax", appauthor=False)


def default_folder() -> Path:
    """Returns the cache of this version of JAX and this kind of processor.

    Programs compiled for another processor may use instructions that this one does not have.
    """
    import jax

    processor = hashlib.sha256(_processor().encode()).hexdigest()[:12]
    return user_folder() / f"jax-{jax.__version__}-{processor}"


def _processor() -> str:
    """Describes the processor: by its instructions where the system lists these."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    features = [line for line in lines if line.startswith(("flags", "Features"))]
    return " ".join([platform.machine(), platform.processor(), *features[:1]])


def use_cache(folder: Path) -> None:
    """Sets JAX's compilation cache of this process. **Raises:** `InputError`, `OSError`."""
    import jax

    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_compilation_cache_dir", str(folder.resolve()))
    # all programs: by default JAX keeps none that compiled in less than a second, as most do
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def use_default_cache() -> None:
    """Sets JAX's compilation cache to the user's, if that can be used; says so if it cannot."""
    try:
        folder = default_folder()
        if folder.is_dir() and any(folder.iterdir()) and not is_ours(folder):
            raise ValueError(f"{folder} was not made by spheretrace")
        use_cache(folder)
        if not (folder / _TAG).is_file():
            text = f"{_SIGNATURE}\n# compiled programs of spheretrace_jax\n"
            (folder / _TAG).write_text(text)
    except (ValueError, OSError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        print(f"spheretrace: warning: compiled programs are not kept: {reason}", file=sys.stderr)


def is_ours(folder: Path) -> bool:
    """Tells whether a folder is marked as a cache."""
    try:
        return (folder / _TAG).read_text().startswith(_SIGNATURE)
    except (OSError, ValueError):
        return False


def entries(folder: Path) -> list[Path]:
    """Returns the files that JAX keeps in a cache."""
    return [f for f in folder.glob("*") if f.is_file() and f.name.endswith(("-cache", "-atime"))]
