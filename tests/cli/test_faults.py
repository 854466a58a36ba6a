"""Full disks, missing folders, interrupts: one line, and no file is half written.

What needs processes of its own, and protected folders, are in the catalogue (extremes/files.py).
"""

import contextlib
import re
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.commands import FIT, REPORT, WRITING, disk_full, files, spheretrace, workplace

import spheretrace_jax as st
from spheretrace_jax.cli import demo
from spheretrace_jax.files import atomic
from spheretrace_jax.fit import multistart
from spheretrace_jax.fit.solver import light_search


@pytest.fixture(autouse=True)
def interruptible() -> Iterator[None]:
    """Enables interrupts, which shells disable in programs that run in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="module")
def filled() -> Iterator[Path]:
    with workplace() as folder:
        yield folder


@pytest.fixture
def folder(filled, monkeypatch) -> Iterator[Path]:
    """Enters the filled folder, and removes new files afterwards."""
    monkeypatch.chdir(filled)
    before = files(filled)
    yield filled
    for name in files(filled).keys() - before.keys():
        (filled / name).unlink()


def old(*names: str) -> None:
    for name in names:
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_text("old")


def refused(words: tuple, reason: str) -> None:
    """Asserts that a command fails in one line that ends with `reason`, and changes no file."""
    before = files(Path())
    status, out, err = spheretrace(*words)
    assert (status, out, err) == (2, "", f"spheretrace: {reason}\n")
    assert files(Path()) == before


# --- no room --------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", WRITING)
def test_a_full_disk_keeps_the_old_file(command, folder):
    words, (name,) = WRITING[command]
    old(name)
    with disk_full():
        refused(words, f"{name}: File too large")


def test_a_report_that_finds_no_room_leaves_the_fit_and_the_old_report(folder):
    old(*REPORT)
    with disk_full(1000):  # enough for fitted.txt
        status, out, err = spheretrace(*FIT, "--free", "kd,ks", "--report", "report")
    assert (status, err) == (2, f"spheretrace: {REPORT[0]}: File too large\n")
    assert out.startswith("fitted.txt: converged after ") and out.count("\n") == 1
    assert len(st.load_scene("fitted.txt").spheres) == 2
    assert {(f.name, f.read_text()) for f in Path("report").iterdir()} == {
        (Path(name).name, "old") for name in REPORT
    }


@pytest.mark.slow
def test_a_demo_that_finds_no_room_leaves_the_old_files(folder, monkeypatch):
    data = folder / "data"
    data.mkdir(exist_ok=True)
    (data / "nine_spheres.txt").write_bytes(Path("scene.txt").read_bytes())
    picture = np.asarray(st.render(st.load_scene("scene.txt", np.float32), width=24, height=24))
    st.write_image(data / "nine_spheres.png", picture, bits=16)
    monkeypatch.setattr(demo, "data_folder", lambda: data)
    names = ["out/fitted.txt", "out/fitted.png"]
    old(*names)
    with disk_full():
        refused(("demo", "-o", "out"), f"{names[0]}: File too large")
    with disk_full(1000):
        status, out, err = spheretrace("demo", "-o", "out")
    assert (status, out, err) == (2, "", f"spheretrace: {names[1]}: File too large\n")
    assert len(st.load_scene(names[0]).spheres) == 2 and Path(names[1]).read_text() == "old"
    assert {f.name for f in Path("out").iterdir()} == {"fitted.txt", "fitted.png"}


@pytest.mark.parametrize("command", WRITING)
def test_a_folder_that_goes_away_meanwhile_is_named(command, folder, monkeypatch):
    words, (name,) = WRITING[command]
    words = tuple(f"gone/{name}" if word == name else word for word in words)
    Path("gone").mkdir(exist_ok=True)
    check = atomic.check_target

    def checked(path) -> None:
        """Removes the folder after the last check."""
        check(path)
        if sys._getframe(1).f_code.co_name == "replacing":
            Path("gone").rmdir()

    monkeypatch.setattr(atomic, "check_target", checked)
    refused(words, f"gone/{name}: No such file or directory")


# --- interrupts -----------------------------------------------------------------------------------


def interrupt() -> None:
    """Interrupts the program, as Ctrl-C does."""
    signal.raise_signal(signal.SIGINT)


def test_an_interrupted_fit_is_written_and_exits_with_130(folder, monkeypatch):
    fit = st.fit

    def interrupted(scene, target, **settings):
        def show(progress):
            if progress.step == 2:
                interrupt()

        return fit(scene, target, callback=show, **settings)

    monkeypatch.setattr(st, "fit", interrupted)
    old("fitted.txt")
    status, out, err = spheretrace(*FIT, "--free", "kd,ks")
    assert (status, err) == (130, "")
    assert out.startswith("fitted.txt: interrupted: the best scene so far after 2 steps, ")
    truth, found, start = (
        st.load_scene(f, np.float64).spheres for f in ("scene.txt", "fitted.txt", "start.txt")
    )
    assert jnp.abs(found.kd - truth.kd).max() < jnp.abs(start.kd - truth.kd).max()


def test_a_fit_that_is_interrupted_between_two_starts_keeps_the_first(folder, monkeypatch):
    """Lights far off: the fit finds nothing from the scene's own start and looks for others."""
    scene = st.load_scene("start.txt", np.float64)
    target = st.read_image("target.exr")
    costs = []
    monkeypatch.setattr(multistart, "explains", lambda *_: False)
    monkeypatch.setattr(light_search, "is_separable", lambda *_: True)
    monkeypatch.setattr(light_search, "starts_from_lights", lambda *_: interrupt())
    found = st.fit(scene, target, free=("kd", "ks"), callback=lambda p: costs.append(p.cost))
    assert found.interrupted and found.cost == min(costs) and not found.trust.ok
    assert found.trust.verdict.startswith("interrupted: the best scene so far after ")


