"""Making a `Problem` of what a user asks for: checks, settings, and one target for each scene."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax.sharding import NamedSharding

from ...base.errors import InputError
from ...base.types import Highlight
from ...scene.arrays import is_traced
from ...scene.needs import needs
from ...scene.parameters import LIGHT_PLACES, with_optional
from ...scene.scene import Scene, check_scene
from ...scene.settings import render_settings
from ...xla.sharding import gather_on_host, replicate
from ..model.accessors import CAMERA, GEOMETRY, LIGHTS, default_free, value
from ..model.constraints import Constraint, Free, free_names, make_constraints
from ..model.parameters import Parameters, check_free, check_present
from ..model.target import make_target
from ..normal_equations.gbuffer import make_gbuffer
from .memory import warn_of_memory
from .problem import Problem

# What a picture may have apart from other pictures of the same spheres.
_MAY_DIFFER = frozenset((*LIGHTS, *CAMERA, "exposure"))


def make_problem(
    scene: Scene | Sequence[Scene],
    target: Any,
    free: Free | None,
    *,
    bounces: int,
    samples: int = 1,
    highlight: Highlight = "phong",
    per_picture: tuple[str, ...] = (),
    sharding: NamedSharding | None = None,
    tie: Mapping[str, Any] | None = None,
    limits: Mapping[str, Any] | None = None,
    priors: Mapping[str, Any] | None = None,
    **counts: Any,
) -> Problem:
    """Checks what a user asks for and makes the problem of it.

    **Arguments:** as for `fit`; `per_picture`: its `own`, to which the exposure is added where
    there are several pictures. `limits`: its `bounds`. `counts`: as for `make_target`.

    **Raises:** `InputError` for unusable scenes, targets and names.
    """
    # inside jit new arrays are traced, even where all arguments are concrete
    if is_traced((scene, target, counts, jnp.zeros(()))):
        raise InputError(
            "fit goes step by step from the host, so jit, vmap and grad cannot trace it: call it "
            "outside, and inside solution(found.problem), the same fit as a pure function"
        )
    if free is not None:
        check_free(free_names(free))
    several = isinstance(scene, Iterable)
    scenes = [check_scene(one) for one in (scene if several else [scene])]
    asked_free = default_free(scenes[0]) if free is None and scenes else free or ()
    free = free_names(asked_free)
    target, counts = gather_on_host((target, counts))
    images = list(target) if several or isinstance(target, list | tuple) else [target]
    if len(scenes) != len(images) or not scenes:
        raise InputError(
            f"there must be one target for each scene, got {len(scenes)} scenes and "
            f"{len(images)} targets"
        )
    scenes = [with_optional(one, free) for one in scenes]
    for one in scenes:
        check_present(one, free)
    if priors and counts.get("noise") is None:
        raise InputError("priors need noise, against which their sigma counts: say noise too")
    names = frozenset(per_picture) | ({"exposure"} & set(free) if several else set())
    _check_shared(scenes, free, names)
    of_pictures = {
        name: _for_each(name, x, len(scenes)) if several else [x] for name, x in counts.items()
    }
    targets, settings, fixed = [], [], not GEOMETRY & set(free)
    for k, (one, image) in enumerate(zip(scenes, images, strict=True)):
        made = make_target(image, one.dtype, **{name: x[k] for name, x in of_pictures.items()})
        height, width, _ = made.image.shape
        needed = needs(one, free=[name for name in free if name != "exposure"])
        chosen = render_settings(
            one, width, height, highlight=highlight, bounces=bounces, samples=samples,
            needs=needed, sharding=sharding,
        )  # fmt: skip
        if chosen.antialias and not fixed:
            chosen = dataclasses.replace(chosen, box=jnp.ones((), one.dtype))
        settings.append(chosen)
        targets.append(made)
    warn_of_memory(settings, scenes[0].dtype.itemsize, counts.get("shrink", 1))
    scenes, targets = replicate((scenes, targets), settings[0].sharding)
    restricted = _constraints(scenes, asked_free, (tie or {}, limits or {}, priors or {}), names)
    restricted = replicate(restricted, settings[0].sharding)
    pairs = zip(scenes, restricted, strict=True)
    parameters = tuple(Parameters(one, free, constraints) for one, constraints in pairs)
    # of all pixels: the target of a problem may be replaced by one of which others count
    buffer = lambda scene, settings: make_gbuffer(scene, settings, free) if fixed else None
    buffers = tuple(map(buffer, scenes, settings))
    return Problem(parameters, tuple(targets), tuple(settings), buffers, names)


def _constraints(
    scenes: list[Scene], free: Free, asked: tuple[Mapping, Mapping, Mapping], own: frozenset[str]
) -> list[dict[str, Constraint]]:
    """Returns the constraints of each picture's parameters, the priors of shared ones once."""
    found = [make_constraints(scene, free, *asked) for scene in scenes]
    without = lambda c: eqx.tree_at(lambda c: c.weight, c, jnp.zeros_like(c.weight))
    rest = [{n: c if n in own else without(c) for n, c in some.items()} for some in found[1:]]
    return [*found[:1], *rest]


def _for_each(name: str, value: Any, count: int) -> list:
    """Returns what counts in each picture, from one value for all or a list.

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


def _check_shared(scenes: list[Scene], free: tuple[str, ...], per_picture: frozenset[str]) -> None:
    """Checks that scenes differ only in what each picture may have apart.

    **Raises:** `InputError` for scenes of different spheres, planes or textures; for shared free
    parameters that start differently; for names in `per_picture` that are not free.
    """
    wrong = sorted(per_picture - (_MAY_DIFFER & set(free)))
    if wrong:
        raise InputError(
            f"own must name free parameters of lights or camera, got {', '.join(wrong)}"
        )
    first = scenes[0]
    for k, other in enumerate(scenes[1:], 2):
        for owner in ("spheres", "planes", "textures"):
            if not bool(eqx.tree_equal(getattr(first, owner), getattr(other, owner))):
                raise InputError(f"scene {k} has other {owner} than the first: they must be equal")
        for name in sorted((_MAY_DIFFER - {"exposure"}) & set(free) - per_picture):
            kinds, others = first.lights.directional, other.lights.directional
            if name in LIGHT_PLACES and len(kinds) == len(others) and kinds != others:
                raise InputError(f"scene {k} has other directional lights than the first")
            if not bool(eqx.tree_equal(value(first, name), value(other, name))):
                raise InputError(
                    f"{name} is free and starts differently in scene {k}: name it in own, or "
                    "start all pictures alike"
                )
