"""The parameters of a scene: one registry of their names, owners, ranges, and what they move.

`needs(free=...)` accepts these names, and a fit's free parameters are those marked `fitted`. What
scales a parameter to a solver's unknown is in `fit/model/parameters.py`.
"""

import dataclasses
import math
from collections.abc import Iterable
from typing import Any, Literal

import equinox as eqx
import numpy as np
from jaxtyping import Bool

from ..base.errors import InputError
from .arrays import is_traced
from .camera import with_defaults
from .scene import Scene

Owner = Literal["spheres", "lights", "planes", "camera", "scene"]

Range = Literal["unit", "positive", "nonnegative", "refraction", "any"]
"""0..1, above 0, 0 or above, 1 or above (a fit's up to `MOST_REFRACTION`), any number."""

#: The largest index of refraction that a fit may find: diamond's is 2.42.
MOST_REFRACTION = 2.5

#: The least and the greatest that a fit may find of each range.
LIMITS: dict[Range, tuple[float, float]] = {
    "unit": (0.0, 1.0),
    "positive": (0.0, math.inf),
    "nonnegative": (0.0, math.inf),
    "refraction": (1.0, MOST_REFRACTION),
    "any": (-math.inf, math.inf),
}


@dataclasses.dataclass(frozen=True)
class Parameter:
    """A named array of a scene. Two owners may have parameters of one name, as of `ka`."""

    name: str
    owner: Owner
    range: Range = "any"
    attribute: str = ""  #: the owner's attribute, if its name is another
    moves_silhouettes: bool = False  #: a change is seen only by where silhouettes are
    fitted: bool = False  #: a fit may set it free
    unit: str = ""  #: nothing for a number without one

    def value(self, scene: Scene) -> Any:
        """Returns the parameter's array, a leaf of the scene; None where it is optional and unset.

        Inside `equinox.tree_at` leaves are no arrays, so the type says nothing.
        """
        owner = scene if self.owner == "scene" else getattr(scene, self.owner)
        return getattr(owner, self.attribute or self.name)


#: Those that are fitted come in the order in which a fit's messages list them.
PARAMETERS = (
    Parameter("color", "spheres", "unit", fitted=True, unit="linear RGB"),
    Parameter("ka", "spheres", "unit", fitted=True),
    Parameter("kd", "spheres", "unit", fitted=True),
    Parameter("ks", "spheres", "unit", fitted=True),
    Parameter("exponent", "spheres", "nonnegative", fitted=True),
    Parameter("kgr", "spheres", "unit", fitted=True),
    Parameter("kt", "spheres", "unit", fitted=True),
    Parameter("ior", "spheres", "refraction", fitted=True),
    Parameter("center", "spheres", moves_silhouettes=True, fitted=True, unit="world units"),
    Parameter(
        "radius", "spheres", "positive", moves_silhouettes=True, fitted=True, unit="world units"
    ),
    Parameter("light_position", "lights", attribute="position", fitted=True, unit="world units"),
    Parameter("light_direction", "lights", attribute="position", fitted=True),
    Parameter(
        "light_color", "lights", "nonnegative", attribute="color", fitted=True, unit="linear RGB"
    ),
    Parameter("light_falloff", "lights", "nonnegative", attribute="falloff", unit="world units"),
    Parameter("theta", "camera", moves_silhouettes=True, fitted=True, unit="radians"),
    Parameter("phi", "camera", moves_silhouettes=True, fitted=True, unit="radians"),
    Parameter("mu", "camera", "positive", moves_silhouettes=True, fitted=True, unit="world units"),
    Parameter(
        "distance", "camera", "positive", moves_silhouettes=True, fitted=True, unit="world units"
    ),
    Parameter("roll", "camera", moves_silhouettes=True, fitted=True, unit="radians"),
    Parameter("look_at", "camera", moves_silhouettes=True, fitted=True, unit="world units"),
    Parameter(
        "principal_point", "camera", moves_silhouettes=True, fitted=True, unit="picture heights"
    ),
    Parameter("pixel_aspect", "camera", "positive", moves_silhouettes=True, fitted=True),
    Parameter("window", "camera", "positive", moves_silhouettes=True, unit="world units"),
    Parameter("point", "planes", moves_silhouettes=True, unit="world units"),
    Parameter("normal", "planes", moves_silhouettes=True),
    Parameter("color", "planes", "unit", unit="linear RGB"),
    Parameter("ka", "planes", "unit"),
    Parameter("kd", "planes", "unit"),
    Parameter("ks", "planes", "unit"),
    Parameter("exponent", "planes", "nonnegative"),
    Parameter("kgr", "planes", "unit"),
    Parameter("ior", "planes", "refraction"),
    Parameter("checker_color", "planes", "unit", unit="linear RGB"),
    Parameter("checker_size", "planes", "nonnegative", unit="world units"),
    Parameter("background", "scene", "nonnegative", unit="linear RGB"),
)

#: Those that a fit may set free, by name.
FITTED = {p.name: p for p in PARAMETERS if p.fitted}

#: The names of where lights are: of those at points, and of directional ones. Both stand for rows
#: of one array, `Lights.position`.
LIGHT_PLACES = ("light_position", "light_direction")

# `needs` takes three names besides: `position` and `directional` of the lights, and `pic`. None of
# them switches code on.
_ACCEPTED = frozenset(p.name for p in PARAMETERS) | {"position", "directional", "pic"}


def rows_of(scene: Scene, name: str) -> Bool[np.ndarray, " lights"]:
    """Tells which lights one of `LIGHT_PLACES` is of: those at points, or directional ones."""
    return np.array([far == (name == "light_direction") for far in scene.lights.directional], bool)


def light_places(scene: Scene) -> tuple[str, ...]:
    """Returns those of `LIGHT_PLACES` that a scene's lights have; of no lights the first."""
    return tuple(n for n in LIGHT_PLACES if rows_of(scene, n).any()) or LIGHT_PLACES[:1]


def parameter_names(names: Iterable[str]) -> frozenset[str]:
    """Returns names, or one bare string, as a set.

    **Raises:** `InputError` for names of no parameter.
    """
    chosen = frozenset([names] if isinstance(names, str) else names)
    unknown = sorted(chosen - _ACCEPTED)
    if unknown:
        raise InputError(f"free must name parameters of the scene, got {', '.join(unknown)}")
    return chosen


def with_optional(scene: Scene, names: Iterable[str]) -> Scene:
    """Returns a scene whose optional numbers of some names are arrays, at their defaults if unset.

    Arrays can be fitted and differentiated; other names are left as they are.
    """
    camera = with_defaults(scene.camera, names)
    return scene if camera is scene.camera else eqx.tree_at(lambda s: s.camera, scene, camera)


def traced_names(scene: Scene) -> frozenset[str]:
    """Returns the names of the parameters that are not known yet, as under jit, grad and vmap."""
    return frozenset(p.name for p in PARAMETERS if is_traced(p.value(scene)))
