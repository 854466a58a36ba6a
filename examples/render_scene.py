"""Builds a scene in Python, draws it, and differentiates the picture.

python examples/render_scene.py [--size 480] [--output bowl.png]
"""

import argparse

import jax
import jax.numpy as jnp
import numpy as np

import spheretrace_jax as st


def bowl_of_marbles() -> st.Scene:
    """Builds marbles on a checkered table, with one mirror ball and one bubble."""
    angles = np.arange(7) * 2 * np.pi / 7
    ring = np.stack([150 * np.cos(angles), 150 * np.sin(angles), np.full(7, -40.0)], axis=1)
    hues = 0.5 + 0.4 * np.cos(angles[:, None] - [0, 2.1, 4.2])
    return st.Scene(
        st.Spheres(
            center=np.concatenate([[[0.0, 0, 0], [-40, 150, 60]], ring]),
            radius=[80.0, 45, *[40.0] * 7],
            color=np.concatenate([[[0.2, 0.2, 0.25], [0.1, 0.1, 0.1]], hues]),
            ka=0.2,
            kd=0.6,
            ks=[0.5, 0.4, *[0.3] * 7],
            exponent=[80.0, 60, *[25.0] * 7],
            kgr=[0.7, 0.1, *[0.1] * 7],
            kt=[0.0, 0.8, *[0.0] * 7],
        ),
        st.Lights([[300.0, -500, 700], [400, 600, 500]], [[0.7, 0.65, 0.55], [0.3, 0.35, 0.45]]),
        st.Camera(theta=0.3, phi=0.9, mu=600.0, distance=650.0),
        st.Planes(
            [[0.0, 0, -80]], [[0.0, 0, 1]], (0.75, 0.7, 0.6), kd=0.7, kgr=0.1,
            checker_color=(0.25, 0.3, 0.35), checker_size=80.0,
        ),
        background=(0.05, 0.07, 0.12),
        antialias=1,
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description="Draw a scene made in Python.")
    parser.add_argument("--size", type=int, default=480, help="width and height in pixels")
    parser.add_argument("--output", default="bowl.png", help="the picture to write")
    arguments = parser.parse_args()
    scene, size = bowl_of_marbles(), arguments.size

    # coverage is analytic at edges; 2 x 2 samples of each pixel are for the checker's squares
    picture = st.render(scene, width=size, height=size, bounces=3, samples=2)
    st.write_image(arguments.output, picture)
    print(f"{arguments.output}: {size} x {size}, mean colour {np.asarray(picture.mean((0, 1)))}")

    # render is a differentiable function: here the gradient of the picture's mean by the scene
    # (with single rays, which compile fast; edges add little to a mean)
    scene = scene.with_antialias(0)
    needs = st.needs(scene)  # outside jax.grad, which hides the scene's numbers
    mean = lambda s: jnp.mean(st.render(s, width=64, height=64, bounces=1, needs=needs))
    gradient = jax.jit(jax.grad(mean))(scene)
    print("d mean / d kd of each sphere:", np.asarray(gradient.spheres.kd).round(5))
    print("d mean / d height of each light:", np.asarray(gradient.lights.position[:, 2]).round(8))


if __name__ == "__main__":
    main()
