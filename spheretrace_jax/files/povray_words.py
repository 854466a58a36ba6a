"""Words of POV-Ray's language: numbers and vectors."""

from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Array

from ..base.errors import SceneError

Number = float | np.floating


def number(x: Number) -> str:
    """Returns the shortest decimal that reads as the same number of its dtype."""
    if not np.isfinite(x):
        raise SceneError(f"a scene that holds {x} cannot be written for POV-Ray")
    return str(x)


def vector(values: Iterable[Number]) -> str:
    """Returns a vector or a colour in POV-Ray's notation."""
    return f"<{', '.join(number(x) for x in values)}>"


def table_rows(*columns: Array) -> Iterator[tuple]:
    """Yields the rows of a table of columns, as NumPy's numbers."""
    return zip(*(np.asarray(column) for column in columns), strict=True)
