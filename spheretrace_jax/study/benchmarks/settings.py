"""`Settings`: the sizes of a study's pictures, and the sweeps of its methods."""

import dataclasses
from collections.abc import Callable

from ...base.types import Highlight


@dataclasses.dataclass(frozen=True)
class Settings:
    """The settings of a study."""

    highlight: Highlight = "phong"
    bounces: int = 1
    size: int = 128  #: width and height of the pictures whose errors are measured
    rays: tuple[int, ...] = (1, 2, 4, 8, 16)  #: k of k x k single rays
    covered: tuple[int, ...] = (1, 2, 4)  #: k of k x k samples with covered edges
    steps: tuple[float, ...] = (
        0.03,
        0.1,
        0.3,
        1.0,
    )  #: of differences, pixels of motion
    truth_rays: int = 3000  #: of the reference, per pixel
    fit_size: int = 128  #: width and height of the pictures that are fitted
    fit_seconds: float = 3.0  #: time after which a solver is stopped
    sides: tuple[int, ...] = (
        128,
        256,
        512,
        1024,
    )  #: of pictures, for their time
    counts: tuple[int, ...] = (10, 100, 1000, 10_000, 100_000)  #: of spheres
    lights: tuple[int, ...] = (1, 2, 4)
    depths: tuple[int, ...] = (0, 1, 3)  #: of bounces
    thorough: bool = True  #: also gradients, all solvers, both precisions
    seconds: float = 0.5  #: time of each point's runs
    seed: int = 0
    say: Callable[[str], None] = lambda text: None  #: called with the next step, in words


#: A study of about a minute: small pictures, few points, no bounces, which compile longest.
QUICK = Settings(
    bounces=0,
    size=64,
    rays=(1, 2, 4),
    covered=(1,),
    steps=(0.1, 1.0),
    truth_rays=1000,
    fit_size=48,
    fit_seconds=1.0,
    sides=(128, 512),
    counts=(10, 100),
    lights=(1, 2),
    depths=(0, 1),
    thorough=False,
    seconds=0.1,
)
