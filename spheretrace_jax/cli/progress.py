"""What the command line shows while something takes longer than a blink."""

from pathlib import Path


def busy(text: str):
    """A spinner, as a context."""
    from rich.console import Console

    return Console(stderr=True).status(text)


def _bar(*columns):
    """A bar of progress, as a context; hidden where it would leave an empty line."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)


def fit_with_progress(scene, target, **settings):
    """`fit` with a bar that shows its steps. **Arguments:** as for `fit`."""
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn

    from .. import fit

    text = TextColumn("{task.description}")
    with _bar(text, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()) as bar:
        task = bar.add_task("compiling", total=None)

        def show(state) -> None:
            bar.update(
                task,
                completed=state.step,
                total=state.max_steps,
                description=f"cost {state.cost:.3e}, damping {state.damping:.0e}",
            )

        return fit(scene, target, callback=show, **settings)


def report_with_progress(folder: Path, found, start, target, free, settings) -> list[Path]:
    """Writes a fit's report. **Arguments:** as for `write_report`; `settings`: of the pictures."""
    import numpy as np

    from ..rendering.render import render
    from .report import write_report

    height, width = target.shape[:2]
    with busy("writing the report"):
        before, after = (
            np.asarray(render(scene, width=width, height=height, **settings))
            for scene in (start, found.scene)
        )
        return write_report(folder, found, start, target, before, after, free)


def study_with_progress(scene, **settings):
    """`study` with a bar that shows its parts. **Arguments:** as for `study`."""
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn

    from ..study.study import study

    text = TextColumn("{task.description}")
    with _bar(BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), text) as bar:
        parts = settings["parts"]
        task = bar.add_task("", total=len(parts))

        def say(part: str, text: str) -> None:
            bar.update(task, completed=parts.index(part), description=text)

        return study(scene, say=say, **settings)
