"""The rows of a fit's parameters."""

from types import SimpleNamespace
from unittest.mock import Mock

import jax.numpy as jnp
import numpy as np
from helpers.scenes import SCENES, with_camera

from spheretrace_jax import Fit
from spheretrace_jax.display.parameter_rows import parameter_rows


def test_numbers_of_the_camera_have_one_line_each():
    start = SCENES["diffuse"]
    found = with_camera(start, roll=jnp.array(0.5), look_at=jnp.array([1.0, 2, 3]))
    spread = {"roll": np.array(0.01), "look_at": np.array([0.1, 0.2, np.inf])}
    free = SimpleNamespace(free=("roll", "look_at"))
    fit = Mock(
        spec=Fit,
        starts=[start],
        scenes=[found],
        problem=SimpleNamespace(parameters=[free], per_picture=frozenset()),
        uncertainty=SimpleNamespace(standard_deviations=spread),
    )
    assert [row[:5] for row in parameter_rows(fit)] == [
        ("roll", "camera", "0", "0.5", "0.01"),
        ("look_at", "camera", "0 0 0", "1 2 3", "0.1 0.2 -"),
    ]
