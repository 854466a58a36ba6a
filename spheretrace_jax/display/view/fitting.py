"""A fit that runs beside the window, whose best scene so far is shown step by step."""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from ...fit import Fit, Progress, fit
from ...scene.scene import Scene


class RunningFit:
    """A fit in a thread of its own."""

    def __init__(
        self,
        scene: Scene,
        target: np.ndarray,
        step: Callable[[Scene, str], None],
        end: Callable[[Scene | None, str, str], None],
        **settings: Any,
    ):
        """Starts a fit.

        **Arguments:** `step`: called with the best scene so far and words, after each step. `end`:
        called with the scene found (None if there is none), words and the grade. Both are called
        in the fit's thread. `settings`: as for `fit`.
        """
        self._stop = threading.Event()
        self._work = lambda: fit(scene, target, callback=self._report, **settings)
        self._step, self._end = step, end
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Asks the fit to end after this step, with the best scene so far."""
        self._stop.set()

    @property
    def running(self) -> bool:
        """Tells whether the fit goes on."""
        return self._thread.is_alive()

    def _report(self, progress: Progress) -> bool:
        self._step(progress.scene, f"step {progress.step}, cost {progress.cost:.3e}")
        return self._stop.is_set()

    def _run(self) -> None:
        try:
            found: Fit = self._work()
            self._end(found.scene, found.trust.verdict, found.trust.grade)
        except Exception as error:  # whatever it is, the window says so and goes on
            self._end(None, " ".join(str(error).split()), "not to be used")
