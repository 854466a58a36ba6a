"""The sphere flake of data/sphere_flake.py: its spheres touch, and none lies in another."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np

PATH = Path(__file__).parents[2] / "data" / "sphere_flake.py"


def test_spheres_touch_their_parents():
    spec = spec_from_file_location("sphere_flake", PATH)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    scene = module.sphere_flake(3)
    center, radius = np.asarray(scene.spheres.center), np.asarray(scene.spheres.radius)
    assert len(radius) == 1 + 9 + 81 + 729 and len(scene.lights) == 3
    parent = (np.arange(1, len(radius)) - 1) // 9
    apart = np.linalg.norm(center[1:] - center[parent], axis=1)
    np.testing.assert_allclose(apart, radius[1:] + radius[parent], rtol=1e-6)
    np.testing.assert_allclose(radius[1:], radius[parent] / 3, rtol=1e-6)
    # siblings keep clear of one another, and stand on the outer half of their parent
    siblings = center[1:].reshape(-1, 9, 3)
    between = np.linalg.norm(siblings[:, :, None] - siblings[:, None], axis=-1)
    between = np.where(np.eye(9, dtype=bool), np.inf, between).min(axis=(1, 2))
    assert (between > 2 * radius[1::9]).all()
    grown = center[parent[9:]] - center[parent[parent[9:] - 1]]
    assert (np.sum((center[10:] - center[parent[9:]]) * grown, axis=1) > -1e-6).all()
