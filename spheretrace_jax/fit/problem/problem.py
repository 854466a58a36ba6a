"""`Problem`: the least-squares problem of a fit, for one picture or for several of one scene."""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, PyTree

from ...base.types import Picture
from ...rendering.render import draw_replicated
from ...scene.arrays import is_traced
from ...scene.parameters import LIGHT_PLACES
from ...scene.scene import Scene
from ...scene.settings import RenderSettings
from ...scene.values import with_values
from ...xla.jit import compiled
from ..model.accessors import value
from ..model.parameters import Parameters
from ..model.target import Target
from ..normal_equations.gbuffer import GBuffer, fixed_arrays, make_gbuffer
from ..normal_equations.normal_equations import NormalEquations, normal_equations
from ..normal_equations.parameter_index import ParameterIndex

# Coarse to fine: each coarser picture's pixels are `_COARSENING` times as wide, an odd number, so
# that boxes have middles; wider pixels allow longer steps and tell less. A picture is coarsened
# while `_LEAST_BOXES` of them lie along each side; with fewer the coarse fit leads astray.
_COARSENING, _LEAST_BOXES = 5, 48

# The noise, in norms of a picture's numbers, of which no residual is a part that robust losses
# bend: parts below the root of a rounding error.
_BEYOND = 1e10


