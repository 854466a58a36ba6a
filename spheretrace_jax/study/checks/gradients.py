"""Gradient checks: forward mode, reverse mode and central differences, one against the other."""

import dataclasses
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...base.types import Highlight, Picture
from ...rendering.render import draw
from ...scene.needs import Needs
from ...scene.scene import Scene
from .settings import double_settings

# Step of the central differences, relative to a parameter's size. The error of the differences is
# near step^4 by truncation and 1e-16 / step by rounding.
_STEP = 1e-5

_STEPS = (-2 * _STEP, -_STEP, _STEP, 2 * _STEP)

# Compiler options for programs that run once on few pixels: compilation takes longest. The nine
# spheres' reverse mode with edges compiles in 34 s so, with all optimisations in 80.
_FAST_COMPILATION = {"xla_backend_optimization_level": 0}

# Tolerances, relative, of forward mode against differences and of reverse against forward mode. The
# first allows for the differences' error at kinks too weak to be found, the second for rounding.
_FORWARD, _REVERSE = 1e-3, 1e-10

# Largest disagreement, relative, of differences ahead and behind, or of one and two steps, in
# pixels that count. Above it an edge (a jump) or a kink lies within the step.
_KINK = 2e-2


@dataclasses.dataclass(frozen=True)
class GradientRow:
    """The agreement of the derivatives by one array of the scene, along one random direction."""

    parameter: str
    #: jvp against central differences: largest error, over the largest derivative if the
    #: differences tell that derivative from 0
    forward: float
    reverse: float  #: vjp against jvp, relative
    largest: float  #: the largest derivative in the picture
    left_out: int  #: pixels that do not count, with an edge or a kink within the step
    pixels: int

    @property
    def agree(self) -> bool:
        """Tells whether the three derivatives agree, within the error of the differences."""
        return self.forward <= _FORWARD and self.reverse <= _REVERSE


