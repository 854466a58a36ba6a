"""What a feature that a scene does not need would cost: operations counted before compilation."""

import dataclasses

import jax

from ...rendering.render import draw
from ...scene.needs import Needs, needs
from ...scene.scene import Scene
from ...scene.settings import render_settings

# of pixels' sides: in one strip, so that every operation counts once per pixel
_SIDE, _BOUNCES = 64, 2


def operations(scene: Scene, needs: Needs) -> float:
    """How many arithmetic operations a small picture of the scene takes, one ray per pixel."""
    scene = scene.with_antialias(0)
    program = render_settings(scene, _SIDE, _SIDE, bounces=_BOUNCES, needs=needs)
    lowered = jax.jit(lambda scene: draw(scene, program)).lower(scene)
    counted = lowered.cost_analysis()
    assert counted is not None
    return float(counted["flops"])


def feature_costs(scene: Scene) -> dict[str, float]:
    """By how much each feature that is left out would add to a picture's operations.

    **Returns:** name by name a share of those of the scene's own picture: 0.7 for 70 % more.
    """
    found = needs(scene)
    # where objects cut one another only matters where edges are covered, which is not counted
    features = dataclasses.asdict(found)
    out = [name for name, value in features.items() if value is False and name != "crossings"]
    own = operations(scene, found)
    more = {name: dataclasses.replace(found, **{name: True}) for name in out}
    return {name: operations(scene, with_it) / own - 1 for name, with_it in more.items()}
