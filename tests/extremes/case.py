"""`Case`: an extreme input, the promise that must hold for it, and the measurement."""

import dataclasses
from collections.abc import Callable
from types import ModuleType


@dataclasses.dataclass(frozen=True)
class Case:
    """A line of the catalogue."""

    tried: str  #: the extreme input
    promise: str  #: the promise that must hold
    check: Callable[
        [], str
    ]  #: returns the measurement; raises AssertionError if the promise is broken
    source: str = ""  #: the literature or the fault that the case is known from
    slow: bool = False  #: takes more than a few seconds


def case(tried: str, promise: str, source: str = "", slow: bool = False) -> Callable:
    """Makes a `Case` of a function that asserts a promise and returns the measurement."""
    return lambda check: Case(tried, promise, check, source, slow)


def cases(module: ModuleType) -> list[Case]:
    """Returns the cases of a module in its order, from single cases and lists of cases."""
    found = []
    for value in vars(module).values():
        if isinstance(value, Case):
            found.append(value)
        elif isinstance(value, list):
            found += [x for x in value if isinstance(x, Case)]
    return found
