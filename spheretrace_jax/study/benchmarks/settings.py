"""`Settings`: how large the pictures of a study are, and how far its methods are swept."""

import dataclasses
from collections.abc import Callable

from ...base.types import Highlight


@dataclasses.dataclass(frozen=True)
class Settings:
    """What a study does, and how it draws."""

    highlight: Highlight = "phong"
    bounces: int = 1
    size: int = 128  #: of pictures whose errors are measured: their width and height
    rays: tuple[int, ...] = (1, 2, 4, 8, 16)  #: k of k x k single rays
    covered: tuple[int, ...] = (1, 2, 4)  #: k of k x k parts whose edges are covered
    steps: tuple[float, ...] = (0.03, 0.1, 0.3, 1.0)  #: of differences, in pixels that edges move
    truth_rays: int = 3000  #: of the reference, per pixel
    fit_size: int = 128  #: of pictures that are fitted
    fit_seconds: float = 3.0  #: after which a solver is stopped
    sides: tuple[int, ...] = (128, 256, 512, 1024)  #: of pictures whose time is measured
    counts: tuple[int, ...] = (10, 100, 1000, 10_000, 100_000)  #: of spheres
    lights: tuple[int, ...] = (1, 2, 4)
    depths: tuple[int, ...] = (0, 1, 3)  #: of bounces
    thorough: bool = True  #: gradients as well as pictures, all solvers, all in both precisions
    seconds: float = 0.5  #: for each point's runs
    seed: int = 0
    say: Callable[[str], None] = lambda text: None  #: told what is done next


#: A study of a minute: small pictures, few points, and no bounces, which compile longest.
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
