"""`Case`: something stiff or extreme that was tried, what must hold, and what was measured."""

import dataclasses
from collections.abc import Callable
from types import ModuleType


@dataclasses.dataclass(frozen=True)
class Case:
    """One line of the catalogue."""

    tried: str  #: what is extreme about it
    promise: str  #: what must hold
    check: Callable[
        [], str
    ]  #: raises AssertionError where it does not; what was measured, in words
    source: str = ""  #: where the case is known from
    slow: bool = False  #: takes more than some seconds

    @property
    def name(self) -> str:
        """What its test is called."""
        return self.tried


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