class Problem(eqx.Module):
    """The pictures to fit, the scenes to start from, and what is free.

    The unknowns are a dict `name -> array` of dimensionless numbers (`fit/model/parameters.py`).
    Parameters that each picture has apart have a list of arrays there, one for each picture.
    """

    parameters: tuple[Parameters, ...]  #: one for each picture
    targets: tuple[Target, ...]
    settings: tuple[RenderSettings, ...]
    #: the pictures' shading samples, where geometry and camera are fixed
    buffers: tuple[GBuffer | None, ...]
    per_picture: frozenset[str] = eqx.field(static=True)  #: names with an array for each picture

    def start(self) -> PyTree:
        """Returns the unknowns at the start."""
        return self._merged([p.start() for p in self.parameters])

    def bounds(self) -> tuple[PyTree, PyTree]:
        """Returns the least and the greatest that the unknowns may be."""
        lower, upper = zip(*(p.bounds() for p in self.parameters), strict=True)
        return self._merged(lower), self._merged(upper)

    def _merged(self, pictures: Sequence[dict]) -> PyTree:
        """Merges all pictures' unknowns; shared ones are the first picture's."""
        return {
            name: [values[name] for values in pictures] if name in self.per_picture else shared
            for name, shared in pictures[0].items()
        }

    def at_bounds(self, values: PyTree) -> Bool[Array, " free"]:
        """Returns which of the unknowns are as little or as much as they may be."""
        y, lower, upper = (ravel_pytree(v)[0] for v in (values, *self.bounds()))
        return (y <= lower) | (y >= upper)

    def picture_unknowns(self, values: PyTree, k: int) -> dict:
        """Returns the unknowns that picture k depends on."""
        return {name: y[k] if name in self.per_picture else y for name, y in values.items()}

    def scenes_at(self, values: PyTree) -> list[tuple[Scene, Float[Array, " 3"]]]:
        """Returns each picture's scene and exposure."""
        return [p.scene_at(self.picture_unknowns(values, k)) for k, p in enumerate(self.parameters)]

    def residual(self, values: PyTree) -> Float[Array, " numbers"]:
        """Returns all pictures' residuals, flat, and those of the priors."""
        pairs = zip(self.targets, self.pictures(values), strict=True)
        residuals = [target.residual(*picture).reshape(-1) for target, picture in pairs]
        residuals += [self._prior_residual(values, k) for k in self._constrained]
        return jnp.concatenate(residuals)

    @property
    def _constrained(self) -> list[int]:
        """Returns the pictures whose parameters may have priors."""
        return [k for k, p in enumerate(self.parameters) if p.constraints]

    def _prior_residual(self, values: PyTree, k: int) -> Float[Array, " natural"]:
        parameters = self.parameters[k]
        return parameters.prior_residual(parameters.natural(self.picture_unknowns(values, k)))

    @property
    def priors(self) -> list[str]:
        """Returns the names of parameters that have priors."""
        return list(dict.fromkeys(name for p in self.parameters for name in p.priors))

    def without_priors(self) -> "Problem":
        """Returns the problem of the pictures alone."""
        parameters = tuple(p.without_priors() for p in self.parameters)
        return eqx.tree_at(lambda p: p.parameters, self, parameters)

    def starting_at(self, scenes: Sequence[Scene]) -> "Problem":
        """Returns the problem with other starts.

        **Arguments:** `scenes`: one for each picture, or one from which all take what they share.
        """
        if len(scenes) == len(self.parameters):
            starts = list(scenes)
        else:
            first = scenes[0]
            shared = self.per_picture | {"exposure"}
            names = [n for n in self.parameters[0].free if n not in shared]
            shared_values = {name: value(first, name) for name in names}
            starts = [with_values(p.scene, shared_values) for p in self.parameters]
        pairs = zip(starts, self.parameters, strict=True)
        parameters = tuple(p.starting_at(scene) for scene, p in pairs)
        return eqx.tree_at(lambda p: p.parameters, self, parameters)

    def coarser(self) -> "list[Problem]":
        """Returns the same problem of fewer, wider pixels, from the widest on.

        Only where edges move: edges have a derivative for as long as they stay within their
        pixels, so that a step can go the further, the wider pixels are. Coarser problems that
        leave out most of what counts, as of boxes with gaps in them, are no use.
        """
        if any(s.box is None for s in self.settings):
            return []
        problems, side = [], _COARSENING
        while side * _LEAST_BOXES <= min(min(s.width, s.height) for s in self.settings):
            coarse = _box_means(self, side)
            if coarse.counted * side**2 < self.counted / 2:
                break
            problems.append(coarse)
            side *= _COARSENING
        return problems[::-1]

    @property
    def edges_move(self) -> bool:
        """Tells whether the lights move edges of shadows over pixels, which are covered by area."""
        free = bool(set(LIGHT_PLACES) & set(self.parameters[0].free))
        fixed = any(buffer is not None for buffer in self.buffers)
        return free and fixed and any(s.antialias for s in self.settings)

    def traced_at(self, values: PyTree) -> "Problem":
        """Returns the problem with the shading samples of the scenes at `values`, from the host.

        Where lights are free, so are the edges of their shadows: samples say which pixels have any.
        """
        pairs = zip(self.scenes_at(values), self.settings, strict=True)
        free = self.parameters[0].free
        buffers = tuple(make_gbuffer(scene, settings, free) for (scene, _), settings in pairs)
        return eqx.tree_at(lambda p: p.buffers, self, buffers)

    def without_stale_samples(self) -> "Problem":
        """Returns the problem without shading samples that may be those of another scene.

        Samples are known to be the scene's where nothing that is not free was replaced or is traced
        by JAX, and no edge moves. Without them pixels are traced at every step.
        """

        def fresh(parameters: Parameters, buffer: GBuffer | None) -> GBuffer | None:
            fixed = fixed_arrays(parameters.scene, parameters.free)
            if buffer is None or self.edges_move or is_traced((fixed, buffer.fixed)):
                return None
            # by NumPy: under jit JAX's comparisons are traced, of known numbers too
            same = len(fixed) == len(buffer.fixed) and all(map(np.array_equal, fixed, buffer.fixed))
            return buffer if same else None

        buffers = tuple(map(fresh, self.parameters, self.buffers))
        none = lambda x: x is None
        return eqx.tree_at(lambda p: p.buffers, self, buffers, is_leaf=none)

    @property
    def dtype(self) -> np.dtype:
        """Returns the floating dtype of the unknowns."""
        return self.parameters[0].scene.dtype

    @property
    def counted(self) -> int:
        """Returns how many of the targets' numbers count."""
        return sum(t.counted for t in self.targets)

    @property
    def norm(self) -> float:
        """Returns the Euclidean norm of the targets' weighted numbers."""
        return float(np.linalg.norm([t.norm for t in self.targets]))

    @property
    def noise(self) -> list[float]:
        """Returns each target's noise, as robust losses take it."""
        return [float(t.noise) for t in self.targets]

    def pictures(self, values: PyTree) -> list[tuple[Picture, Float[Array, " 3"]]]:
        """Returns each scene's picture and its exposure, differentiable in everything."""
        pairs = zip(self.scenes_at(values), self.settings, strict=True)
        return [(draw_replicated(scene, s), exposure) for (scene, exposure), s in pairs]

    def with_estimated_noise(self, values: PyTree) -> "Problem":
        """Returns the problem with each target's noise estimated from the residuals at `values`."""
        return self._with_targets(Target.with_estimated_noise, values)

    def with_squares(self) -> "Problem":
        """Returns the problem in which robust losses are squares, by a noise beyond all numbers.

        The program of its steps is that of the problem itself.
        """
        noise = [jnp.full_like(t.noise, _BEYOND * (t.norm or 1.0)) for t in self.targets]
        return eqx.tree_at(lambda p: [t.noise for t in p.targets], self, noise)

    def trimmed(self, values: PyTree) -> "Problem":
        """Returns the problem without the numbers that fit worst at `values`."""
        return self._with_targets(Target.trimmed, values)

    def _with_targets(self, change: Callable[..., Target], values: PyTree) -> "Problem":
        pairs = zip(self.targets, pictures_at(self, values), strict=True)
        targets = tuple(change(target, *picture) for target, picture in pairs)
        return eqx.tree_at(lambda p: p.targets, self, targets)

    def index(self, k: int) -> ParameterIndex:
        """Returns where picture k's free parameters are in its normal equations."""
        return ParameterIndex(self.parameters[k].scene, self.parameters[k].free)

    def normal(self, values: PyTree) -> NormalEquations:
        """Returns the normal equations by the unknowns, in the order of `ravel_pytree`."""
        sums, pictures = [], []
        for k, (scene, exposure) in enumerate(self.scenes_at(values)):
            by_parameters = normal_equations(
                scene, exposure, self.targets[k], self.index(k), self.settings[k], self.buffers[k]
            )
            jacobian = self.parameter_jacobian(values, k).astype(by_parameters.cost.dtype)
            pictures += by_parameters.pictures
            by_unknowns = NormalEquations(
                jacobian.T @ by_parameters.square @ jacobian,
                jacobian.T @ by_parameters.gradient,
                by_parameters.cost,
            )
            sums.append(by_unknowns)
        sums += [self._prior_normal(values, k, sums[0].cost.dtype) for k in self._constrained]
        total = jax.tree.map(lambda *x: sum(x[1:], x[0]), *sums)
        return eqx.tree_at(lambda n: n.pictures, total, tuple(pictures))

    def _prior_normal(self, values: PyTree, k: int, dtype: np.dtype) -> NormalEquations:
        """Returns the part of picture k's priors: one more row for each number."""
        y, unravel = ravel_pytree(values)
        residual = lambda y: self._prior_residual(unravel(y), k)
        r, jacobian = (x.astype(dtype) for x in (residual(y), jax.jacfwd(residual)(y)))
        return NormalEquations(jacobian.T @ jacobian, jacobian.T @ r, r @ r / 2)

    def parameter_jacobian(self, values: PyTree, k: int) -> Float[Array, "natural free"]:
        """Returns the derivatives of picture k's free parameters by the unknowns.

        Rows are in the order of the picture's `ParameterIndex`.
        """
        y, unravel = ravel_pytree(values)

        def natural(y: Float[Array, " free"]) -> Float[Array, " natural"]:
            arrays = self.parameters[k].natural(self.picture_unknowns(unravel(y), k))
            return jnp.concatenate([arrays[n].reshape(-1) for n in self.parameters[k].free])

        return jax.jacfwd(natural)(y)


@compiled
def _box_means(problem: Problem, side: int) -> Problem:
    """Returns the problem of the means of boxes of pixels."""
    leaves = lambda p: [*p.targets, *(s.box for s in p.settings)]
    targets = [t.box_means(side) for t in problem.targets]
    boxes = [jnp.asarray(side, problem.dtype) for _ in problem.settings]
    return eqx.tree_at(leaves, problem, [*targets, *boxes])


def normal_at(problem: Problem, values: PyTree) -> NormalEquations:
    """Returns `Problem.normal`, compiled, its sums in double precision; for callers on the host.

    Rows of J are computed in the scene's dtype. Of their products in float32 the squares of what
    shows little would be lost among the rounding errors of what shows much.
    """
    with jax.enable_x64(True):
        return _normal_at(problem, values)


def pictures_at(problem: Problem, values: PyTree) -> list[tuple[Picture, Float[Array, " 3"]]]:
    """Returns `Problem.pictures` where targets count, by the program of the fit's steps."""
    exposures = [exposure for _, exposure in problem.scenes_at(values)]
    return list(zip(normal_at(problem, values).pictures, exposures, strict=True))


@compiled
def _normal_at(problem: Problem, values: PyTree) -> NormalEquations:
    return problem.normal(values)
