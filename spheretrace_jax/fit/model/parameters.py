"""The free parameters of a fit: how each is scaled to unknowns of order one, and bounded.

A solver works on dimensionless unknowns of order one, a dict `name -> array`. Bounds are respected
twice. `bounds` tells solvers that know boxes. For all others numbers outside 0..1 are folded back
like a sheet of paper, so that any number stands for a valid scene. Folding is the identity inside
the bounds and has slope +-1 everywhere. So Levenberg-Marquardt converges quadratically even where
the truth lies on a bound (colour 0, ks 0), in 7 steps on the nine spheres. Sigmoid and sine, whose
slope vanishes at a bound, had not arrived after 60.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...base.errors import InputError
from ...scene.parameters import (
    FITTED,
    LIGHT_PLACES,
    MOST_REFRACTION,
    light_places,
    rows_of,
)
from ...scene.scene import Scene
from ...scene.values import with_values
from ...xla.jit import compiled
from .accessors import NAMES, Values, value
from .constraints import Constraint
from .light_position import LightPosition, light_direction_at, light_position_at, no_bound

# Parameters are scaled by their range: folded into 0..1, fitted by their logarithm, or by their
# absolute value. An exponent may be 0 but is fitted by its logarithm too. Indices of refraction are
# 1 and a part of the rest of their range.
_REFRACTION = frozenset(name for name, p in FITTED.items() if p.range == "refraction")
_UNIT = frozenset(name for name, p in FITTED.items() if p.range == "unit") | _REFRACTION
_ABOVE_0 = frozenset(name for name, p in FITTED.items() if p.range == "positive")
_LOGARITHMIC = _ABOVE_0 | {"exponent", "exposure"}
_ABSOLUTE = frozenset(n for n, p in FITTED.items() if p.range == "nonnegative") - _LOGARITHMIC

# The least exponent at the start, as 0 has no logarithm. A highlight of exponent 0.01 is constant
# to 1 % wherever its cosine is above 0.37, so the start hardly changes; a smaller one would have a
# derivative by its logarithm that is as much smaller.
_LEAST_EXPONENT = 1e-2

# The index of refraction at which one of 1 starts, where no derivative would show it: that of most
# paints and plastics.
_COAT = 1.5


def check_free(free: tuple[str, ...]) -> None:
    """Checks the names of free parameters.

    **Raises:** `InputError` for names that cannot be free, or none at all.
    """
    unknown = [name for name in free if name not in NAMES]
    if unknown or not free:
        got = ", ".join(unknown) or "none"
        raise InputError(f"free parameters must be among {', '.join(NAMES)}, got {got}")
    if len(set(free)) < len(free):
        raise InputError(f"each free parameter must be named once, got {', '.join(free)}")


def check_present(scene: Scene, free: tuple[str, ...]) -> None:
    """Checks that a scene has what is free.

    **Raises:** `InputError` for free parameters of objects that the scene does not have, and for
    lengths that start at 0.
    """
    for name in free:
        if name == "exposure":
            continue
        if value(scene, name).size == 0:
            raise InputError(f"{name} is free, but the scene has no {FITTED[name].owner}")
        if name in LIGHT_PLACES and not rows_of(scene, name).any():
            has = "no light is" if name == "light_direction" else "all lights are"
            raise InputError(f"{name} is free, but {has} directional: {light_places(scene)[0]}?")
        if name in _ABOVE_0 and not (value(scene, name) > 0).all():
            raise InputError(f"{name} is free: it must start above 0")


class Parameters(eqx.Module):
    """The scaling from a solver's unknowns to a scene, and its inverse at the start.

    Its methods are compiled: called from the host they would be dozens of small programs.
    """

    scene: Scene  #: the start; what is not free stays as it is here
    light_positions: LightPosition | None  #: one for each light, if their positions are free
    light_directions: LightPosition | None  #: one for each light, if their directions are free
    constraints: dict[str, Constraint]  #: of names that have some; their unknowns are flat
    free: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        scene: Scene,
        free: tuple[str, ...],
        constraints: dict[str, Constraint] | None = None,
    ):
        self.scene, self.free, self.constraints = scene, free, constraints or {}
        self.light_positions = self.light_directions = None
        if "light_position" in free:
            self.light_positions = _light_positions(scene)
        if "light_direction" in free:
            self.light_directions = _light_directions(scene)

    @compiled
    def start(self) -> Values:
        """Returns the unknowns at the start, brought within the bounds."""
        return {name: self._start(name) for name in self.free}

    def _start(self, name: str) -> Array:
        start = self._whole_start(name)
        if name not in self.constraints:
            return start
        start = self.constraints[name].reduced(start)
        return jnp.clip(start, *self._bounds(name, start))

    def _whole_start(self, name: str) -> Array:
        """Returns the unknowns at the start as if all numbers were free."""
        if name == "exposure":
            return jnp.zeros(3, self.scene.dtype)
        if name == "light_position":
            return jnp.zeros_like(self.scene.lights.position)
        if name == "light_direction":
            return jnp.zeros_like(self.scene.lights.position[:, :2])
        start = value(self.scene, name)
        if name == "exponent":
            start = jnp.maximum(start, _LEAST_EXPONENT)
        if name in _REFRACTION:
            start = jnp.where(start > 1, start, _COAT)
        start = (start - _origin(name)) / self._unit(name)
        if name in _LOGARITHMIC:
            return jnp.log(start)
        if name in _UNIT:
            return jnp.clip(start, 0, 1)
        return jnp.maximum(start, 0) if name in _ABSOLUTE else start

    def _unit(self, name: str) -> Array | float | int:
        """Returns the unit in which a parameter is a number of order one.

        A fit is so blind to the user's units.
        """
        if name in _REFRACTION:
            return MOST_REFRACTION - 1
        if name in _ABOVE_0:
            return value(self.scene, name)
        if name == "center":
            radius = self.scene.spheres.radius
            return jnp.where(radius > 0, radius, 1)[:, None]
        return bounding_sphere(self.scene)[1] if name == "look_at" else 1

    @compiled
    def natural(self, unknowns: Values) -> Values:
        """Returns the parameters in the scene's units that unknowns stand for."""
        return {name: self._natural(name, y) for name, y in unknowns.items()}

    def _natural(self, name: str, y: Array) -> Array:
        constraint = self.constraints.get(name)
        if constraint is None:
            return self._scaled(name, y, self._unit(name))
        y = constraint.full(_between(y, *self._bounds(name, y)))
        natural = self._scaled(name, y, constraint.shared(jnp.asarray(self._unit(name), y.dtype)))
        held = jnp.ones_like(y) if name == "exposure" else value(self.scene, name)
        return jnp.where(_held(name, constraint), held, natural)

    def _scaled(self, name: str, y: Array, unit: Array | float | int) -> Array:
        """Returns numbers in the scene's units."""
        if name == "light_position" and self.light_positions is not None:
            return jax.vmap(LightPosition.position)(self.light_positions, y)
        if name == "light_direction" and self.light_directions is not None:
            return jax.vmap(LightPosition.direction)(self.light_directions, y)
        if name in _UNIT:
            return _origin(name) + _fold(y) * unit
        if name in _ABSOLUTE:
            return jnp.abs(y)
        return (jnp.exp(y) if name in _LOGARITHMIC else y) * unit

    @compiled
    def scene_at(self, unknowns: Values) -> tuple[Scene, Float[Array, " 3"]]:
        """Returns the scene that unknowns stand for, and the exposure."""
        natural = self.natural(unknowns)
        exposure = natural.pop("exposure", jnp.ones(3, self.scene.dtype))
        return with_values(self.scene, natural), exposure

    @compiled
    def bounds(self) -> tuple[Values, Values]:
        """Returns the least and the greatest that the unknowns may be."""
        bounds = {name: self._bounds(name, y) for name, y in self.start().items()}
        lower, upper = ({name: pair[i] for name, pair in bounds.items()} for i in (0, 1))
        return lower, upper

    def _bounds(self, name: str, y: Array) -> tuple[Array, Array]:
        """Returns the bounds of a parameter's unknowns."""
        constraint = self.constraints.get(name)
        lower = jnp.full_like(y, 0.0 if name in _UNIT | _ABSOLUTE else -no_bound(y))
        upper = jnp.full_like(y, 1.0 if name in _UNIT else no_bound(y))
        if name == "light_position" and self.light_positions is not None:
            lower = jax.vmap(LightPosition.lower_bound)(self.light_positions)
            return (lower if constraint is None else constraint.reduced(lower)), upper
        if constraint is None:
            return lower, upper
        unit = constraint.reduced(jnp.broadcast_to(self._unit(name), constraint.unknown.shape))
        given = [(x - _origin(name)) / unit.astype(y.dtype) for x in constraint.bounds()]
        if name in _LOGARITHMIC:
            given = [jnp.log(jnp.maximum(x, 0)) for x in given]
        return jnp.maximum(lower, given[0]), jnp.minimum(upper, given[1])

    def prior_residual(self, natural: Values) -> Float[Array, " natural"]:
        """Returns how far numbers are from the means of their priors, in standard deviations.

        Of all free parameters, name by name; 0 where a number has no prior.
        """
        parts = []
        for name in self.free:
            x, constraint = natural[name], self.constraints.get(name)
            off = jnp.zeros_like(x)
            if constraint is not None:
                off = constraint.weight * (x - constraint.mean)
            parts.append(off.reshape(-1))
        return jnp.concatenate(parts)

    def without_priors(self) -> "Parameters":
        """Returns the same without priors."""
        weights = lambda p: [c.weight for c in p.constraints.values()]
        return eqx.tree_at(weights, self, replace_fn=jnp.zeros_like)

    @property
    def priors(self) -> list[str]:
        """Returns the names of parameters that have priors."""
        return [name for name, c in self.constraints.items() if c.has_prior]

    def starting_at(self, scene: Scene) -> "Parameters":
        """Returns the same with another start, whose held numbers stay and whose tied ones agree.

        Tied numbers start at their mean.
        """
        for name, constraint in self.constraints.items():
            if name == "exposure":
                continue
            new, old = value(scene, name), value(self.scene, name)
            if name == "light_direction":  # tied ones are the first one's
                tied = new[constraint.first[jnp.maximum(constraint.unknown[:, 0], 0)] // 2]
            else:
                tied = constraint.averaged(new)
            scene = with_values(scene, {name: jnp.where(_held(name, constraint), old, tied)})
        return Parameters(scene, self.free, self.constraints)

    def free_numbers(self, name: str) -> Bool[np.ndarray, "*shape"]:
        """Returns which numbers of a parameter are free, on the host."""
        constraint = self.constraints.get(name)
        if constraint is not None:
            return constraint.free
        shape = (3,) if name == "exposure" else value(self.scene, name).shape
        return np.full(shape, name in self.free)


def _origin(name: str) -> int:
    """Returns the number of a parameter's unit range that is 0 to the solver."""
    return 1 if name in _REFRACTION else 0


def _held(name: str, constraint: Constraint) -> Bool[Array, "*#shape"]:
    """Returns which numbers of a parameter are held; of lights' places the whole rows."""
    held = constraint.unknown < 0
    return jnp.all(held, axis=1, keepdims=True) if name in LIGHT_PLACES else held


@compiled
def _light_directions(scene: Scene) -> LightPosition:
    return jax.vmap(light_direction_at)(scene.lights.position)


@compiled
def _light_positions(scene: Scene) -> LightPosition:
    middle, size = bounding_sphere(scene)
    return jax.vmap(light_position_at, (0, None, None))(scene.lights.position, middle, size)


@compiled
def bounding_sphere(scene: Scene) -> tuple[Float[Array, " 3"], Float[Array, ""]]:
    """Returns the middle of a scene's spheres, and the radius of all around the middle."""
    spheres = scene.spheres
    if not len(spheres):
        return jnp.zeros(3, scene.dtype), jnp.where(scene.camera.mu > 0, scene.camera.mu, 1)
    middle = jnp.mean(spheres.center, axis=0)
    distances = jnp.linalg.norm(spheres.center - middle[None], axis=1) + spheres.radius
    size = jnp.max(distances)
    return middle, jnp.where(size > 0, size, 1)


def _between(y: Array, lower: Array, upper: Array) -> Array:
    """Returns y between bounds, with a slope of 1 at both, too; mirrored at them beyond."""
    below, above = lower > -no_bound(y), upper < no_bound(y)
    both, least, most = below & above, jnp.where(below, lower, 0), jnp.where(above, upper, 0)
    width = jnp.where(both & (most > least), most - least, 1)
    folded = least + width * _fold((y - least) / width)
    folded = jnp.where(both, folded, jnp.where(below, least + jnp.abs(y - least), y))
    folded = jnp.where(~below & above, most - jnp.abs(most - y), folded)
    return jnp.where((lower <= y) & (y <= upper), y, folded)


def _fold(y: Array) -> Array:
    """Returns y for y in 0..1, with a slope of 1 at 0 and 1, too; mirrored at 0 and 1 beyond."""
    y = jnp.abs(y)
    turn = jax.lax.stop_gradient(jnp.maximum(jnp.ceil(y) - 1, 0))
    return jnp.where(turn % 2 == 0, y - turn, 1 - (y - turn))
