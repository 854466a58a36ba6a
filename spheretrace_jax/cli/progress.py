"""Progress bars and spinners of the command line."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path


def busy(text: str):
    """Returns a spinner, as a context."""
    from rich.console import Console

    return Console(stderr=True).status(text)


def _bar(*columns):
    """Returns a progress bar, as a context; hidden outside terminals, which show empty lines."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)


def _counted_bar():
    """Returns a bar with what is done before it, and how many of how many behind it."""
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn

    text = TextColumn("{task.description}")
    return _bar(text, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())


@contextmanager
def counting(text: str, total: int) -> Iterator[Callable[[str], None]]:
    """Shows a bar of things that are done one after the other.

    **Arguments:** `text`: shown until the first is done. **Yields:** a function to call with the
    name of each that is done.
    """
    with _counted_bar() as bar:
        task = bar.add_task(text, total=total)
        yield lambda name: bar.update(task, advance=1, description=name)


def fit_with_progress(scene, target, **settings):
    """Runs `fit` with a bar of its steps. **Arguments, returns:** as for `fit`."""
    from .. import fit

    with _counted_bar() as bar:
        task = bar.add_task("compiling", total=None)

        def show(state) -> None:
            bar.update(
                task,
                completed=state.step,
                total=state.max_steps,
                description=f"cost {state.cost:.3e}, damping {state.damping:.0e}",
            )

        return fit(scene, target, callback=show, **settings)


def report_with_progress(folder: Path, result, start, target, free, settings) -> list[Path]:
    """Renders the pictures of a fit's report and writes the report.

    **Arguments:** as for `write_report`. `settings`: highlight, bounces and samples, as for
    `render`.

    **Returns:** the files written.
    """
    import numpy as np

    from .. import render
    from .report import write_report

    height, width = target.shape[:2]
    with busy("writing the report"):
        before, after = (
            np.asarray(render(scene, width=width, height=height, **settings))
            for scene in (start, result.scene)
        )
        return write_report(folder, result, start, target, before, after, free)


def study_with_progress(scene, **settings):
    """Runs `study` with a bar of its parts. **Arguments, returns:** as for `study`."""
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn

    from ..study.study import study

    text = TextColumn("{task.description}")
    with _bar(BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), text) as bar:
        parts = settings["parts"]
        task = bar.add_task("", total=len(parts))

        def say(part: str, text: str) -> None:
            bar.update(task, completed=parts.index(part), description=text)

        return study(scene, say=say, **settings)
