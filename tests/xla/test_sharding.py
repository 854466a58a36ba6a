"""Sharding: several devices, also of several processes, compute what one device computes."""

import os
import socket
import subprocess
import sys
from functools import cache
from pathlib import Path

import equinox as eqx
import helpers.sharded as sharded
import jax
import numpy as np
import pytest
from helpers.scenes import three_spheres
from jax.sharding import Mesh, NamedSharding, PartitionSpec

import spheretrace_jax as st

render = sys.modules["spheretrace_jax.rendering.render"]

PROGRAM = """
import sys
import jax

names, output, *process = sys.argv[1:]
if process:
    jax.config.update("jax_cpu_collectives_implementation", "gloo")
    address, count, rank = process
    jax.distributed.initialize(address, int(count), int(rank))

from helpers import sharded

sharded.save(names, output)
"""


def start(devices: int, *words: object) -> subprocess.Popen:
    """Starts another process with a number of devices."""
    flags = f"--xla_force_host_platform_device_count={devices}"
    environment = os.environ | {"XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, "-W", "ignore", "-c", PROGRAM, *map(str, words)]
    folder = Path(__file__).parents[1]
    return subprocess.Popen(command, env=environment, cwd=folder, stderr=subprocess.PIPE, text=True)


def end(process: subprocess.Popen) -> None:
    try:
        _, errors = process.communicate(timeout=300)
    finally:
        process.kill()
    assert process.returncode == 0, errors[-3000:]


def on_several_devices(names: str, folder: Path) -> dict[str, np.ndarray]:
    end(start(sharded.DEVICES, names, folder / "found.npz"))
    return dict(np.load(folder / "found.npz"))


def in_several_processes(names: str, folder: Path) -> list[dict[str, np.ndarray]]:
    with socket.socket() as free:
        free.bind(("localhost", 0))
        address = f"localhost:{free.getsockname()[1]}"
    count = sharded.PROCESSES
    files = [folder / f"found{rank}.npz" for rank in range(count)]
    devices = sharded.DEVICES // count
    running = [start(devices, names, file, address, count, rank) for rank, file in enumerate(files)]
    try:
        for process in running:
            end(process)
    finally:
        for process in running:
            process.kill()
    return [dict(np.load(file)) for file in files]


@cache
def on_one_device(names: str) -> dict[str, np.ndarray]:
    return sharded.compute(names, None)


def assert_same_results(found: dict[str, np.ndarray], names: str) -> None:
    """Asserts that results equal those of one device."""
    one = on_one_device(names)
    assert found.keys() == one.keys()
    for key, value in one.items():
        size = 1 + np.abs(value).max(initial=0)
        np.testing.assert_allclose(found[key] / size, value / size, 0, 1e-6, err_msg=key)


def test_eight_devices(tmp_path):
    names = "neighbours,pictures,operations,gradients,fits"
    assert_same_results(on_several_devices(names, tmp_path), names)


@pytest.mark.slow
def test_two_processes(tmp_path):
    """Runs each process with four devices, none of which the other process sees."""
    for found in in_several_processes("two_pictures", tmp_path):
        assert_same_results(found, "two_pictures")


@pytest.mark.slow
def test_pictures_and_fits_of_two_processes(tmp_path):
    names = "pictures,gradients,fits,auto_starts"
    for found in in_several_processes(names, tmp_path):
        assert_same_results(found, names)


@pytest.mark.slow
def test_edges_on_eight_devices(tmp_path):
    assert_same_results(on_several_devices("edges", tmp_path), "edges")


ROWS = NamedSharding(Mesh(jax.devices()[:1], "rows"), PartitionSpec("rows"))
PICTURE = dict(width=8, height=6)


def test_sharding_on_one_device_compiles_once(monkeypatch):
    traced = []
    inner = render.build_context
    counted = lambda *arguments: traced.append(1) or inner(*arguments)
    monkeypatch.setattr(render, "build_context", counted)
    scene = three_spheres().astype(np.float32)
    for factor in (0.9, 1.0):
        changed = jax.tree.map(lambda leaf, f=factor: leaf * f, scene)
        changed = eqx.tree_at(lambda s: s.spheres.ior, changed, scene.spheres.ior)  # at least 1
        found = st.render(changed, **PICTURE, sharding=NamedSharding(ROWS.mesh, ROWS.spec))
    assert len(traced) == 1 and found.dtype == np.float32
    np.testing.assert_allclose(found, st.render(scene, **PICTURE), atol=1e-6)


@pytest.mark.parametrize(
    ("sharding", "message"),
    [
        (NamedSharding(ROWS.mesh.abstract_mesh, ROWS.spec), "must be as NamedSharding"),
        (NamedSharding(ROWS.mesh, PartitionSpec()), "must divide rows and nothing else"),
        (NamedSharding(ROWS.mesh, PartitionSpec(None, "rows")), "must divide rows and nothing"),
    ],
)
def test_shardings_must_divide_rows(sharding, message):
    with pytest.raises(st.InputError, match=message) as error:
        st.render(three_spheres(), **PICTURE, sharding=sharding)
    assert "\n" not in str(error.value)


def test_mesh_must_leave_placement_to_the_compiler():
    mesh = jax.make_mesh((1,), ("rows",))
    with jax.set_mesh(mesh), pytest.raises(st.InputError, match=r"AxisType\.Auto"):
        st.render(three_spheres(), **PICTURE, sharding=NamedSharding(mesh, PartitionSpec("rows")))
