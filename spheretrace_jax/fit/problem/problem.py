"""`Problem`: the least-squares problem of a fit, for one picture or for several of one world."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.sharding import NamedSharding
from jaxtyping import Array, Bool, Float, PyTree

from ...base.errors import InputError
from ...base.types import Highlight, Picture
from ...rendering.render import draw_everywhere
from ...scene.needs import needs
from ...scene.scene import Scene
from ...scene.settings import RenderSettings, render_settings
from ...tracing.context import build_context
from ...xla.jit import compiled
from ...xla.sharding import everywhere, gathered, on_devices
from ..model.parameters import (
    CAMERA,
    GEOMETRY,
    LIGHTS,
    PLACES,
    Parameters,
    check_free,
    check_present,
    value,
)
from ..model.target import Target, make_target
from ..normal_equations.normal_equations import NormalEquations, normal_equations
from ..normal_equations.parameter_index import ParameterIndex
from ..normal_equations.pixel_buckets import PixelBuckets, bucket_pixels

# Coarser pictures have pixels this many times as wide, and at least so many along each side.
_WIDENS, _FEWEST = 5, 48


class Problem(eqx.Module):
    """Pictures to fit, the scenes to start from and what is free.

    The unknowns are a dict `name -> array` of dimensionless numbers (`parameters.py`), a list of
    arrays, one for each picture, for what each picture has of its own.
    """

    parameters: tuple[Parameters, ...]  #: one for each picture
    targets: tuple[Target, ...]
    settings: tuple[RenderSettings, ...]
    lists: tuple[PixelBuckets | None, ...]  #: what pixels show, if that is fixed; by device
    own: frozenset[str] = eqx.field(static=True)  #: the names of what each picture has of its own

    def start(self) -> PyTree:
        """The unknowns at the start."""
        return self._gathered([p.start() for p in self.parameters])

    def bounds(self) -> tuple[PyTree, PyTree]:
        """The least and the greatest that the unknowns may be."""
        least, most = zip(*(p.bounds() for p in self.parameters), strict=True)
        return self._gathered(least), self._gathered(most)

    def _gathered(self, each: Sequence[dict]) -> PyTree:
        """Of all pictures' unknowns what each has of its own, and the first one's others."""
        return {
            name: [values[name] for values in each] if name in self.own else shared
            for name, shared in each[0].items()
        }

    def at_bounds(self, values: PyTree) -> Bool[Array, " free"]:
        """Which of the unknowns are as little or as much as they may be."""
        y, least, most = (ravel_pytree(v)[0] for v in (values, *self.bounds()))
        return (y <= least) | (y >= most)

    def of_picture(self, values: PyTree, k: int) -> dict:
        """The unknowns that picture k depends on."""
        return {name: y[k] if name in self.own else y for name, y in values.items()}

    def place(self, values: PyTree) -> list[tuple[Scene, Float[Array, " 3"]]]:
        """Each picture's scene and exposure."""
        return [p.place(self.of_picture(values, k)) for k, p in enumerate(self.parameters)]

    def residual(self, values: PyTree) -> Float[Array, " numbers"]:
        """All pictures' residuals, flat."""
        pairs = zip(self.targets, self.pictures(values), strict=True)
        parts = [target.residual(*picture).reshape(-1) for target, picture in pairs]
        return jnp.concatenate(parts)

    def starting_at(self, scenes: Sequence[Scene]) -> "Problem":
        """The same from other scenes; from one, if it is the start of all pictures."""
        if len(scenes) == len(self.parameters):
            starts = list(scenes)
        else:
            first = scenes[0]
            names = [n for n in self.parameters[0].free if n != "exposure" and n not in self.own]
            at = lambda s: [PLACES[name](s) for name in names]
            starts = [eqx.tree_at(at, p.scene, at(first)) for p in self.parameters]
        parameters = tuple(
            Parameters(s, p.free) for s, p in zip(starts, self.parameters, strict=True)
        )
        return eqx.tree_at(lambda p: p.parameters, self, parameters)

    def coarser(self) -> "list[Problem]":
        """The same problem of fewer, wider pixels, from the widest on.

        Only where edges move: they have a derivative for as long as they stay within their pixels,
        so that the wider these are, the further a step can go. None that leave out most of what
        counts, as of boxes with gaps in them.
        """
        if any(o.box is None for o in self.settings):
            return []
        found, side = [], _WIDENS
        while side * _FEWEST <= min(min(o.width, o.height) for o in self.settings):
            wide = _of_boxes(self, side)
            if wide.counted * side**2 < self.counted / 2:
                break
            found.append(wide)
            side *= _WIDENS
        return found[::-1]

    @property
    def dtype(self) -> np.dtype:
        """The floating dtype of the unknowns."""
        return self.parameters[0].scene.dtype

    @property
    def counted(self) -> int:
        """How many of the targets' numbers count."""
        return sum(t.counted for t in self.targets)

    @property
    def length(self) -> float:
        """The root of the sum of the squares of the targets' weighted numbers."""
        return float(np.linalg.norm([t.length for t in self.targets]))

    @property
    def noise(self) -> list[float]:
        """Each target's noise, as robust losses take it."""
        return [float(t.noise) for t in self.targets]

    def pictures(self, values: PyTree) -> list[tuple[Picture, Float[Array, " 3"]]]:
        """Each scene's picture and its exposure."""
        placed = zip(self.place(values), self.settings, strict=True)
        return [(draw_everywhere(scene, o), exposure) for (scene, exposure), o in placed]

    def with_noise_at(self, values: PyTree) -> "Problem":
        """The same, with each target's noise estimated from what is left at some values."""
        return self._with_targets(Target.with_noise_of, values)

    def without_worst_at(self, values: PyTree) -> "Problem":
        """The same without the numbers that fit worst at some values."""
        return self._with_targets(Target.without_worst, values)

    def _with_targets(self, change: Callable[..., Target], values: PyTree) -> "Problem":
        pairs = zip(self.targets, self.pictures(values), strict=True)
        targets = tuple(change(target, *picture) for target, picture in pairs)
        return eqx.tree_at(lambda p: p.targets, self, targets)

    def layout(self, k: int) -> ParameterIndex:
        """Where picture k's free parameters are in its normal equations."""
        return ParameterIndex(self.parameters[k].scene, self.parameters[k].free)

    def normal(self, values: PyTree) -> NormalEquations:
        """The normal equations by the unknowns, in the order of `ravel_pytree`."""
        parts = []
        for k, (scene, exposure) in enumerate(self.place(values)):
            layout = self.layout(k)
            part = normal_equations(
                scene, exposure, self.targets[k], layout, self.settings[k], self.lists[k]
            )
            slope = self.slope(values, k)
            part = NormalEquations(
                slope.T @ part.square @ slope, slope.T @ part.gradient, part.cost
            )
            parts.append(part)
        return jax.tree.map(lambda *x: sum(x[1:], x[0]), *parts)

    def slope(self, values: PyTree, k: int) -> Float[Array, "natural free"]:
        """The derivatives of picture k's free parameters, in its layout, by the unknowns."""
        y, unravel = ravel_pytree(values)

        def natural(y: Float[Array, " free"]) -> Float[Array, " natural"]:
            parts = self.parameters[k].natural(self.of_picture(unravel(y), k))
            return jnp.concatenate([parts[n].reshape(-1) for n in self.parameters[k].free])

        return jax.jacfwd(natural)(y)


