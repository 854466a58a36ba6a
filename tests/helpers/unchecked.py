"""Error messages of calls with values of other types, which annotations are checked for in tests.

Such calls run in a process of their own, as users make them: without checks of annotations.
"""

import json
from pathlib import Path

from .commands import python

_PROGRAM = """
import json, sys, warnings
import jax.numpy as jnp, numpy as np
import spheretrace_jax as st

warnings.simplefilter("ignore")
scene = st.load_scene(sys.argv[1]).with_antialias(0)
picture = np.full((8, 8, 3), 0.5, np.float32)
found = []
for call in json.loads(sys.argv[2]):
    try:
        found.append(repr(eval(call)))
    except Exception as error:
        found.append(f"{type(error).__name__}: {error}")
print(json.dumps(found))
"""


def messages(calls: list[str]) -> dict[str, str]:
    """Returns for each call, of `scene` and `picture`, the error that it raises, or its value."""
    root = Path(__file__).parents[2]
    file = root / "data" / "nine_spheres.txt"
    ran = python("-c", _PROGRAM, str(file), json.dumps(calls), folder=root)
    assert ran.returncode == 0, ran.stderr
    return dict(zip(calls, json.loads(ran.stdout), strict=True))