def test_a_fit_that_is_interrupted_after_it_converged_keeps_what_it_found(folder, monkeypatch):
    scene = st.load_scene("start.txt", np.float64)
    target = st.read_image("target.exr")
    monkeypatch.setattr(multistart, "_rests_on_outliers", lambda *_: interrupt())
    found = st.fit(scene, target, free=("kd", "ks"))
    truth = st.load_scene("scene.txt", np.float64)
    np.testing.assert_allclose(found.scene.spheres.kd, truth.spheres.kd, rtol=1e-6)
    assert found.interrupted and found.cost == min(found.costs) and len(found.costs) == found.steps


@pytest.mark.parametrize("command", ["render png", "fit"])
def test_an_interrupt_before_there_is_anything_to_write_writes_nothing(
    command, folder, monkeypatch
):
    words, (name,) = WRITING[command]
    old(name)
    before = files(folder)
    monkeypatch.setattr(st, words[0], lambda *_, **__: interrupt())
    assert spheretrace(*words) == (130, "", "spheretrace: interrupted\n")
    assert files(folder) == before


def test_an_interrupt_that_is_lost_in_a_collection_of_garbage_comes_again(folder, monkeypatch):
    class Interrupting:
        def __del__(self):
            interrupt()

    def render(*_, **__):
        Interrupting()
        time.sleep(5)
        pytest.fail("the program went on")

    monkeypatch.setattr(st, "render", render)
    words, _ = WRITING["render png"]
    assert spheretrace(*words) == (130, "", "spheretrace: interrupted\n")


WRITERS = {
    "out.png": lambda scene: st.write_image("out.png", np.full((4, 4, 3), 0.5)),
    "out.exr": lambda scene: st.write_image("out.exr", np.full((4, 4, 3), 0.5)),
    "out.txt": lambda scene: st.save_scene("out.txt", scene),
    "out.pov": lambda scene: st.write_povray("out.pov", scene),
}


@contextmanager
def interrupt_at(line: int) -> Iterator[list]:
    """Interrupts before the nth executed line of the writers. Yields a list of the position."""
    place, left = [], line

    def trace(frame, event, _):
        nonlocal left
        if not frame.f_code.co_filename.endswith(("files/atomic.py", "files/images.py")):
            return None
        left -= event == "line"
        if left == 0 and not place:
            place.append((frame.f_code.co_name, frame.f_lineno))
            interrupt()
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        yield place
    finally:
        sys.settrace(before)


def content(name: str) -> bytes:
    """Reads a file without the time, which EXR files hold."""
    return re.sub(rb"\d+:\d\d:\d\d \d\d:\d\d:\d\d", b"", Path(name).read_bytes())


@pytest.mark.parametrize("name", WRITERS)
def test_an_interrupt_at_any_line_of_the_writing_leaves_the_old_file_or_the_new(name, folder):
    scene = st.load_scene("scene.txt", np.float64)
    WRITERS[name](scene)
    new, others = content(name), files(folder).keys()
    found = []
    for line in range(1, 200):
        old(name)
        with contextlib.suppress(KeyboardInterrupt), interrupt_at(line) as place:
            WRITERS[name](scene)
        if not place:
            break
        assert files(folder).keys() == others, place
        found.append(content(name))
    assert not place, "the last line was never reached"
    assert set(found) == {b"old", new}
    assert len(found) > 12 and found == sorted(found, key=lambda text: text == new)
