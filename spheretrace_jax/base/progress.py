"""Progress of long work: told to whoever listens, which nobody does by default."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Protocol, runtime_checkable


@runtime_checkable
class Work(Protocol):
    """A piece of work that a listener shows."""

    def step(self, text: str | None = None, done: int | None = None) -> None:
        """Takes what is done now, and how many steps are done, by default one more."""
        ...

    def end(self) -> None:
        """Takes that the work ended or failed."""
        ...


#: Functions that take the text and the number of steps of work that begins, and return a `Work`.
#: One list for the process, as the handlers of `logging` are: work and who shows it do not know
#: each other.
listeners: list[Callable[[str, int | None], Work]] = []


@contextmanager
def working(text: str, total: int | None = None) -> Iterator[Callable[..., None]]:
    """Tells listeners of work that may take long.

    **Arguments:** `text`: what is done. `total`: the number of its steps, if known.

    **Yields:** a function to call after each step, as `Work.step`.
    """
    with ExitStack() as ends:
        told = [listen(text, total) for listen in listeners]
        for work in told:
            ends.callback(work.end)

        def step(text: str | None = None, done: int | None = None) -> None:
            for work in told:
                work.step(text, done)

        yield step
