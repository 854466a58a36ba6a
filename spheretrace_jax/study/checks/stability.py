"""Stability: a picture in float32 against float64, the worst pixels, and the causes."""

import collections
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from ...base.types import Highlight
from ...rendering.render import draw
from ...scene.needs import Needs
from ...scene.scene import Scene, check_scene
from .error_causes import CAUSES, Cause, explain
from .settings import double_settings

# Limit of the pixels, the worst first, whose causes are computed.
_MOST_PIXELS = 1024


@dataclasses.dataclass(frozen=True)
class StabilityRow:
    """A pixel that differs between float32 and float64."""

    column: int  #: from 0 at the left
    row: int  #: from 0 at the top
    error: float  #: the largest difference of its red, green and blue
    ulps: float  #: the same in units in the last place of its brightest channel in float32
    cause: Cause
    factor: float  #: factor by which a rounding error grows there
    object: str  #: the object seen there: "sphere 3"
    bounce: int  #: of the cause: 0 at the first hit

    @property
    def place(self) -> str:
        """Names the object and the bounce of the cause."""
        return self.object + (f", at bounce {self.bounce}" if self.bounce else "")


@dataclasses.dataclass(frozen=True)
class StabilityTable:
    """Differences of a scene's picture between float32 and float64. `print` shows them."""

    rows: tuple[StabilityRow, ...]  #: the pixels above the limit, worst first, 1024 at most
    pixels: int
    limit: float  #: errors above this limit count
    shown: int  #: number of pixels above the limit
    median: float  #: of the errors other than 0
    largest: float  #: of all errors

    @property
    def share(self) -> float:
        """Returns the share of the pixels whose error is above the limit."""
        return self.shown / self.pixels

    @property
    def ok(self) -> bool:
        """Tells whether float32 suffices for all pixels but a thousandth."""
        return self.share <= 1e-3 and bool(np.isfinite(self.largest))

    @property
    def counts(self) -> dict[Cause, int]:
        """Counts the rows of each cause, most frequent first."""
        return dict(collections.Counter[Cause](row.cause for row in self.rows).most_common())

    @property
    def warnings(self) -> tuple[str, ...]:
        """Returns a sentence for each cause, with the remedy."""
        return tuple(
            CAUSES[cause].format(
                objects=_named([row.object for row in self.rows if row.cause == cause]),
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


def _named(objects: list[str]) -> str:
    """Lists up to five of the objects, the most frequent first."""
    names = [name for name, _ in collections.Counter(objects).most_common()]
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")


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
    """Compares a scene's picture in float32 with the picture in float64, and computes the causes.

    The worst pixels' rays are followed in both precisions, bounce by bounce. They end where the two
    rays part (another object, another shadow), or where most of the error arises. There the factors
    by which a rounding error grows are computed: 1/(N.V) at a grazing angle, n/(R.V) in a
    highlight, distance/radius where R^2 - q.q cancels, and the growth by mirrors. The largest
    factor is the cause.

    **Arguments:** as for `render`. `limit`: the smallest error that counts, as a share of the
    picture's largest number.

    **Returns:** a table of the pixels above the limit, worst first.

    **Raises:** `InputError` as `render` does.
    """
    scene = check_scene(scene)
    with jax.enable_x64(True):
        scene, settings = double_settings(
            scene, width, height, highlight=highlight, bounces=bounces, samples=samples,
            needs=needs,
        )  # fmt: skip
        both = scene.astype(jnp.float32), scene
        single, double = (np.asarray(draw(each, settings), np.float64) for each in both)
        error = np.abs(single - double).max(-1).reshape(-1)
        error = np.where(np.isfinite(error), error, np.inf)
        brightest = np.abs(double).max(-1).reshape(-1)
        most = float(np.max(brightest, initial=0, where=np.isfinite(brightest))) or 1.0
        shown = int(np.count_nonzero(error > limit * most))
        worst = np.argsort(-error, kind="stable")[: min(_MOST_PIXELS, error.size)]
        causes = explain(both, settings, worst, error[worst], most) if shown else []
    rows = tuple(
        StabilityRow(
            column=int(pixel % width),
            row=int(pixel // width),
            error=float(error[pixel]),
            ulps=float(error[pixel] / np.spacing(np.float32(brightest[pixel] or most))),
            **dataclasses.asdict(explanation),
        )
        for pixel, explanation in zip(worst[:shown], causes, strict=False)
    )
    return StabilityTable(
        rows=rows,
        pixels=error.size,
        limit=limit * most,
        shown=shown,
        median=float(np.median(error[error > 0])) if error.any() else 0.0,
        largest=float(error.max()),
    )
