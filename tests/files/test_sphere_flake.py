"""The sphere flake of data/make_sphere_flake.py: its spheres touch, and none lies in another."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest

import spheretrace_jax as st

PATH = Path(__file__).parents[2] / "data" / "make_sphere_flake.py"


def flake(size_factor: int, folder: Path) -> st.Scene:
    spec = spec_from_file_location("make_sphere_flake", PATH)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    (folder / "flake.nff").write_text(module.flake_text(size_factor))
    with pytest.warns(st.SceneWarning, match=r"flake.nff:14: polygon: the whole plane"):
        return st.load_scene(folder / "flake.nff", np.float64)


@pytest.mark.parametrize("size_factor, count", [(0, 1), (1, 10), (2, 91), (3, 820), (4, 7381)])
def test_counts(size_factor, count, tmp_path):
    scene = flake(size_factor, tmp_path)
    assert len(scene.spheres) == count and len(scene.lights) == 3 and len(scene.planes) == 1
    radius, number = np.unique(np.round(scene.spheres.radius, 7), return_counts=True)
    np.testing.assert_allclose(radius[::-1], 0.5 / 3.0 ** np.arange(size_factor + 1), atol=1e-7)
    np.testing.assert_array_equal(number[::-1], 9 ** np.arange(size_factor + 1))


def test_spheres_touch_their_parents(tmp_path):
    scene = flake(3, tmp_path)
    center, radius = np.asarray(scene.spheres.center), np.asarray(scene.spheres.radius)
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
    # six of the first nine around the equator, three above it, and the floor below all
    above = center[1:10, 2] > 1e-6
    assert above.sum() == 3 and np.abs(center[1:10, 2][~above]).max() < 1e-6
    assert (center[:, 2] - radius).min() > -0.5 - 1e-6
