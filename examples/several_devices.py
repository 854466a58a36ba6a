"""Draw the nine spheres and fit them on several devices, each of which looks at its own rows.

python examples/several_devices.py [--size 96] [--devices 4]

The devices may be those of several processes, on this computer or on others. Each runs the same:

python examples/several_devices.py --address localhost:8476 --processes 2 --process 0
python examples/several_devices.py --address localhost:8476 --processes 2 --process 1
"""

import argparse
import warnings
from pathlib import Path

import equinox as eqx
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

    # all devices side by side, and the picture's rows on one after the other
    mesh = jax.make_mesh((jax.device_count(),), ("rows",))
    sharding = NamedSharding(mesh, PartitionSpec("rows"))

    scene = st.load_scene(SCENE).with_antialias(0)
    picture = st.render(scene, **size, bounces=1, sharding=sharding)
    for part in picture.addressable_shards:
        first, last, _ = part.index[0].indices(arguments.size)
        print(f"{part.device} has rows {first}..{last - 1}")

    # of what lies with other processes only all together can make a whole
    whole = np.asarray(process_allgather(picture, tiled=True))
    alone = np.asarray(st.render(scene, **size, bounces=1))
    print(f"one device draws the same to {np.abs(whole - alone).max():.0e}")

    # each device sums up the normal equations of its own rows; what is found all of them know
    kd = lambda s: s.spheres.kd
    start = eqx.tree_at(kd, scene, 0.5 * kd(scene))
    found = st.fit(start, picture, free=("kd", "ks"), bounces=1, sharding=sharding)
    print(found.trust.verdict)
    print(f"kd is off by {np.abs(np.asarray(kd(found.scene) - kd(scene))).max():.0e}")


if __name__ == "__main__":
    main()
