"""`Case`: something stiff or extreme that was tried, what must hold, and what was measured."""

import dataclasses
from collections.abc import Callable
from types import ModuleType


@dataclasses.dataclass(frozen=True)
class Case:
    """One line of the catalogue."""

    tried: str  #: what is extreme about it
    promise: str  #: what must hold
    check: Callable[[], str]  #: says what was measured; AssertionError if it does not hold
    source: str = ""  #: where the case is known from
    slow: bool = False  #: takes more than some seconds


def case(tried: str, promise: str, source: str = "", slow: bool = False) -> Callable:
    """Makes a `Case` of a function that asserts a promise and returns what was measured."""
    return lambda check: Case(tried, promise, check, source, slow)


def cases(module: ModuleType) -> list[Case]:
    """The cases of a module, in its order: single ones and lists of them."""
    found = []
    for value in vars(module).values():
        if isinstance(value, Case):
            found.append(value)
        elif isinstance(value, list):
            found += [x for x in value if isinstance(x, Case)]
    return found
