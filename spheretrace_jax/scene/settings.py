"""`RenderSettings`: the static arguments of a picture, checked."""

import dataclasses
from typing import get_args

import equinox as eqx
from jax.sharding import NamedSharding
from jaxtyping import Array, Float

from ..base.errors import InputError
from ..base.types import Highlight
from ..xla.sharding import Rows, rows_of_device, rows_sharding
from .needs import Needs, needs_of
from .numbers import whole_number
from .scene import Scene

#: Limit of the samples along a pixel's side. More would never end: time grows with the square.
MOST_SAMPLES = 256

#: Limit of the bounces where paths branch. More would never end: n bounces follow 2^n paths.
MOST_BRANCHINGS = 16


class RenderSettings(eqx.Module):
    """The arguments of a picture besides its scene: static, except `box`."""

    width: int = eqx.field(static=True)
    height: int = eqx.field(static=True)
    highlight: Highlight = eqx.field(static=True)
    bounces: int = eqx.field(static=True)
    samples: int = eqx.field(static=True)
    antialias: bool = eqx.field(static=True)
    needs: Needs = eqx.field(static=True)
    rows: Rows = eqx.field(static=True)  #: the rows computed: all, or those of one device
    sharding: NamedSharding | None = eqx.field(static=True)  #: of the rows on several devices
    #: width and height, in pixels, of the box filter around a pixel's centre; None: one pixel
    box: Float[Array, ""] | None = None

    @property
    def side(self) -> Float[Array, ""] | float:
        """Returns the width and height of a sample's box filter, in pixels."""
        return (1.0 if self.box is None else self.box) / self.samples

    @property
    def of_device(self) -> "RenderSettings":
        """Returns the settings of one device's rows of the picture."""
        assert self.sharding is not None
        rows = rows_of_device(self.height, self.sharding)
        return dataclasses.replace(self, rows=rows, sharding=None)


def render_settings(
    scene: Scene,
    width: int,
    height: int,
    *,
    highlight: Highlight = "phong",
    bounces: int = 5,
    samples: int = 1,
    needs: Needs | None = None,
    sharding: NamedSharding | None = None,
) -> RenderSettings:
    """Checks and completes the static arguments of `render`.

    **Arguments:** `scene`: a checked one.

    **Raises:** `InputError` for sizes, samples or bounces out of range, unknown highlights,
    and shardings that divide other axes than rows.
    """
    width, height, bounces, samples = map(
        whole_number, ("width", "height", "bounces", "samples"), (width, height, bounces, samples)
    )
    for name, value, least in (("width", width, 1), ("height", height, 1), ("bounces", bounces, 0)):
        if value < least:
            raise InputError(f"{name} must be at least {least}, got {value}")
    if not 1 <= samples <= MOST_SAMPLES:
        raise InputError(f"samples must be in 1..{MOST_SAMPLES}, got {samples}")
    check_highlight(highlight)
    needs = needs_of(scene) if needs is None else needs
    bounces = bounces if needs.bounces else 0
    if needs.depth is not None:
        bounces = min(bounces, needs.depth)
    if needs.branching and bounces > MOST_BRANCHINGS:
        raise InputError(
            "where an object both reflects and transmits, n bounces follow 2^n paths: "
            f"bounces must be at most {MOST_BRANCHINGS}, got {bounces}"
        )
    sharding = None if sharding is None else rows_sharding(sharding)
    antialias, rows = bool(scene.antialias), Rows(height)
    return RenderSettings(
        width, height, highlight, bounces, samples, antialias, needs, rows, sharding
    )  # fmt: skip


def check_highlight(highlight: str) -> None:
    """Checks a highlight's name. **Raises:** `InputError` for names of no model."""
    names = get_args(Highlight)
    if highlight not in names:
        raise InputError(f"highlight must be one of {', '.join(names)}, got {highlight!r}")
