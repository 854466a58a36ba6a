"""JAX's debugging flags: pictures and fits run under them. Each has a process of its own."""

import os
import subprocess
import sys

import pytest

# a scene as small as can be, and a start whose light is off: one step from the host, then the same
# fit as a pure function
PROGRAM = """
import equinox as eqx
import numpy as np
import spheretrace_jax as st

spheres = st.Spheres([[0.0, 0, 0]], 100.0, (0.8, 0.3, 0.2))
scene = st.Scene(spheres, st.Lights([[200.0, 300, 800]]), st.Camera(mu=1200.0, distance=1200.0))
size = dict(width=4, height=4)
target = np.asarray(st.render(scene, **size))
assert np.isfinite(target).all() and target.max() > 0
layers = st.render_layers(scene, **size)
assert np.isinf(layers.depth).any() and (layers.object == 0).any()
start = eqx.tree_at(lambda s: s.lights.position, scene, scene.lights.position + 50)
free = ("color", "kd", "light_position")
found = st.fit(start, target, free=free, max_steps=3, start="START")
assert found.cost < 1e-3 and "free: color" in str(found)
[(again, _)] = st.solution(found.problem, max_steps=3, throw=False)
assert np.isfinite(again.lights.position).all()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flag", "start"),
    [("JAX_DISABLE_JIT", "scene"), ("JAX_DEBUG_INFS", "lights"), ("JAX_DEBUG_NANS", "lights")],
)
def test_fits_under_a_flag(flag, start):
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", PROGRAM.replace("START", start)],
        env=os.environ | {flag: "1", "JAX_PLATFORMS": "cpu"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-2000:]