@compiled
def _of_boxes(problem: Problem, side: int) -> Problem:
    """The same problem of the means of boxes of pixels."""
    at = lambda p: [*p.targets, *(o.box for o in p.settings)]
    targets = [t.of_boxes(side) for t in problem.targets]
    boxes = [jnp.asarray(side, problem.dtype) for _ in problem.settings]
    return eqx.tree_at(at, problem, [*targets, *boxes])


@compiled
def normal_at(problem: Problem, values: PyTree) -> NormalEquations:
    """`Problem.normal`, compiled: for all that asks for it on the host."""
    return problem.normal(values)


@jax.custom_jvp
def compressed_residual(values: PyTree, problem: Problem) -> Float[Array, " compressed"]:
    """One number more than there are unknowns, with the cost and the Gauss-Newton step of all.

    With J^T J = R^T R the residual is (R^-T J^T r, sqrt(r.r - |R^-T J^T r|^2)) and its Jacobian
    (R, 0): least-squares solvers see the same cost, gradient and J^T J, and never the picture's
    J. Along what the picture does not determine R is 0.
    """
    return compress(problem.normal(values))[0]


@compressed_residual.defjvp
def _compressed_jvp(primals, tangents):
    residual, jacobian = compress(primals[1].normal(primals[0]))
    step, _ = ravel_pytree(tangents[0])
    return residual, jacobian @ step


def compress(
    normal: NormalEquations,
) -> tuple[Float[Array, " compressed"], Float[Array, "compressed free"]]:
    """The compressed residual and its Jacobian."""
    n = normal.gradient.size
    scale = jnp.sqrt(jnp.diag(normal.square))
    scale = jnp.where(scale > 0, scale, 1)
    values, vectors = jnp.linalg.eigh(normal.square / scale[:, None] / scale[None, :])
    known = values > n * jnp.finfo(values.dtype).eps * jnp.max(values)
    root = jnp.sqrt(jnp.where(known, values, 1))
    # the symmetric root: another would turn with every rounding, and seem to move
    factor = vectors @ (jnp.where(known, root, 0)[:, None] * vectors.T) * scale[None, :]
    residual = vectors @ jnp.where(known, vectors.T @ (normal.gradient / scale) / root, 0)
    rest = jnp.sqrt(jnp.maximum(2 * normal.cost - residual @ residual, 0))
    return jnp.append(residual, rest), jnp.pad(factor, ((0, 1), (0, 0)))


