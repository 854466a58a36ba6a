"""Settings of JAX for all tests: float64, no silent promotion of types or ranks, few programs."""

from pathlib import Path

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

#: Memory maps of a process above which its compiled programs are forgotten. Each program holds some
#: seven, a file of tests makes up to 10,000, and Linux grants 65,530: beyond, XLA crashes.
MANY_MAPS = 25_000


@pytest.fixture(autouse=True, scope="module")
def few_programs():
    """Forgets the compiled programs after a file of tests, once the process holds many."""
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and len(maps.read_bytes().splitlines()) > MANY_MAPS:
        jax.clear_caches()
