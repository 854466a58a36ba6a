"""Gradient checks: forward and reverse mode, second derivatives and central differences."""

import dataclasses
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.types import Highlight, Picture
from ...rendering.render import draw
from ...scene.needs import Needs
from ...scene.scene import Scene, check_scene
from .settings import double_settings

# Step of the central differences, relative to a parameter's size. The error of the differences is
# near step^4 by truncation and 1e-16 / step by rounding.
_STEP = 1e-5

_STEPS = (-2 * _STEP, -_STEP, _STEP, 2 * _STEP)

# The array that is 0 where a light has no fall-off.
_FALLOFF = "lights.falloff"

# Compiler options for programs that run once on few pixels: compilation takes longest. The nine
# spheres' reverse mode with edges compiles in 34 s so, with all optimisations in 80.
_FAST_COMPILATION = {"xla_backend_optimization_level": 0}

# Tolerances, relative, of forward mode against differences and of reverse against forward mode. The
# first allows for the differences' error at kinks too weak to be found, the second for rounding.
# Second derivatives have that of forward mode.
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
    #: jvp of jvp against central differences of the jvp, as `forward`; None if not asked for
    second: float | None = None
    #: pixels that do not count for `second`: the first derivative has a jump or a kink
    second_left_out: int = 0

    @property
    def agree(self) -> bool:
        """Tells whether all derivatives agree, within the error of the differences."""
        return max(self.forward, self.second or 0.0) <= _FORWARD and self.reverse <= _REVERSE

    @property
    def worst(self) -> float:
        """Returns the largest relative disagreement."""
        return max(self.forward, self.reverse, self.second or 0.0)


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
        if any(row.left_out or row.second_left_out for row in self.rows):
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
        return max((row.worst for row in self.rows), default=0.0)

    @property
    def columns(self) -> tuple[str, ...]:
        """Returns the titles of the table's columns."""
        second = ("second - fd",) if any(r.second is not None for r in self.rows) else ()
        return ("parameter", "jvp - fd", "vjp - jvp", *second, "largest", "left out")

    def cells(self, row: GradientRow) -> tuple[str, ...]:
        """Returns one row of the table as texts, one for each of `columns`."""
        left_out = f"{row.left_out} of {row.pixels}"
        numbers = [row.forward, row.reverse, row.largest]
        if row.second is not None:
            numbers.insert(2, row.second)
            left_out = f"{row.left_out}, {row.second_left_out} of {row.pixels}"
        return (row.parameter, *(f"{number:.1e}" for number in numbers), left_out)

    def __str__(self) -> str:
        rows = [self.columns, *map(self.cells, self.rows)]
        line = lambda cells: " ".join([f"{cells[0]:24}", *(f"{c:>11}" for c in cells[1:])])
        return "\n".join([*map(line, rows), *self.words])


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
    second: bool = True,
    seed: int = 0,
) -> GradientTable:
    """Compares the derivatives of a scene's picture by every array of the scene, in float64.

    Each array moves along one random direction. Forward mode must equal central differences in
    every pixel that counts. Reverse mode must equal forward mode on a random weight picture, in
    all pixels. A pixel does not count where the picture is not smooth within the step of the
    differences: a silhouette, a shadow edge or the rim of a highlight passes. There differences
    ahead and behind, or of one and two steps, disagree. Second derivatives along the direction,
    forward over forward, must equal central differences of the first ones in the same way.

    **Arguments:** as for `render`; by default all arrays are checked, also ks, kgr and kt of 0,
    but not ior where every one is 1, where its derivative is 0. `every`: False leaves out
    coefficients that are 0 in the whole scene, as absent mirrors take long to compile. `second`:
    False leaves out second derivatives, which with covered edges take about as long to compile as
    all else. `seed`: of the random directions and weights.

    **Returns:** a table with one row per array, which also counts the pixels left out.

    **Raises:** `InputError` as `render` does.
    """
    scene = check_scene(scene)
    with jax.enable_x64(True):
        idle = _idle(scene, every)
        scene, settings = double_settings(
            scene, width, height, highlight=highlight, bounces=bounces, samples=samples,
            needs=needs, free=("ks", "kgr", "kt", "background") if every else present(scene),
        )  # fmt: skip
        rows = _rows(scene, partial(draw, settings=settings), set(idle), second, seed)
    return GradientTable(rows, bool(scene.antialias), idle)


