"""Derivatives against one another: forward mode, reverse mode and central differences."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from ...base.types import Highlight
from ...rendering.render import render
from ...scene.needs import Needs, needs as needs_of
from ...scene.scene import Scene

# Of the central differences, relative to a parameter's size: their own error is near step^4 by
# truncation and 1e-16 / step by rounding.
_STEP = 1e-5

_STEPS = (-2 * _STEP, -_STEP, _STEP, 2 * _STEP)

# Few pixels are derived, once: the nine spheres' reverse mode with edges compiles in 34 s, with
# all optimisations in 80.
_QUICKLY = {"xla_backend_optimization_level": 0}

# Disagreements up to these are those of the differences, as far as kinks that are hardly seen pass
# within their step, and of rounding.
_FORWARD, _REVERSE = 1e-3, 1e-10

# Where differences ahead and behind, or of one and two steps, disagree by this much, relatively,
# an edge (a jump) or a kink lies within the step.
_KINK = 2e-2


@dataclasses.dataclass(frozen=True)
class GradientRow:
    """How the derivatives by one array of the scene agree, along one random direction."""

    parameter: str
    #: jvp against central differences: largest error over the largest derivative, if differences
    #: can tell that from 0
    forward: float
    reverse: float  #: vjp against jvp, relative
    largest: float  #: the largest derivative in the picture
    left_out: int  #: pixels that do not count: an edge or a kink lies within the step
    pixels: int

    @property
    def agree(self) -> bool:
        """Whether all three agree as far as differences are good."""
        return self.forward <= _FORWARD and self.reverse <= _REVERSE


@dataclasses.dataclass(frozen=True)
class GradientTable:
    """One row per array of the scene. `print` shows it as a table."""

    rows: tuple[GradientRow, ...]
    antialias: bool = False  #: whether edges are covered by area, and so have derivatives
    idle: dict[str, str] = dataclasses.field(default_factory=dict)  #: arrays without row, and why

    @property
    def ok(self) -> bool:
        """Whether forward mode, reverse mode and differences agree as far as these are good."""
        return all(row.agree for row in self.rows)

    @property
    def words(self) -> tuple[str, ...]:
        """What the table leaves out, and why."""
        reasons: dict[str, dict[str, list[str]]] = {}
        for name, why in self.idle.items():
            part, _, array = name.partition(".")
            reasons.setdefault(why, {}).setdefault(part, []).append(array)
        words = [
            f"left out, as {why}: " + "; ".join(" ".join([p, *a]).strip() for p, a in of.items())
            for why, of in reasons.items()
        ]
        if any(row.left_out for row in self.rows):
            words.append(
                "pixels do not count where an edge, the rim of a highlight or another kink "
                "passes within the step of the differences"
            )
        if not self.antialias:
            words.append(
                "the antialias flag is 0: pixels are single rays, which have no derivative where "
                "an edge moves"
            )
        return tuple(words)

    @property
    def worst(self) -> float:
        """The largest relative disagreement."""
        return max((max(row.forward, row.reverse) for row in self.rows), default=0.0)

    def __str__(self) -> str:
        lines = [f"{'parameter':24} {'jvp - fd':>9} {'vjp - jvp':>9} {'largest':>9} left out"]
        for r in self.rows:
            numbers = f"{r.forward:9.1e} {r.reverse:9.1e} {r.largest:9.1e}"
            lines.append(f"{r.parameter:24} {numbers} {r.left_out} of {r.pixels}")
        return "\n".join([*lines, *self.words])


def check_gradients(
    scene: Scene,
    *,
    width: int = 64,
    height: int = 64,
    highlight: Highlight = "phong",
    bounces: int = 5,
    samples: int = 1,
    needs: Needs | None = None,
    every: bool = True,
    seed: int = 0,
) -> GradientTable:
    """Compares the derivatives of a scene's picture by every array of the scene, in float64.

    Each array is moved along one random direction. Forward mode must equal central differences in
    every pixel that counts; reverse mode must equal forward mode on a random weight picture, in
    all pixels. A pixel does not count where the picture itself is not smooth within the step of
    the differences, because a silhouette, a shadow edge or the rim of a highlight passes: there
    differences ahead and behind, or of one and two steps, disagree.

    **Arguments:** as for `render`; by default everything is derived that could be, also kgr, kt
    and ks where they are 0. `every`: False leaves out coefficients that are 0 in the whole scene:
    mirrors that are not there take long to compile. `seed`: of the directions and weights.

    **Returns:** a table with one row per array, which also counts the pixels left out.
    """
    scene.check_dtype()
    with jax.enable_x64(True):
        scene = scene.astype(jnp.float64)
        idle = _idle(scene, every)
        if needs is None:
            needs = needs_of(
                scene, free=("ks", "kgr", "kt", "background") if every else present(scene)
            )
        picture = partial(
            render, width=width, height=height, highlight=highlight, bounces=bounces,
            samples=samples, needs=needs,
        )  # fmt: skip
        program = partial(jax.jit, compiler_options=_QUICKLY)
        forward = program(lambda s, ds: jax.jvp(picture, (s,), (ds,)))
        rng = np.random.default_rng(seed)
        still = jax.tree.map(jnp.zeros_like, scene)
        here, _ = forward(scene, still)
        weights = rng.standard_normal(here.shape)
        reverse = program(lambda s, w: jax.vjp(picture, s)[1](w)[0])(scene, jnp.asarray(weights))
        rows = []
        leaves, structure = jax.tree_util.tree_flatten_with_path(scene)
        zeros = jax.tree.leaves(still)
        for k, (path, leaf) in enumerate(leaves):
            name = jax.tree_util.keystr(path).lstrip(".")
            if name in idle:
                continue
            size = float(jnp.max(jnp.abs(leaf))) or 1.0
            along = jnp.asarray(rng.standard_normal(leaf.shape) * size)
            move = jax.tree.unflatten(structure, [*zeros[:k], along, *zeros[k + 1 :]])
            moved = lambda h, move=move: jax.tree.map(lambda a, b: a + h * b, scene, move)
            pictures = {h: np.asarray(picture(moved(h))) for h in _STEPS}
            rows.append(
                _row(
                    name,
                    {0.0: np.asarray(here), **pictures},
                    np.asarray(forward(scene, move)[1]),
                    weights,
                    float(jnp.vdot(jax.tree.leaves(reverse)[k], along)),
                )
            )
    return GradientTable(tuple(rows), bool(scene.antialias), idle)


def present(scene: Scene) -> list[str]:
    """Those of ks, kgr and kt that are not 0 in the whole scene."""
    parts = scene.spheres, scene.planes
    some = lambda name: any(np.asarray(getattr(part, name, 0)).any() for part in parts)
    return [name for name in ("ks", "kgr", "kt") if some(name)]


def _idle(scene: Scene, every: bool) -> dict[str, str]:
    """The arrays of a scene that have no row, and why."""
    idle = {}
    for name in () if every else ("ks", "kgr", "kt"):
        if name not in present(scene):
            names = (name, "exponent") if name == "ks" else (name,)
            idle |= {
                f"{part}.{n}": f"every {name} is 0" for part in ("spheres", "planes") for n in names
            }
    if not (every or scene.sky is not None or np.asarray(scene.background).any()):
        idle["background"] = "the background is black"
    leaves = jax.tree_util.tree_flatten_with_path(scene)[0]
    sizes = {jax.tree_util.keystr(path).lstrip("."): leaf.size for path, leaf in leaves}
    part = lambda name: name.partition(".")[0]
    idle |= {n: f"the scene has no {part(n)}" for n, size in sizes.items() if not size}
    return {name: why for name, why in idle.items() if name in sizes}


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
        forward=error / largest if largest > rounding else error,
        reverse=abs(pushed - pulled) / scale if scale > 0 else abs(pulled),
        largest=largest,
        left_out=int(np.count_nonzero(~smooth)),
        pixels=smooth.size,
    )
