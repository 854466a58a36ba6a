"""Float32 against float64: how much the pixels differ, where most, and why."""

import collections
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from ...base.types import Highlight
from ...rendering.render import draw
from ...scene.needs import Needs
from ...scene.scene import Scene
from ...scene.settings import render_settings
from .error_causes import CAUSES, Cause, explain

# At most so many pixels, the worst, are looked into.
_MOST = 1024


@dataclasses.dataclass(frozen=True)
class StabilityRow:
    """A pixel that float32 shows otherwise than float64."""

    column: int  #: from 0 at the left
    row: int  #: from 0 at the top
    error: float  #: the largest difference of its red, green and blue
    ulps: float  #: the same in units in the last place of its brightest channel in float32
    cause: Cause
    factor: float  #: by what a rounding error is multiplied there
    object: str  #: what is seen there: "sphere 3"
    bounce: int  #: where the cause is: 0 where the eye's ray ends

    @property
    def place(self) -> str:
        """Where the cause is, in words."""
        return self.object + (f", at bounce {self.bounce}" if self.bounce else "")


@dataclasses.dataclass(frozen=True)
class StabilityTable:
    """How a scene's picture in float32 differs from that in float64. `print` shows it."""

    rows: tuple[StabilityRow, ...]  #: the pixels whose error shows, worst first, 1024 at most
    pixels: int
    limit: float  #: errors above this show
    shown: int  #: how many pixels have one
    median: float  #: of the errors of the pixels that have one
    largest: float  #: of all errors

    @property
    def share(self) -> float:
        """The part of the picture whose error shows."""
        return self.shown / self.pixels

    @property
    def ok(self) -> bool:
        """Whether float32 is good for all of the picture but a thousandth."""
        return self.share <= 1e-3 and bool(np.isfinite(self.largest))

    @property
    def counts(self) -> dict[Cause, int]:
        """How many of the rows each cause has, most first."""
        return dict(collections.Counter[Cause](row.cause for row in self.rows).most_common())

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to know and to do, in words: a sentence for each cause."""
        return tuple(
            CAUSES[cause].format(
                things=_some([row.object for row in self.rows if row.cause == cause]),
                pixels=f"{n} pixel{'s' * (n > 1)}",
                factor=f"{max(row.factor for row in self.rows if row.cause == cause):.0e}",
            )
            for cause, n in self.counts.items()
        )

    def __str__(self) -> str:
        lines = [
            f"float32 against float64: median error {self.median:.1e}, largest {self.largest:.1e}; "
            f"{self.shown} of {self.pixels} pixels are off by more than {self.limit:.1e}"
        ]
        if self.rows:
            lines.append("column   row     error      ulps    factor cause")
        for r in self.rows[:10]:
            numbers = f"{r.column:6} {r.row:5} {r.error:9.1e} {r.ulps:9.1e} {r.factor:9.1e}"
            lines.append(f"{numbers} {r.cause}: {r.place}")
        return "\n".join([*lines, *self.warnings])


def _some(names: list[str]) -> str:
    """The names of some objects, the most frequent first, and no more than five of them."""
    found = [name for name, _ in collections.Counter(names).most_common()]
    return ", ".join(found[:5]) + (f" and {len(found) - 5} more" if len(found) > 5 else "")


def check_stability(
    scene: Scene,
    *,
    width: int = 64,
    height: int = 64,
    highlight: Highlight = "phong",
    bounces: int = 5,
    samples: int = 1,
    needs: Needs | None = None,
    limit: float = 1e-4,
) -> StabilityTable:
    """Compares a scene's picture in float32 with that in float64, and finds causes by computation.

    The worst pixels' rays are followed in both precisions, bounce by bounce, to where they part
    (another object, another shadow) or where the error comes in. There the factors are computed
    by which a rounding error grows: 1/(N.V) at a grazing angle, n/(R.V) in a highlight,
    distance/radius where R^2 - q.q cancels, and what mirrors did to the ray. The largest is the
    cause.

    **Arguments:** as for `render`. `limit`: errors above this part of the picture's largest number
    show.

    **Returns:** a table of the pixels whose error shows, worst first.

    **Raises:** `InputError` as `render` does.
    """
    with jax.enable_x64(True):
        scene = scene.astype(jnp.float64)
        settings = render_settings(scene, width, height, highlight, bounces, samples, needs)
        both = scene.astype(jnp.float32), scene
        single, double = (np.asarray(draw(each, settings), np.float64) for each in both)
        error = np.abs(single - double).max(-1).reshape(-1)
        error = np.where(np.isfinite(error), error, np.inf)
        brightest = np.abs(double).max(-1).reshape(-1)
        most = float(np.max(brightest, initial=0, where=np.isfinite(brightest))) or 1.0
        shown = int(np.count_nonzero(error > limit * most))
        worst = np.argsort(-error, kind="stable")[: min(_MOST, error.size)]
        found = explain(both, settings, worst, error[worst], most) if shown else []
    rows = tuple(
        StabilityRow(
            column=int(pixel % width),
            row=int(pixel // width),
            error=float(error[pixel]),
            ulps=float(error[pixel] / np.spacing(np.float32(brightest[pixel] or most))),
            **dataclasses.asdict(why),
        )
        for pixel, why in zip(worst[:shown], found, strict=False)
    )
    return StabilityTable(
        rows=rows,
        pixels=error.size,
        limit=limit * most,
        shown=shown,
        median=float(np.median(error[error > 0])) if error.any() else 0.0,
        largest=float(error.max()),
    )