def _rows(
    scene: Scene, picture: Callable[[Scene], Picture], idle: set[str], second: bool, seed: int
) -> tuple[GradientRow, ...]:
    """Compares the derivatives of a picture by each array of the scene that is not idle."""
    compiled = partial(jax.jit, compiler_options=_FAST_COMPILATION)
    along = lambda s, ds: jax.jvp(picture, (s,), (ds,))
    twice = lambda s, ds: jax.jvp(lambda s: along(s, ds)[1], (s,), (ds,))[1]
    forward, bent = compiled(along), compiled(twice)
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
        if name == _FALLOFF:  # 0 is none, not a small one
            direction = jnp.where(array > 0, direction, 0)
        tangent = jax.tree.unflatten(structure, [*zeros[:k], direction, *zeros[k + 1 :]])
        moved = lambda h, by=tangent: jax.tree.map(lambda a, b: a + h * b, scene, by)
        both = {h: tuple(map(np.asarray, forward(moved(h), tangent))) for h in (0.0, *_STEPS)}
        pictures, derivatives = ({h: pair[k] for h, pair in both.items()} for k in range(2))
        row = _row(name, pictures, derivatives[0.0], weights, jnp.vdot(gradient[name], direction))
        if second:
            error, _, smooth = _against_differences(derivatives, np.asarray(bent(scene, tangent)))
            left_out = int(np.count_nonzero(~smooth))
            row = dataclasses.replace(row, second=error, second_left_out=left_out)
        rows.append(row)
    return tuple(rows)


def present(scene: Scene) -> list[str]:
    """Lists those of ks, kgr, kt and ior that are not 0, or 1, in the whole scene."""
    objects, plain = (scene.spheres, scene.planes), {"ks": 0, "kgr": 0, "kt": 0, "ior": 1}
    differs = lambda name: any(
        (np.asarray(getattr(each, name, plain[name])) != plain[name]).any() for each in objects
    )
    return [name for name in plain if differs(name)]


def _idle(scene: Scene, every: bool) -> dict[str, str]:
    """Lists the arrays of a scene that have no row, with the reasons."""
    idle = {}
    if "ior" not in present(scene):
        idle = {f"{field}.ior": "every ior is 1" for field in ("spheres", "planes")}
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
    if not np.asarray(scene.lights.falloff).any():
        idle[_FALLOFF] = "no light has a fall-off"
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
    pulled: Float[Array, ""],
) -> GradientRow:
    """Compares the derivatives along one direction.

    **Arguments:** `name`: the array's. `at`: the pictures at 0, 1 and 2 steps ahead and behind.
    `derivative`: the picture's, by forward mode. `weights`: the random weight picture. `pulled`:
    the derivative of the weighted sum, by reverse mode.
    """
    error, largest, smooth = _against_differences(at, derivative)
    pushed = float(np.sum(weights * derivative))
    scale = float(np.sum(np.abs(weights * derivative)))
    return GradientRow(
        parameter=name,
        forward=error,
        reverse=abs(pushed - float(pulled)) / (scale if scale > 0 else 1),
        largest=largest,
        left_out=int(np.count_nonzero(~smooth)),
        pixels=smooth.size,
    )


def _against_differences(
    at: dict[float, np.ndarray], derivative: np.ndarray
) -> tuple[float, float, np.ndarray]:
    """Compares a derivative with central differences of a picture.

    **Arguments:** as for `_row`.

    **Returns:** the largest error, over the largest derivative if the differences tell that from 0;
    the largest derivative; and the pixels that count, in which the picture is smooth.
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
    return error / largest if largest > rounding else error, largest, smooth
