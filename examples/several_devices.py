"""Draws and fits the nine spheres on several devices, each with its rows of the picture.

python examples/several_devices.py [--size 96] [--devices 4]

The devices may belong to several processes, on one computer or on several. Each process runs this
program:

python examples/several_devices.py --address localhost:8476 --processes 2 --process 0
python examples/several_devices.py --address localhost:8476 --processes 2 --process 1
"""

import argparse
import warnings
from pathlib import Path

import jax
import numpy as np
from jax.experimental.multihost_utils import process_allgather
from jax.sharding import NamedSharding, PartitionSpec

import spheretrace_jax as st

SCENE = Path(__file__).parent.parent / "data" / "nine_spheres.txt"


def main() -> None:
    parser = argparse.ArgumentParser(description="Draw and fit a picture on several devices.")
    parser.add_argument("--size", type=int, default=96, help="width and height in pixels")
    parser.add_argument("--devices", type=int, help="pretend that the CPU is so many")
    parser.add_argument("--address", help="host:port of the first of several processes")
    parser.add_argument("--processes", type=int, help="how many there are")
    parser.add_argument("--process", type=int, help="which of them this is, from 0")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    if arguments.devices:
        jax.config.update("jax_num_cpu_devices", arguments.devices)
    if arguments.address:
        jax.distributed.initialize(arguments.address, arguments.processes, arguments.process)
    warnings.simplefilter("ignore", st.SceneWarning)
    size = dict(width=arguments.size, height=arguments.size)

    # a mesh of all devices, along which the picture's rows are divided
    mesh = jax.make_mesh((jax.device_count(),), ("rows",))
    sharding = NamedSharding(mesh, PartitionSpec("rows"))

    scene = st.load_scene(SCENE).with_antialias(0)
    picture = st.render(scene, **size, bounces=1, sharding=sharding)
    for shard in picture.addressable_shards:
        first, last, _ = shard.index[0].indices(arguments.size)
        print(f"{shard.device} has rows {first}..{last - 1}")

    # the rows of other processes can only be gathered by all processes together
    gathered = np.asarray(process_allgather(picture, tiled=True))
    single = np.asarray(st.render(scene, **size, bounces=1))
    print(f"one device draws the same to {np.abs(gathered - single).max():.0e}")

    # each device sums the normal equations of its rows; the solution is the same on all devices
    kd = scene.spheres.kd
    start = st.replace(scene, {"kd": 0.5 * kd})
    result = st.fit(start, picture, free=("kd", "ks"), bounces=1, sharding=sharding)
    print(result.trust.verdict)
    print(f"kd is off by {np.abs(np.asarray(result.scene.spheres.kd - kd)).max():.0e}")


if __name__ == "__main__":
    main()
