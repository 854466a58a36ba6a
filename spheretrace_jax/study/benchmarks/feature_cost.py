"""Feature costs: the operations that unneeded features would add, counted before compilation."""

import dataclasses

import jax

from ...rendering.render import draw
from ...scene.needs import Needs, needs
from ...scene.scene import Scene
from ...scene.settings import render_settings

# Side, in pixels, and bounces of the picture whose operations are counted. The picture is one
# strip, so that every operation counts once per pixel.
_SIDE, _BOUNCES = 64, 2


def operations(scene: Scene, needs: Needs) -> float:
    """Counts the arithmetic operations of a small picture of the scene, one ray per pixel."""
    scene = scene.with_antialias(0)
    settings = render_settings(scene, _SIDE, _SIDE, bounces=_BOUNCES, needs=needs)
    lowered = jax.jit(lambda scene: draw(scene, settings)).lower(scene)
    analysis = lowered.cost_analysis()
    assert analysis is not None
    return float(analysis["flops"])


def feature_costs(scene: Scene) -> dict[str, float]:
    """Computes the operations that each unneeded feature would add to a scene's picture.

    **Returns:** for each feature a share of the picture's operations: 0.7 for 70 % more.
    """
    minimal = needs(scene)
    # crossings only matter for covered edges, which are not counted
    flags = dataclasses.asdict(minimal)
    unneeded = [name for name, value in flags.items() if value is False and name != "crossings"]
    least = operations(scene, minimal)
    larger = {name: dataclasses.replace(minimal, **{name: True}) for name in unneeded}
    return {name: operations(scene, more) / least - 1 for name, more in larger.items()}
