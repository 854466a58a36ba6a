"""The display of progress: one line for work of more than two seconds, compilation included.

JAX reports its own phases (`jax.monitoring`), so every compilation is shown, also that of a user's
function. Sessions that are not interactive show nothing.
"""

import sys
import threading
import time
from typing import Any, Protocol, runtime_checkable

import jax.monitoring

from ..base.progress import Work, listeners

#: The seconds that work may take before it is shown.
PATIENCE = 2.0

#: The seconds between two updates of a display.
_TICK = 0.25

# JAX's phases: each reports its start as a scalar and its end as a duration of the same name.
_TRACE = "/jax/core/compile/jaxpr_trace_duration"
_LOWER = "/jax/core/compile/jaxpr_to_mlir_module_duration"
_COMPILE = "/jax/core/compile/backend_compile_duration"

# The seconds XLA takes on a CPU for each second of lowering. Pictures, gradients and fits of the
# lecture's scene: 12 to 38. It changes only the estimate that is shown.
_XLA_PER_LOWERING = 18

# Names of the package's compiled functions, in a user's words.
_WORDS = {"draw": "the picture", "_normal_at": "the fit", "normal_at": "the fit"}


@runtime_checkable
class Line(Protocol):
    """A line that can be shown, changed and taken away."""

    def show(self, text: str) -> None: ...

    def clear(self) -> None: ...


class TerminalLine:
    """A line at the bottom of a terminal."""

    def __init__(self) -> None:
        self._live: Any = None

    def show(self, text: str) -> None:
        """Shows a line, cut to the terminal's width."""
        from rich.console import Console
        from rich.live import Live
        from rich.text import Text

        line = Text(text, overflow="ellipsis", no_wrap=True)
        if self._live is None:
            console = Console(stderr=True)
            self._live = Live(console=console, transient=True, auto_refresh=False)
            self._live.start()
        self._live.update(line, refresh=True)

    def clear(self) -> None:
        """Takes the line away."""
        if self._live is not None:
            self._live.stop()
            self._live = None


class NotebookLine:
    """An output of a notebook's cell."""

    def __init__(self) -> None:
        self._handle: Any = None

    def show(self, text: str) -> None:
        """Shows a line."""
        from IPython.display import display  # pyright: ignore[reportMissingImports]

        data = {"text/plain": text}
        if self._handle is None:
            self._handle = display(data, raw=True, display_id=True)
        else:
            self._handle.update(data, raw=True)

    def clear(self) -> None:
        """Leaves an empty output: a notebook cannot take one away."""
        if self._handle is not None:
            self._handle.update({"text/plain": ""}, raw=True)
            self._handle = None


class _Task:
    """Work that a display shows. It is a `base.progress.Work`."""

    def __init__(self, display: "ProgressDisplay", text: str, total: int | None):
        self.display, self.text, self.total = display, text, total
        self.done, self.now, self.began = 0, "", time.monotonic()

    def step(self, text: str | None = None, done: int | None = None) -> None:
        self.done = self.done + 1 if done is None else done
        self.now = self.now if text is None else text

    def end(self) -> None:
        self.display.end(self)

    def __str__(self) -> str:
        counted = f" {self.done}/{self.total}" if self.total else ""
        now = f", {self.now}" if self.now else ""
        return f"{self.text}{counted}{now} ({time.monotonic() - self.began:.0f} s)"


class _Phases(threading.local):
    """The phases of JAX that a thread is in: they nest."""

    nested = 0
    shown: Work | None = None  # the outermost one
    lowering = 0.0  # the seconds that the last lowering took


class ProgressDisplay:
    """Shows the work of this process on a line, once it has taken `patience` seconds."""

    def __init__(self, line: Line, patience: float = PATIENCE):
        """Takes where to show. **Arguments:** `patience`: in seconds."""
        self.line, self.patience = line, patience
        self._tasks: list[_Task] = []
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._idle = threading.Event()  # of the present thread: it then ends
        self._phases = _Phases()

    def listen(self, text: str, total: int | None = None) -> Work:
        """Takes work that begins."""
        task = _Task(self, text, total)
        with self._lock:
            self._tasks.append(task)
            if self._thread is None:
                self._idle = threading.Event()
                self._thread = threading.Thread(target=self._run, args=[self._idle], daemon=True)
                self._thread.start()
        return task

    def end(self, task: _Task) -> None:
        """Takes that work ended; the line goes with the last one."""
        with self._lock:
            if task in self._tasks:
                self._tasks.remove(task)
            thread = self._thread
            if self._tasks or thread is None:
                return
            self._thread = None
            self._idle.set()
        thread.join()

    def _run(self, idle: threading.Event) -> None:
        while not idle.wait(_TICK):
            with self._lock:
                late = [t for t in self._tasks if time.monotonic() - t.began >= self.patience]
                text = "; ".join(map(str, late))
            if text:
                self.line.show(text)
        self.line.clear()

    def begin_phase(self, event: str, value: float | int, **kwargs: str | int) -> None:
        """Takes the start of a phase of JAX: tracing, lowering or compiling a function."""
        if event not in (_TRACE, _LOWER, _COMPILE):
            return
        name = str(kwargs.get("fun_name", "")).removeprefix("jit(").removesuffix(")")
        text = f"compiling {_WORDS.get(name, name)}"
        seconds = _XLA_PER_LOWERING * self._phases.lowering
        if event == _COMPILE and seconds >= self.patience:
            text += f", about {seconds:.0f} s"
        if not self._phases.nested:  # only the outermost one is shown
            self._phases.shown = self.listen(text)
        self._phases.nested += 1

    def end_phase(self, event: str, duration_secs: float, **kwargs: str | int) -> None:
        """Takes the end of a phase of JAX, also one that failed."""
        if event not in (_TRACE, _LOWER, _COMPILE) or not self._phases.nested:
            return
        self._phases.nested -= 1
        if not self._phases.nested and self._phases.shown is not None:
            self._phases.shown.end()
        if event == _LOWER:
            self._phases.lowering = duration_secs

    def start(self) -> None:
        """Begins to show progress."""
        listeners.append(self.listen)
        jax.monitoring.register_scalar_listener(self.begin_phase)
        jax.monitoring.register_event_duration_secs_listener(self.end_phase)

    def stop(self) -> None:
        """Shows no more progress."""
        listeners.remove(self.listen)
        jax.monitoring.unregister_scalar_listener(self.begin_phase)
        jax.monitoring.unregister_event_duration_listener(self.end_phase)


def session_line() -> Line | None:
    """Returns where this session shows progress; None if it is not interactive."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython else None
    if hasattr(shell, "kernel"):
        return NotebookLine()
    return TerminalLine() if sys.stderr is not None and sys.stderr.isatty() else None


_shown: list[ProgressDisplay] = []  # the one of this process, if any


def show_progress(on: bool = True) -> None:
    """Shows the progress of work of more than two seconds, with compilation, or stops to show it.

    An interactive session, a terminal or a notebook, shows it from the start. Elsewhere nothing is
    shown, whatever `on` is.
    """
    while _shown:
        _shown.pop().stop()
    line = session_line() if on else None
    if line is not None:
        _shown.append(ProgressDisplay(line))
        _shown[0].start()