@dataclasses.dataclass(frozen=True)
class GradientTable:
    """One row per array of the scene. `print` shows it as a table."""

    rows: tuple[GradientRow, ...]
    antialias: bool = False  #: covered edges, which have derivatives, or single rays
    #: arrays without row, and the reasons
    idle: dict[str, str] = dataclasses.field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """Tells whether the derivatives of all rows agree, within the error of the differences."""
        return all(row.agree for row in self.rows)

    @property
    def words(self) -> tuple[str, ...]:
        """Explains which arrays and pixels the table leaves out."""
        reasons: dict[str, dict[str, list[str]]] = {}
        for name, reason in self.idle.items():
            field, _, array = name.partition(".")
            reasons.setdefault(reason, {}).setdefault(field, []).append(array)
        words = [
            f"left out, as {reason}: "
            + "; ".join(" ".join([field, *arrays]).strip() for field, arrays in fields.items())
            for reason, fields in reasons.items()
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
        """Returns the largest relative disagreement."""
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

    Each array moves along one random direction. Forward mode must equal central differences in
    every pixel that counts. Reverse mode must equal forward mode on a random weight picture, in
    all pixels. A pixel does not count where the picture is not smooth within the step of the
    differences: a silhouette, a shadow edge or the rim of a highlight passes. There differences
    ahead and behind, or of one and two steps, disagree.

    **Arguments:** as for `render`; by default all arrays are checked, also ks, kgr and kt of 0.
    `every`: False leaves out coefficients that are 0 in the whole scene, as absent mirrors take
    long to compile. `seed`: of the random directions and weights.

    **Returns:** a table with one row per array, which also counts the pixels left out.

    **Raises:** `InputError` as `render` does.
    """
    scene.check_dtype()
    with jax.enable_x64(True):
        idle = _idle(scene, every)
        scene, settings = double_settings(
            scene, width, height, highlight=highlight, bounces=bounces, samples=samples,
            needs=needs, free=("ks", "kgr", "kt", "background") if every else present(scene),
        )  # fmt: skip
        rows = _rows(scene, partial(draw, settings=settings), set(idle), seed)
    return GradientTable(rows, bool(scene.antialias), idle)


def _rows(
    scene: Scene, picture: Callable[[Scene], Picture], idle: set[str], seed: int
) -> tuple[GradientRow, ...]:
    """Compares the derivatives of a picture by each array of the scene that is not idle."""
    compiled = partial(jax.jit, compiler_options=_FAST_COMPILATION)
    forward = compiled(lambda s, ds: jax.jvp(picture, (s,), (ds,)))
    reverse = compiled(lambda s, w: jax.vjp(picture, s)[1](w)[0])
    rng = np.random.default_rng(seed)
    still = jax.tree.map(jnp.zeros_like, scene)
    unmoved, _ = forward(scene, still)
    weights = rng.standard_normal(unmoved.shape)
    gradient = _arrays(reverse(scene, jnp.asarray(weights)))
    structure, zeros = jax.tree.structure(scene), jax.tree.leaves(still)
    rows = []
    for k, (name, array) in enumerate(_arrays(scene).items()):
        if name in idle:
            continue
        size = float(jnp.max(jnp.abs(array))) or 1.0
        direction = jnp.asarray(rng.standard_normal(array.shape) * size)
        tangent = jax.tree.unflatten(structure, [*zeros[:k], direction, *zeros[k + 1 :]])
        moved = lambda h, along=tangent: jax.tree.map(lambda a, b: a + h * b, scene, along)
        pictures = {h: np.asarray(picture(moved(h))) for h in _STEPS}
        derivative = np.asarray(forward(scene, tangent)[1])
        pulled = float(jnp.vdot(gradient[name], direction))
        rows.append(_row(name, {0.0: np.asarray(unmoved), **pictures}, derivative, weights, pulled))
    return tuple(rows)


def present(scene: Scene) -> list[str]:
    """Lists those of ks, kgr and kt that are not 0 in the whole scene."""
    objects = scene.spheres, scene.planes
    nonzero = lambda name: any(np.asarray(getattr(each, name, 0)).any() for each in objects)
    return [name for name in ("ks", "kgr", "kt") if nonzero(name)]


def _idle(scene: Scene, every: bool) -> dict[str, str]:
    """Lists the arrays of a scene that have no row, with the reasons."""
    idle = {}
    for name in () if every else ("ks", "kgr", "kt"):
        if name not in present(scene):
            names = (name, "exponent") if name == "ks" else (name,)
            idle |= {
                f"{field}.{n}": f"every {name} is 0"
                for field in ("spheres", "planes")
                for n in names
            }
    if not (every or scene.sky is not None or np.asarray(scene.background).any()):
        idle["background"] = "the background is black"
    sizes = {name: leaf.size for name, leaf in _arrays(scene).items()}
    idle |= {n: f"the scene has no {n.partition('.')[0]}" for n, size in sizes.items() if not size}
    return {name: reason for name, reason in idle.items() if name in sizes}


def _arrays(scene: Scene) -> dict[str, Array]:
    """Returns all arrays of a scene by their names, such as `spheres.center`, in their order."""
    leaves = jax.tree_util.tree_flatten_with_path(scene)[0]
    return {jax.tree_util.keystr(path).lstrip("."): leaf for path, leaf in leaves}


def _row(
    name: str,
    at: dict[float, np.ndarray],
    derivative: np.ndarray,
    weights: np.ndarray,
    pulled: float,
) -> GradientRow:
    """Compares the derivatives along one direction.

    **Arguments:** `name`: the array's. `at`: the pictures at 0, 1 and 2 steps ahead and behind.
    `derivative`: the picture's, by forward mode. `weights`: the random weight picture. `pulled`:
    the derivative of the weighted sum, by reverse mode.
    """
    h = _STEP
    near, far = (at[h] - at[-h]) / (2 * h), (at[2 * h] - at[-2 * h]) / (4 * h)
    difference = (4 * near - far) / 3  # Richardson: of fourth order
    bend = np.abs(at[2 * h] - 2 * at[0.0] + at[-2 * h]) / (4 * h)
    steepness = np.maximum(np.abs(near), np.abs(far)).max(-1)
    rounding = 64 * np.finfo(np.float64).eps * (1 + np.abs(at[0.0]).max()) / h
    rough = np.maximum(bend, np.abs(near - far)).max(-1)
    smooth = rough <= _KINK * steepness + rounding
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
