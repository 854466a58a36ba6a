"""Constraints: which numbers of free parameters are held, tied, bounded, or known beforehand.

Held and tied numbers are one linear map from a solver's unknowns to all numbers of a parameter: a
gather by `Constraint.unknown`. Normal equations of all numbers are restricted by the map's
derivative (`Problem.parameter_jacobian`): columns of tied numbers add up, those of held ones go.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from ...base.errors import InputError
from ...scene.parameters import FITTED, LIGHT_PLACES, LIMITS, rows_of, with_optional
from ...scene.scene import Scene

Free = str | Sequence[str] | Mapping[str, Any]
"""Names of free parameters, one name, or which objects' numbers are free by name."""

#: What the rows of parameters are, by their owner.
OBJECTS = {"spheres": "sphere", "lights": "light", "camera": "coordinate", "scene": "channel"}


class Constraint(eqx.Module):
    """What restricts the numbers of one parameter."""

    #: the unknown that each number is; -1 where it is held. Directions of lights have two numbers
    #: here, those that turn them
    unknown: Int[Array, "*shape"]
    first: Int[Array, " unknowns"]  #: the place of the first number that each unknown is
    lower: Float[Array, "*shape"]  #: in the scene's units; -inf where there is none
    upper: Float[Array, "*shape"]
    mean: Float[Array, "*natural"]  #: of the Gaussian prior, in the parameter's shape
    weight: Float[Array, "*natural"]  #: 1 / the prior's standard deviation, 0 where there is none

    def full(self, y: Shaped[Array, " unknowns"]) -> Shaped[Array, "*shape"]:
        """Returns the unknown of each number; of held ones any."""
        return y[jnp.maximum(self.unknown, 0)]

    def reduced(self, x: Shaped[Array, "*shape"]) -> Shaped[Array, " unknowns"]:
        """Returns the first number of each unknown."""
        return x.reshape(-1)[self.first]

    def shared(self, x: Shaped[Array, "..."]) -> Shaped[Array, "*shape"]:
        """Returns, for each number, the first number of its unknown."""
        return self.full(self.reduced(jnp.broadcast_to(x, self.unknown.shape)))

    def averaged(self, x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Returns, for each number, the mean of its unknown's numbers; of held ones any."""
        zero = jnp.zeros(self.first.size, x.dtype)
        at = self._places
        sums, counts = (zero.at[at].add(y, mode="drop") for y in (x, jnp.ones_like(x)))
        return self.full(sums / counts)

    def bounds(self) -> tuple[Float[Array, " unknowns"], Float[Array, " unknowns"]]:
        """Returns the bounds of each unknown, those of all its numbers, in the scene's units."""
        at, unbounded = self._places, jnp.full(self.first.size, jnp.inf, self.lower.dtype)
        lower = (-unbounded).at[at].max(self.lower, mode="drop")
        return lower, unbounded.at[at].min(self.upper, mode="drop")

    @property
    def _places(self) -> Int[Array, "*shape"]:
        """Returns the unknown of each number, to scatter to; out of range where it is held."""
        return jnp.where(self.unknown < 0, self.first.size, self.unknown)

    @property
    def free(self) -> np.ndarray:
        """Returns which numbers are free, on the host."""
        return np.asarray(self.unknown >= 0)

    @property
    def has_prior(self) -> bool:
        """Returns whether any number has a prior."""
        return bool(np.asarray(self.weight).any())

    @property
    def tied(self) -> bool:
        """Returns whether several numbers are one unknown."""
        return bool(np.count_nonzero(self.free) > self.first.size)


def free_names(free: Free) -> tuple[str, ...]:
    """Returns the names of free parameters: those of a mapping that are not False."""
    if not isinstance(free, Mapping):
        return tuple([free] if isinstance(free, str) else free)
    return tuple(name for name, chosen in free.items() if not _is(chosen, False))


def make_constraints(
    scene: Scene,
    free: Free,
    tie: Mapping[str, Any],
    bounds: Mapping[str, Any],
    priors: Mapping[str, Any],
) -> dict[str, Constraint]:
    """Returns the constraints of free parameters, by name; none of those that have none.

    **Arguments:** as for `fit`.

    **Raises:** `InputError` for names that are not free, objects that the scene does not have, and
    starts that no constraint allows.
    """
    names = free_names(free)
    for option, given in (("tie", tie), ("bounds", bounds), ("priors", priors)):
        if not isinstance(given, Mapping):
            raise InputError(f"{option} must map names of free parameters, got {given!r}")
        unknown = sorted(set(given) - set(names))
        if unknown:
            raise InputError(f"{option} must name free parameters, got {', '.join(unknown)}")
        if "light_direction" in given and option != "tie":
            raise InputError(f"{option} of light_direction are not to be had: two angles are free")
    found = {}
    for name in names:
        chosen = free[name] if isinstance(free, Mapping) else True
        rows = rows_of(scene, name) if name in LIGHT_PLACES else np.array(True)
        if not (_is(chosen, True) and rows.all()) or any(name in x for x in (tie, bounds, priors)):
            start = start_of(scene, name)
            unknown, first = _unknowns(name, start, chosen, tie.get(name), rows)
            limits = _bounds(name, start, unknown, bounds.get(name), scene.dtype)
            prior = _prior(name, start, priors.get(name))
            if prior[1].any():
                for x in prior:
                    if ((x.reshape(-1)[first][unknown] != x) & (unknown >= 0)).any():
                        raise InputError(f"priors of {name} must be the same where {name} is tied")
                # one statement on an unknown, whatever the number of objects that share it
                once = np.isin(np.arange(start.size), first).reshape(start.shape)
                prior = prior[0], np.where(once, prior[1], 0)
            numbers = (*limits, *prior)
            places = jnp.asarray(unknown, jnp.int32), jnp.asarray(first, jnp.int32)
            found[name] = Constraint(*places, *(jnp.asarray(x, scene.dtype) for x in numbers))
    return found


def start_of(scene: Scene, name: str) -> np.ndarray:
    """Returns the numbers of a parameter at the start; of the exposure 1 per channel."""
    if name == "exposure":
        return np.ones(3)
    return np.asarray(FITTED[name].value(with_optional(scene, (name,))), np.float64)


def objects_of(name: str) -> str:
    """Returns a word for one of the objects that a parameter has rows for."""
    return "channel" if name == "exposure" else OBJECTS.get(FITTED[name].owner, "")


def _is(chosen: Any, value: bool) -> bool:
    return isinstance(chosen, bool | np.bool_) and bool(chosen) == value


def _unknowns(
    name: str, start: np.ndarray, chosen: Any, tie: Any, rows: Bool[np.ndarray, "..."]
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the unknown that each number is, -1 where held, and each unknown's first place.

    **Arguments:** `rows`: which lights the name is of, True for any others.
    """
    mask = _mask(name, start.shape, chosen)
    if rows.ndim:
        mask = _mask_of_lights(name, mask, rows, everything=_is(chosen, True))
        tie = [np.flatnonzero(rows).tolist()] if _is(tie, True) else tie
    number = np.arange(mask.size).reshape(mask.shape)
    for group in [] if tie is None else _groups(name, start.shape, tie):
        words = f"{name} of {objects_of(name)}s {', '.join(str(i + 1) for i in group)}"
        if (mask[group] != mask[group[0]]).any():
            raise InputError(f"{words} is tied, so all of it must be free, or none of it")
        if (start[group] != start[group[0]]).any():
            raise InputError(
                f"{words} is tied and must start alike, got {_different(start[group])}"
            )
        number[group] = number[group[0]]
    first = np.unique(number[mask])
    return np.where(mask, np.searchsorted(first, number), -1), first


def _different(rows: np.ndarray) -> str:
    """Returns rows of numbers in words, with as many digits as tell them apart."""
    words = []
    for digits in (6, 17):
        texts = [" ".join(f"{x:.{digits}g}" for x in np.atleast_1d(row)) for row in rows]
        words = list(dict.fromkeys(texts))
        if len(words) > 1:
            break
    return ", ".join(words)


def _mask(name: str, shape: tuple[int, ...], chosen: Any) -> np.ndarray:
    """Returns which numbers of a parameter are free."""
    if _is(chosen, True):
        return np.full(shape, True)
    if not shape:
        raise InputError(f"free[{name!r}] must be True or False: it is one number, got {chosen!r}")
    array = np.asarray(chosen) if np.size(chosen) else np.zeros(0, int)
    if array.dtype != bool:
        mask = np.full(shape, False)
        mask[_indices(f"free[{name!r}]", name, shape[0], array)] = True
        return mask
    if array.shape not in (shape, shape[:1]):
        shapes = " or ".join(str(s) for s in dict.fromkeys((shape[:1], shape)))
        raise InputError(f"free[{name!r}] must be a mask of shape {shapes}, got {array.shape}")
    mask = np.broadcast_to(array.reshape(array.shape + (1,) * (len(shape) - array.ndim)), shape)
    if not mask.any():
        raise InputError(f"free[{name!r}] names no {objects_of(name)}")
    return mask.copy()


def _mask_of_lights(
    name: str, mask: np.ndarray, rows: np.ndarray, everything: bool
) -> Bool[np.ndarray, "lights numbers"]:
    """Returns which numbers of the lights' places are free: of directions two, that turn them.

    **Arguments:** `rows`: which lights the name is of. `everything`: whether it is all of these.
    """
    some = mask.any(axis=1)
    word = name.removeprefix("light_")
    if (some != mask.all(axis=1)).any():
        raise InputError(f"a light's {word} is free or held as a whole, got a mask of coordinates")
    if not everything and (some & ~rows).any():
        light = int(np.flatnonzero(some & ~rows)[0]) + 1
        kind = "is directional" if name == "light_position" else "is not directional"
        raise InputError(f"free[{name!r}] names light {light}, which {kind}")
    mask = mask & rows[:, None]
    return mask[:, :2] if name == "light_direction" else mask


def _indices(what: str, name: str, count: int, array: np.ndarray) -> np.ndarray:
    """Checks indices of objects."""
    kind = objects_of(name)
    if not array.size:
        raise InputError(f"{what} names no {kind}")
    if array.dtype.kind not in "iu" or array.ndim != 1:
        raise InputError(f"{what} must hold indices of {kind}s, got {array.tolist()!r}")
    wrong = array[(array < 0) | (array >= count)]
    if wrong.size:
        raise InputError(
            f"{what} must hold indices of {kind}s from 0 to {count - 1}, got {wrong[0]}"
        )
    if len(np.unique(array)) < len(array):
        raise InputError(f"{what} must name each {kind} once, got {array.tolist()}")
    return array


def _groups(name: str, shape: tuple[int, ...], tie: Any) -> list[np.ndarray]:
    """Returns the groups of objects that share a parameter."""
    what = f"tie[{name!r}]"
    if not shape:
        raise InputError(f"{what}: {name} is one number")
    if objects_of(name) == OBJECTS["camera"]:
        raise InputError(f"{what}: the camera has one {name}")
    if _is(tie, True):
        tie = [list(range(shape[0]))]
    if not isinstance(tie, list | tuple | np.ndarray):
        raise InputError(f"{what} must be True or lists of indices, got {tie!r}")
    nested = len(tie) and all(isinstance(group, list | tuple | np.ndarray) for group in tie)
    groups = list(tie) if nested else [tie]
    indices = [_indices(what, name, shape[0], np.asarray(group)) for group in groups]
    together = np.concatenate(indices)
    if len(np.unique(together)) < len(together):
        raise InputError(f"{what} must name each {objects_of(name)} once, got {tie!r}")
    return [np.sort(group) for group in indices if len(group) > 1]


def _pair(option: str, name: str, shape: tuple[int, ...], pair: Any) -> list[np.ndarray]:
    """Returns two numbers, or arrays of them, in a parameter's shape."""
    words = "(lower, upper)" if option == "bounds" else "(mean, sigma)"
    try:
        one, other = pair
        arrays = [np.asarray(x, np.float64) for x in (one, other)]
    except (TypeError, ValueError):
        raise InputError(f"{option}[{name!r}] must be a pair {words}, got {pair!r}") from None
    found = []
    for array in arrays:
        if shape and array.shape == shape[:1]:
            array = array.reshape(array.shape + (1,) * (len(shape) - 1))
        elif array.shape not in ((), shape):
            raise InputError(
                f"{option}[{name!r}] must hold one number or have the shape {shape}, got shape "
                f"{array.shape}"
            )
        if np.isnan(array).any():
            raise InputError(f"{option}[{name!r}] must hold numbers, got nan")
        found.append(np.broadcast_to(array, shape))
    return found


def _bounds(
    name: str, start: np.ndarray, unknown: np.ndarray, pair: Any, dtype: np.dtype
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the least and the greatest that numbers may be."""
    lower, upper = (np.full(unknown.shape, x) for x in (-np.inf, np.inf))
    if pair is None:
        return lower, upper
    if name == "light_position":
        raise InputError("bounds of light_position are not to be had: a light may be at infinity")
    lower, upper = _pair("bounds", name, start.shape, pair)
    above = lower > upper
    if above.any():
        raise InputError(
            f"bounds of {name}: the lower, {lower[above][0]:g}, is above the upper, "
            f"{upper[above][0]:g}"
        )
    least, most = LIMITS["positive" if name == "exposure" else FITTED[name].range]
    if (np.isfinite(lower) & (lower < least)).any() or (upper < least).any():
        raise InputError(f"bounds of {name} must be at least {least:g}")
    if (np.isfinite(upper) & (upper > most)).any() or (lower > most).any():
        raise InputError(f"bounds of {name} must be at most {most:g}")
    lower, upper = (x.astype(dtype).astype(np.float64) for x in (lower, upper))
    outside = (unknown >= 0) & ~((lower <= start) & (start <= upper))
    if outside.any():
        at = tuple(np.argwhere(outside)[0])
        of = f" of {objects_of(name)} {at[0] + 1}" if at else ""
        raise InputError(
            f"{name}{of} starts at {start[at]:g}, outside of its bounds {lower[at]:g} to "
            f"{upper[at]:g}"
        )
    return lower, upper


def _prior(name: str, start: np.ndarray, pair: Any) -> tuple[np.ndarray, np.ndarray]:
    """Returns the mean of a Gaussian prior, and 1 / its standard deviation."""
    if pair is None:
        return start, np.zeros(start.shape)
    mean, sigma = _pair("priors", name, start.shape, pair)
    if not (sigma > 0).all():
        raise InputError(f"priors of {name}: sigma must be greater than 0, got {sigma.min():g}")
    if not np.isfinite(mean).all():
        raise InputError(f"priors of {name}: the mean must be finite")
    return mean, 1 / sigma
