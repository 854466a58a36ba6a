"""Fits the positions and radii of spheres, and their light, to an antialiased picture.

python examples/fit_geometry.py [--size 96] [--output fit_geometry.png]
"""

import argparse

import jax
import jax.numpy as jnp
import numpy as np

import spheretrace_jax as st
from spheretrace_jax.files.images import to_srgb
from spheretrace_jax.fit import Progress

FREE = ("center", "radius", "light_position")


def two_over_a_floor() -> st.Scene:
    """Builds two spheres that cast shadows on a plane. Only antialiased edges have derivatives.

    The plane is known: a scene that is larger and farther by the same factor looks the same.
    """
    spheres = st.Spheres(
        center=[[-50.0, 10, -10], [50, -30, 60]],
        radius=[60.0, 45],
        color=[[0.9, 0.2, 0.1], [0.1, 0.8, 0.3]],
        kd=0.7,
    )
    camera = st.Camera(theta=-np.pi / 2, phi=0.1)
    floor = st.Planes([[0.0, 0, -100]], [[0.0, 0, 1]], (0.5, 0.5, 0.9))
    return st.Scene(spheres, st.Lights([[200.0, 300, 500]]), camera, floor, antialias=1)


def displaced(scene: st.Scene) -> st.Scene:
    """Displaces centres by half a radius, radii by 30 % and the light by 70 units."""
    s = scene.spheres
    shift = jnp.array([[0.35, -0.35, 0], [-0.35, 0.35, 0]]) * s.radius[:, None]
    stretch = jnp.array([0.7, 1.3])
    return st.replace(
        scene,
        {
            "center": s.center + shift,
            "radius": s.radius * stretch,
            "light_position": scene.lights.position + jnp.array([[40, -40, 40]]),
        },
    )


def errors(scene: st.Scene, truth: st.Scene) -> dict[str, float]:
    """Returns the largest errors: centres and radii per radius, the light per distance."""
    s, true = scene.spheres, truth.spheres
    light = np.linalg.norm(scene.lights.position - truth.lights.position)
    return {
        "center": float(np.abs((s.center - true.center) / true.radius[:, None]).max()),
        "radius": float(np.abs(s.radius / true.radius - 1).max()),
        "light_position": float(light / np.linalg.norm(truth.lights.position)),
    }


def save(path: str, pictures: dict[str, np.ndarray]) -> None:
    """Writes pictures with their titles, in rows of four."""
    from matplotlib.figure import Figure

    rows = -(-len(pictures) // 4)
    figure = Figure(figsize=(10, 2.7 * rows), layout="constrained")
    axes = figure.subplots(rows, 4, squeeze=False).flat
    for ax in axes:
        ax.set_axis_off()
    for ax, (title, picture) in zip(figure.axes, pictures.items(), strict=False):
        ax.imshow(np.clip(to_srgb(picture), 0, 1))
        ax.set_title(title)
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description="Fit the geometry of spheres to their picture.")
    parser.add_argument("--size", type=int, default=96, help="width and height in pixels")
    parser.add_argument("--output", default="fit_geometry.png", help="the picture to write")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)  # for more than six digits

    truth = two_over_a_floor()
    start = displaced(truth)
    needs = st.needs(truth, free=FREE)  # one compilation for all scenes of the fit
    draw = lambda scene: np.asarray(
        st.render(scene, width=arguments.size, height=arguments.size, needs=needs)
    )
    target = draw(truth)
    steps = [start]

    def show(progress: Progress) -> None:
        steps.append(progress.scene)
        error = ", ".join(f"{name} {e:.1e}" for name, e in errors(progress.scene, truth).items())
        print(f"step {progress.step:2}: cost {progress.cost:.1e}, off by {error}")

    result = st.fit(start, target, free=FREE, callback=show)
    print(result.trust.verdict)
    for name, error in errors(result.scene, truth).items():
        print(f"{name:15} largest error {error:.1e}")
    shown = np.unique(np.linspace(0, len(steps) - 1, 7).round().astype(int))
    scenes = {f"step {k}" if k else "start": steps[k] for k in shown}
    pictures = {title: draw(scene) for title, scene in scenes.items()}
    save(arguments.output, {"target": target} | pictures)
    print(f"{arguments.output}: the target and the fit over its steps")


if __name__ == "__main__":
    main()
