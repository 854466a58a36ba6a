"""Derivatives at all these extremes.
A weighted sum of each picture above is differentiated in reverse mode by each array. The derivative
along a random relative change of the array is compared with central differences of the lecture's
formulas in numbers of 50 digits. An eps is relative to the sum of all |derivative x change| and of
the weighted sum.
"""

import jax
import numpy as np

import spheretrace_jax as st
from extremes import shading, views
from extremes.case import Case
from extremes.exact import exact, picture, slope, to_exact
from extremes.pictures import SIDE, WEIGHTS, Extreme, drawn

SCENES = shading.SCENES | views.SCENES


def derivative_case(tried: str, extreme: Extreme) -> Case:
    """Compares the derivatives by all arrays of a scene with exact ones, if these exist."""

    def check() -> str:
        scene, found = extreme.scene.astype(np.float32), []
        for dtype in (np.float32, np.float64):
            slopes, _ = drawn(scene.astype(dtype), extreme.bounces)
            found.append(jax.tree.map(np.asarray, slopes))
            assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slopes)), slopes
        if not extreme.smooth:
            return "all finite"
        off = errors(scene, found, extreme.bounces)
        worst = [max(eps.items(), key=lambda item: item[1]) for eps in off]
        assert max(eps for _, eps in worst) <= extreme.slopes, worst
        each = zip(worst, ("float32", "float64"), strict=True)
        return ", ".join(f"{eps:.2g} eps in {dtype} ({name})" for (name, eps), dtype in each)

    suffix = (
        f"; right to {extreme.slopes:g} eps" if extreme.smooth else " (it has a jump or a kink)"
    )
    return Case(tried, "finite" + suffix, check, slow=extreme.bounces > 0)


def errors(scene: st.Scene, found: list[st.Scene], bounces: int) -> list[dict[str, float]]:
    """Returns the errors of derivatives by each array of a scene, in eps of their type."""
    rng, weights, true = np.random.default_rng(1), to_exact(WEIGHTS), exact(scene)
    value = lambda scene: (weights * picture(scene, (SIDE, SIDE), bounces)).sum()
    total, off = float(value(true)), [{} for _ in found]
    for k, (path, leaf) in enumerate(jax.tree_util.tree_flatten_with_path(scene)[0]):
        if leaf.size == 0:
            continue
        leaf = np.asarray(leaf, np.float64)
        move = np.where(leaf == 0, 1, np.abs(leaf)) * rng.uniform(0.5, 1, leaf.shape)
        expected = slope(true, k, to_exact(move), value)
        for slopes, of_array in zip(found, off, strict=True):
            eps = np.finfo(slopes.spheres.radius.dtype).eps
            terms = np.float64(jax.tree.leaves(slopes)[k]) * move
            error = abs(float(terms.sum() - expected)) / (np.abs(terms).sum() + total or 1)
            of_array[jax.tree_util.keystr(path).lstrip(".")] = error / eps
    return off


DERIVATIVES = [derivative_case(tried, extreme) for tried, extreme in SCENES.items()]
