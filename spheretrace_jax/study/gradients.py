"""Derivatives against one another: forward mode, reverse mode and central differences."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Highlight
from ..needs import Needs, needs as needs_of
from ..render import render
from ..scene import Scene

# Of the central differences, relative to a parameter's size: their own error is near step^4 by
# truncation and 1e-16 / step by rounding.
_STEP = 1e-5

_STEPS = (-2 * _STEP, -_STEP, _STEP, 2 * _STEP)

# Where differences ahead and behind, or of one and two steps, disagree by this much, relatively,
# an edge (a jump) or a kink lies within the step.
_KINK = 2e-2


@dataclasses.dataclass(frozen=True)
class GradientRow:
    """How the derivatives by one array of the scene agree, along one random direction."""

    parameter: str
    forward: float  #: jvp against central differences: largest error over the largest derivative
    reverse: float  #: vjp against jvp, relative
    largest: float  #: the largest derivative in the picture
    left_out: int  #: pixels that do not count: an edge or a kink lies within the step
    pixels: int


@dataclasses.dataclass(frozen=True)
class GradientTable:
    """One row per array of the scene. `print` shows it as a table."""

    rows: tuple[GradientRow, ...]

    @property
    def worst(self) -> float:
        """The largest relative disagreement."""
        return max((max(row.forward, row.reverse) for row in self.rows), default=0.0)

    def __str__(self) -> str:
        lines = [f"{'parameter':24} {'jvp - fd':>9} {'vjp - jvp':>9} {'largest':>9} left out"]
        for r in self.rows:
            numbers = f"{r.forward:9.1e} {r.reverse:9.1e} {r.largest:9.1e}"
            lines.append(f"{r.parameter:24} {numbers} {r.left_out} of {r.pixels}")
        return "\n".join(lines)


def check_gradients(
    scene: Scene,
    *,
    width: int = 64,
    height: int = 64,
    highlight: Highlight = "phong",
    bounces: int = 5,
    samples: int = 1,
    needs: Needs | None = None,
    seed: int = 0,
) -> GradientTable:
    """Compares the derivatives of a scene's picture by every array of the scene, in float64.

    Each array is moved along one random direction. Forward mode must equal central differences in
    every pixel that counts; reverse mode must equal forward mode on a random weight picture, in
    all pixels. A pixel does not count where the picture itself is not smooth within the step of
    the differences, because a silhouette, a shadow edge or the rim of a highlight passes: there
    differences ahead and behind, or of one and two steps, disagree.

    **Arguments:** as for `render`; by default everything is derived that could be, also kgr, kt
    and ks where they are 0. `seed`: of the directions and weights.

    **Returns:** a table with one row per array, which also counts the pixels left out.
    """
    scene.check_dtype()
    with jax.enable_x64(True):
        scene = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), jnp.float64), scene)
        if needs is None:
            needs = needs_of(scene, free=("ks", "kgr", "kt", "background"))
        picture = partial(
            render, width=width, height=height, highlight=highlight, bounces=bounces,
            samples=samples, needs=needs,
        )  # fmt: skip
        forward = jax.jit(lambda s, ds: jax.jvp(picture, (s,), (ds,)))
        rng = np.random.default_rng(seed)
        still = jax.tree.map(jnp.zeros_like, scene)
        here, _ = forward(scene, still)
        weights = rng.standard_normal(here.shape)
        reverse = jax.jit(lambda s, w: jax.vjp(picture, s)[1](w)[0])(scene, jnp.asarray(weights))
        rows = []
        leaves, structure = jax.tree_util.tree_flatten_with_path(scene)
        zeros = jax.tree.leaves(still)
        for k, (path, leaf) in enumerate(leaves):
            if leaf.size == 0:
                continue
            size = float(jnp.max(jnp.abs(leaf))) or 1.0
            along = jnp.asarray(rng.standard_normal(leaf.shape) * size)
            move = jax.tree.unflatten(structure, [*zeros[:k], along, *zeros[k + 1 :]])
            moved = lambda h, move=move: jax.tree.map(lambda a, b: a + h * b, scene, move)
            pictures = {h: np.asarray(picture(moved(h))) for h in _STEPS}
            rows.append(
                _row(
                    jax.tree_util.keystr(path).lstrip("."),
                    {0.0: np.asarray(here), **pictures},
                    np.asarray(forward(scene, move)[1]),
                    weights,
                    float(jnp.vdot(jax.tree.leaves(reverse)[k], along)),
                )
            )
    return GradientTable(tuple(rows))


def _row(
    name: str,
    at: dict[float, np.ndarray],
    derivative: np.ndarray,
    weights: np.ndarray,
    pulled: float,
) -> GradientRow:
    """**Arguments:** `at`: the picture at 0, 1 and 2 steps ahead and behind."""
    h = _STEP
    near, far = (at[h] - at[-h]) / (2 * h), (at[2 * h] - at[-2 * h]) / (4 * h)
    difference = (4 * near - far) / 3  # Richardson: of fourth order
    bend = np.abs(at[2 * h] - 2 * at[0.0] + at[-2 * h]) / (4 * h)
    slope = np.maximum(np.abs(near), np.abs(far)).max(-1)
    rounding = 64 * np.finfo(np.float64).eps * (1 + np.abs(at[0.0]).max()) / h
    rough = np.maximum(bend, np.abs(near - far)).max(-1)
    smooth = rough <= _KINK * slope + rounding
    counted = np.where(smooth[..., None], derivative, 0)
    largest = float(np.abs(counted).max())
    error = float(np.abs(counted - np.where(smooth[..., None], difference, 0)).max())
    pushed = float(np.sum(weights * derivative))
    scale = float(np.sum(np.abs(weights * derivative)))
    return GradientRow(
        parameter=name,
        forward=error / largest if largest > 0 else error,
        reverse=abs(pushed - pulled) / scale if scale > 0 else abs(pulled),
        largest=largest,
        left_out=int(np.count_nonzero(~smooth)),
        pixels=smooth.size,
    )
