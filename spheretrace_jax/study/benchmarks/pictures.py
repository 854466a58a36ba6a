"""Pictures: error against time of single rays and of covered edges, in both precisions."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from ...rendering.render import draw
from ...scene.scene import Scene
from ...scene.settings import render_settings
from .reference import reference_picture
from .settings import Settings
from .work_precision import Diagram, Point, Program, clock, relative


def pictures(scene: Scene, settings: Settings) -> Iterator[Diagram]:
    """Yields the diagram of a scene's pictures."""
    exact = scene.astype(jnp.float64)
    size: dict[str, Any] = dict(width=settings.size, height=settings.size)
    drawn: dict[str, Any] = dict(highlight=settings.highlight, bounces=settings.bounces)
    settings.say(f"picture: {settings.truth_rays} rays per pixel for the truth")
    checked = render_settings(exact.with_antialias(0), **size, **drawn)
    truth, coarser = (
        np.asarray(reference_picture(exact, checked, settings.truth_rays // k)(exact))
        for k in (1, 2)
    )
    programs = {}
    methods = (("single rays", 0, settings.rays), ("covered edges", 1, settings.covered))
    for method, antialias, knobs in methods:
        for dtype in ("float32", "float64"):
            # quick studies have single rays alone in float64: covered edges compile for long
            for k in knobs if dtype == "float32" or settings.thorough else knobs[: 1 - antialias]:
                sampled = scene.with_antialias(antialias).astype(dtype)
                picture = partial(
                    draw, settings=render_settings(sampled, samples=k, **size, **drawn)
                )
                settings.say(f"picture: {method}, {dtype}, {k} x {k}")
                programs[method, dtype, k] = Program(picture, sampled)
    settings.say("picture: errors and times")
    taken = clock(programs, settings.seconds)
    points = [
        Point(
            "picture", f"{method}, {dtype}", f"{k} x {k}", float(k), dtype, taken[method, dtype, k],
            program.compile_seconds, relative(program(), truth), program.memory,
        )
        for (method, dtype, k), program in programs.items()
    ]  # fmt: skip
    yield Diagram(
        "picture",
        f"Pictures, {settings.size} x {settings.size}",
        "relative error of the picture, L2",
        f"the mean of {settings.truth_rays} or more single rays per pixel on a Fibonacci lattice",
        relative(coarser, truth),
        tuple(points),
    )