def make_problem(
    scene: Scene | Sequence[Scene],
    target: Any,
    free: tuple[str, ...],
    own: tuple[str, ...],
    highlight: Highlight,
    bounces: int,
    samples: int,
    sharding: NamedSharding | None = None,
    **counts: Any,
) -> Problem:
    """Checks what a user asks for. **Arguments:** as for `fit`; `counts`: as for `make_target`."""
    check_free(free)
    scenes = [scene] if isinstance(scene, Scene) else list(scene)
    several = not isinstance(scene, Scene)
    target, counts = gathered((target, counts))
    images = list(target) if several or isinstance(target, list | tuple) else [target]
    if len(scenes) != len(images) or not scenes:
        raise InputError(
            f"there must be one target for each scene, got {len(scenes)} scenes and "
            f"{len(images)} targets"
        )
    for one in scenes:
        one.check_dtype()
        check_present(one, free)
    own_names = frozenset(own) | ({"exposure"} & set(free) if several else set())
    _check_own(scenes, free, own_names)
    each = {name: _each(name, x, len(scenes)) if several else [x] for name, x in counts.items()}
    targets, settings, fixed = [], [], not GEOMETRY & set(free)
    for k, (one, image) in enumerate(zip(scenes, images, strict=True)):
        goal = make_target(image, one.dtype, **{name: x[k] for name, x in each.items()})
        height, width, _ = goal.image.shape
        wanted = needs(one, free=[name for name in free if name != "exposure"])
        seen = render_settings(
            one, width, height, highlight=highlight, bounces=bounces, samples=samples,
            needs=wanted, sharding=sharding,
        )  # fmt: skip
        if seen.antialias and not fixed:
            seen = dataclasses.replace(seen, box=jnp.ones((), one.dtype))
        settings.append(seen)
        targets.append(goal)
    scenes, targets = everywhere((scenes, targets), settings[0].sharding)
    parameters = tuple(Parameters(one, free) for one in scenes)
    lists = tuple(
        _lists(one, free, o) if fixed and not o.antialias else None
        for one, o in zip(scenes, settings, strict=True)
    )
    return Problem(parameters, tuple(targets), tuple(settings), lists, own_names)


@compiled
def _lists(scene: Scene, free: tuple[str, ...], settings: RenderSettings) -> PixelBuckets:
    # of all pixels: the target of a problem may be replaced by one of which others count
    layout = ParameterIndex(scene, free)
    if settings.sharding is None:
        return bucket_pixels(build_context(scene, settings, accelerated=False), layout)

    def of_device(scene: Scene, _: None) -> PixelBuckets:
        context = build_context(scene, settings.of_device, accelerated=False)
        return bucket_pixels(context, layout)

    return on_devices(of_device, settings.sharding, scene)


def _each(name: str, value: Any, count: int) -> list:
    """What counts in each picture, from one value for all or a list.

    **Raises:** `InputError` for lists of other lengths, and noise of some pictures only: residuals
    would be in different units.
    """
    if not isinstance(value, list | tuple):
        return [value] * count
    if len(value) != count:
        raise InputError(f"{name} must be one for all or one for each of {count}, got {len(value)}")
    if name == "noise" and any(x is None for x in value):
        raise InputError("noise must be given for all pictures or for none")
    return list(value)


def _check_own(scenes: list[Scene], free: tuple[str, ...], own: frozenset[str]) -> None:
    """**Raises:** `InputError` for scenes of different worlds, and for names that are not free."""
    possible = {*LIGHTS, *CAMERA, "exposure"}
    wrong = sorted(own - (possible & set(free)))
    if wrong:
        raise InputError(
            f"own must name free parameters of lights or camera, got {', '.join(wrong)}"
        )
    first = scenes[0]
    for k, other in enumerate(scenes[1:], 2):
        for part in ("spheres", "planes", "textures"):
            if not bool(eqx.tree_equal(getattr(first, part), getattr(other, part))):
                raise InputError(f"scene {k} has other {part} than the first: they must be equal")
        for name in sorted((possible - {"exposure"}) & set(free) - own):
            if not bool(eqx.tree_equal(value(first, name), value(other, name))):
                raise InputError(
                    f"{name} is free and starts differently in scene {k}: name it in own, or "
                    "start all pictures alike"
                )
