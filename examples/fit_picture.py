"""Fits colours, ka, kd, ks and the light of the nine spheres to their picture.

python examples/fit_picture.py [--size 96]
"""

import argparse
import warnings
from pathlib import Path

import jax
import numpy as np

import spheretrace_jax as st
from spheretrace_jax.fit.model.products import determined_products
from spheretrace_jax.study.benchmarks.wrong_start import wrong_start

SCENE = Path(__file__).parent.parent / "data" / "nine_spheres.txt"


def main() -> None:
    parser = argparse.ArgumentParser(description="Fit the nine spheres to their picture.")
    parser.add_argument("--size", type=int, default=96, help="width and height in pixels")
    size = parser.parse_args().size
    jax.config.update("jax_enable_x64", True)  # for more than six digits
    warnings.simplefilter("ignore", st.SceneWarning)

    truth = st.load_scene(SCENE).with_antialias(0)  # single rays, which compile quickly
    target = st.render(truth, width=size, height=size, bounces=1)
    start = wrong_start(truth)
    result = st.fit(
        start, target, bounces=1,
        callback=lambda p: print(f"step {p.step:2}: cost {p.cost:.3e}"),
    )  # fmt: skip
    print(result.trust.verdict)
    true = determined_products(truth)
    for name, value in determined_products(result.scene).items():
        print(f"{name:15} largest error {np.abs(value - true[name]).max():.1e}")


if __name__ == "__main__":
    main()
