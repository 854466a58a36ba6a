"""Progress: shown after a while, in terminals and notebooks, and taken away at the end."""

import sys
import threading
import time
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import pytest

from spheretrace_jax.base.progress import listeners, working
from spheretrace_jax.display import progress
from spheretrace_jax.display.progress import ProgressDisplay, session_line, show_progress


class Recorder:
    """A line that remembers what it showed."""

    def __init__(self):
        self.shown, self.cleared = [], 0

    def show(self, text):
        self.shown.append(text)

    def clear(self):
        self.cleared += 1


@pytest.fixture
def display(monkeypatch):
    """A display that shows everything at once."""
    monkeypatch.setattr(progress, "_TICK", 0.01)
    display = ProgressDisplay(Recorder(), patience=0.02)
    display.start()
    yield display
    display.stop()


def wait(condition):
    began = time.monotonic()
    while not condition():
        assert time.monotonic() - began < 5
        time.sleep(0.005)


def test_nobody_listens_by_default():
    assert not listeners
    with working("thinking", 3) as step:
        step("a")


def test_work_is_shown_and_taken_away(display):
    with working("thinking", 3) as step:
        step("of a")
        wait(lambda: display.line.shown)
        assert display.line.shown[-1] == "thinking 1/3, of a (0 s)"
        step("of c", done=3)
        wait(lambda: "3/3, of c" in display.line.shown[-1])
        with working("more"):
            wait(lambda: "; more (0 s)" in display.line.shown[-1])
    assert display.line.cleared == 1


def test_short_work_is_not_shown(display):
    display.patience = 10
    with working("thinking"):
        time.sleep(0.05)
    assert not display.line.shown


def test_work_that_fails_is_taken_away(display):
    with pytest.raises(ValueError), working("thinking"):
        wait(lambda: display.line.shown)
        raise ValueError
    assert display.line.cleared == 1


def test_compilation_of_any_function_is_shown(display):
    @jax.jit
    def slowly(x):
        for _ in range(400):
            x = jnp.sin(x) @ x
        return x

    slowly(jnp.ones((8, 8)))
    assert any(text.startswith("compiling slowly") for text in display.line.shown)
    assert display.line.cleared >= 1


def test_an_estimate_comes_from_the_time_of_lowering(display):
    display.patience = 0.02
    display.begin_phase(progress._LOWER, 0.0, fun_name="jit(draw)")
    display.end_phase(progress._LOWER, 0.5, fun_name="jit(draw)")
    display.begin_phase(progress._COMPILE, 0.0, fun_name="jit(draw)")
    wait(lambda: display.line.shown)
    assert display.line.shown[-1] == "compiling the picture, about 9 s (0 s)"
    display.end_phase(progress._COMPILE, 9.0)


def test_phases_of_several_threads_are_apart(display):
    """A thread that compiles shows its work, also while another one is in the middle of its own."""
    display.begin_phase(progress._TRACE, 0.0, fun_name="first")
    inside = lambda: (
        display.begin_phase(progress._TRACE, 0.0, fun_name="second"),
        wait(lambda: "; compiling second" in (display.line.shown or [""])[-1]),
        display.end_phase(progress._TRACE, 0.0),
    )
    other = threading.Thread(target=inside)
    other.start()
    other.join(timeout=10)
    assert not other.is_alive() and len(display._tasks) == 1
    display.end_phase(progress._TRACE, 0.0)
    assert not display._tasks and display.line.cleared == 1


def test_work_that_begins_while_the_line_goes_ends_on_its_own(display):
    for _ in range(200):
        works = [threading.Thread(target=lambda: display.listen("a").end()) for _ in range(4)]
        for work in works:
            work.start()
        for work in works:
            work.join(timeout=10)
            assert not work.is_alive()
    assert not display._tasks


def test_lowering_alone_leaves_nothing_behind(display):
    jax.jit(lambda x: x + 1).lower(1.0)
    assert not display._tasks and not display._phases.nested


def test_a_session_that_is_not_interactive_shows_nothing(monkeypatch):
    monkeypatch.setattr(sys, "stderr", SimpleNamespace(isatty=lambda: False))
    assert session_line() is None
    show_progress()
    assert not listeners


def test_terminals_and_notebooks_show_progress(monkeypatch):
    monkeypatch.setattr(sys, "stderr", SimpleNamespace(isatty=lambda: True))
    assert isinstance(session_line(), progress.TerminalLine)
    show_progress()
    show_progress()
    assert len(listeners) == 1
    show_progress(False)
    assert not listeners
    shell = SimpleNamespace(kernel=object())
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    assert isinstance(session_line(), progress.NotebookLine)
