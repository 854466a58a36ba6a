"""Fits colours and a light with Adam: a loss and an optimiser of one's own, in a dozen lines.

python examples/optax_loop.py [--steps N]
"""

import argparse
from functools import partial
from pathlib import Path
from typing import Any

import jax
import optax

import spheretrace_jax as st

FILE = Path(__file__).parent.parent / "data" / "nine_spheres.txt"


def main(steps: int) -> st.Scene:
    """Fits to a rendered picture, from grey spheres under another light, and prints errors."""
    render = partial(st.render, width=64, height=64, bounces=0)
    truth = st.load_scene(FILE).with_antialias(0)
    target = render(truth)
    start = st.replace(truth, {"color": 0.5, "light_position": (300.0, 300.0, 800.0)})
    needs = st.needs(start, free=("color", "light_position"))

    def loss(values):
        return ((render(st.replace(start, values), needs=needs) - target) ** 2).mean()

    values: Any = st.values(start, ("color", "light_position"))
    # a step changes each number by its learning rate at most: colours are parts, positions lengths
    rates: Any = {"color": optax.adam(0.02), "light_position": optax.adam(8.0)}
    optimiser = optax.multi_transform(rates, {name: name for name in rates})
    state = optimiser.init(values)
    slope = jax.jit(jax.value_and_grad(loss))
    for step in range(steps):
        error, slopes = slope(values)
        updates, state = optimiser.update(slopes, state)
        values = optax.apply_updates(values, updates)
        if step % 50 == 0 or step == steps - 1:
            print(f"step {step:4}: root-mean-square error {float(error) ** 0.5:.2e}")
    return st.replace(start, values)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Fit with an optimiser of Optax.")
    parser.add_argument("--steps", type=int, default=300)
    main(parser.parse_args().steps)
